"""Schedules at random: nodes that come, go and forget, over links that do all wrong, from a seed; and what it comes to.

What robots report is worked out once and played back, so that a schedule takes milliseconds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from zlib import crc32

import numpy as np

from terrafuse.exchange.coarse import CoarseContribution
from terrafuse.exchange.courier import Channel, Courier, CourierSettings
from terrafuse.exchange.delta import Delta
from terrafuse.exchange.links import Cut, Faults, Frame, Link, MemoryHub, MisbehavingLink
from terrafuse.exchange.parts import newer
from terrafuse.lattice import Lattice
from terrafuse.mapper import Mapper
from terrafuse.models import make_model
from terrafuse.replica import Replica
from terrafuse.store.base import Store
from terrafuse.store.memory import MemoryStore
from terrafuse.store.sqlite import SqliteStore
from terrafuse.testing.deltas import random_scans

STEP_NS = 250_000_000
SCANS, SCAN_NS = 4, 500_000_000
DISTURBED_NS = 3_000_000_000
"""Until then there are scans, cuts and restarts; what links do to single frames goes on."""
LONGEST_NS = 400_000_000_000
"""By then all must be level: half of the frames lost both ways makes for long waits, but not for ever."""
FINE, FACTOR = Lattice(0.5, 2.0), 2
LATTICES = {"coarse": FINE.coarser(FACTOR), "fine": FINE}
MODEL = make_model("occupancy")
SETTINGS = CourierSettings(period_s=1.0, answer_s=0.25, retry_s=0.5, longest_retry_s=2.0, message_cells=24)
SEQUENCES = 12
BEGINNINGS = (0, 1, 2)
"""Scans with which a robot that lost everything may begin anew."""


@cache
def reports(sequence: int, first: int) -> dict[str, list[Delta]]:
    """By channel, what a robot has to report after each of its scans from the one numbered `first` on."""
    mapper = Mapper("robot", FINE, MODEL)
    coarse = CoarseContribution(mapper, FACTOR)
    out: dict[str, list[Delta]] = {"coarse": [], "fine": []}
    for scan in random_scans(sequence, SCANS, 3.0, 4)[first:]:
        mapper.integrate(scan)
        coarse.update()
        out["coarse"].append(coarse.delta())
        out["fine"].append(_copied(mapper.delta()))
    return out


def _copied(delta: Delta) -> Delta:
    return replace(delta, tiles=tuple(newer(tile, 0) for tile in delta.tiles))


class Played:
    """A `Source` that goes on from scan to scan as it is told to."""

    def __init__(self, robot: str, whole: Sequence[Delta]) -> None:
        self.robot = robot
        self.revision = 0
        self.whole = whole

    def delta(self, since: int) -> Delta:
        delta = self.whole[self.revision - 1]
        tiles = (newer(tile, since) for tile in delta.tiles)
        return replace(delta, robot=self.robot, since=since, tiles=tuple(tile for tile in tiles if len(tile.at)))


class Neighbours:
    """A link that hears only some nodes."""

    def __init__(self, link: Link, heard: frozenset[str]) -> None:
        self.node, self.max_frame_bytes = link.node, link.max_frame_bytes
        self.listen, self.send, self.close = link.listen, link.send, link.close
        self._link, self._heard = link, heard

    def receive(self, now_ns: int) -> list[Frame]:
        return [frame for frame in self._link.receive(now_ns) if frame.topic.rsplit("/", 1)[-1] in self._heard]


@dataclass(frozen=True)
class Restart:
    at_ns: int
    node: str
    keeps: str
    """everything; its own map; nothing"""


@dataclass(frozen=True)
class Schedule:
    seed: int
    robots: tuple[str, ...]
    stations: tuple[str, ...]
    ways: dict[str, frozenset[str]]
    """Whom each node hears."""
    relays: frozenset[str]
    channels: tuple[str, ...]
    faults: Faults
    frame_bytes: int
    bytes_per_s: float
    cuts: dict[str, tuple[Cut, ...]]
    restarts: tuple[Restart, ...]

    @property
    def forgets(self) -> bool:
        return any(restart.keeps == "nothing" and restart.node in self.robots for restart in self.restarts)


def schedule_of(seed: int) -> Schedule:
    rng = np.random.default_rng(seed)
    robots, stations, ways = _shape(rng)
    nodes = [*robots, *stations]
    relays = frozenset(stations or nodes)
    faults = Faults(
        loss=rng.uniform(0, 0.5), duplication=rng.uniform(0, 0.5), corruption=rng.uniform(0, 0.2),
        reordering=rng.uniform(0, 0.5), held_s=rng.uniform(0, 1.5), delay_s=rng.uniform(0, 0.2),
        jitter_s=rng.uniform(0, 0.3),
    )  # fmt: skip
    return Schedule(
        seed, robots, stations, ways, relays, ("coarse", "fine")[: 1 if rng.uniform() < 0.75 else 2], faults,
        int(rng.choice([120, 300, 2300])), float(rng.choice([3e3, 1e5, np.inf])),
        {node: tuple(_cut(rng) for _ in range(rng.integers(0, 3))) for node in nodes},
        tuple(_restart(rng, nodes) for _ in range(rng.integers(0, 4))),
    )  # fmt: skip


def _shape(rng: np.random.Generator) -> tuple[tuple[str, ...], tuple[str, ...], dict[str, frozenset[str]]]:
    """(robots, stations, whom each hears) of 2 to 6 nodes: a star, a mesh, a chain, or two stars side by side."""
    count = int(rng.choice([2, 3, 4, 5, 6], p=[0.4, 0.25, 0.15, 0.1, 0.1]))
    names = tuple(f"r{k}" for k in range(1, count + 1))
    shape = rng.choice(["star", "mesh", "chain", "hierarchy"])
    if shape == "mesh":
        return names, (), {name: frozenset(names) - {name} for name in names}
    if shape == "chain":
        pairs = list(pairwise(names))
        return names, (), _heard(names, pairs)
    stations = ("s1", "s2") if shape == "hierarchy" and count > 2 else ("s1",)
    robots = names[: count - len(stations)]
    pairs = [(robot, stations[k % len(stations)]) for k, robot in enumerate(robots)]
    pairs += list(pairwise(stations))
    return robots, stations, _heard((*robots, *stations), pairs)


def _heard(names: Sequence[str], pairs: Sequence[tuple[str, str]]) -> dict[str, frozenset[str]]:
    both = {*pairs, *((two, one) for one, two in pairs)}
    return {name: frozenset(two for one, two in both if one == name) for name in names}


def _cut(rng: np.random.Generator) -> Cut:
    start_s = float(rng.uniform(0, 2.5))
    return Cut(start_s, min(start_s + float(rng.uniform(0.5, 4)), DISTURBED_NS / 1e9))


def _restart(rng: np.random.Generator, nodes: Sequence[str]) -> Restart:
    at_ns = int(rng.integers(1, DISTURBED_NS // STEP_NS)) * STEP_NS
    keeps = str(rng.choice(["everything", "its own map", "nothing"], p=[0.4, 0.4, 0.2]))
    return Restart(at_ns, str(rng.choice(nodes)), keeps)


@dataclass
class Node:
    name: str
    stores: dict[str, Store] = field(default_factory=dict)
    sources: dict[str, Played] = field(default_factory=dict)
    """By channel; none at a station."""
    courier: Courier | None = None
    link: Link | None = None
    lives: int = 0
    beginnings: int = 0
    """Lives into which it took nothing of what others told."""

    def tick(self, now_ns: int) -> None:
        assert self.courier is not None
        self.courier.tick(now_ns)

    def map(self, channel: str) -> Replica:
        return Replica(store=self.stores[channel])

    def digests(self) -> list[str]:
        return [self.map(channel).digest() for channel in sorted(self.stores)]


class Run:
    """A schedule on its way, over links that misbehave as it says, or those that `join` makes for a name.

    With a `folder` nodes hold what they do in files there. Who restarts then was killed between two transactions: its
    files are opened as they lie.
    """

    def __init__(
        self, schedule: Schedule, join: Callable[[str], Link] | None = None, folder: Path | None = None
    ) -> None:
        self._folder = folder
        self.schedule = schedule
        self.nodes = {name: Node(name) for name in (*schedule.robots, *schedule.stations)}
        self.now_ns = 0
        self._hub = MemoryHub(schedule.frame_bytes)
        self._join = join or self._misbehaving
        for node in self.nodes.values():
            self._start(node, "nothing", 0)

    def disturb(self) -> None:
        """Scans, cuts and restarts."""
        while self.now_ns < DISTURBED_NS:
            for restart in self.schedule.restarts:
                if restart.at_ns == self.now_ns:
                    self._restart(self.nodes[restart.node], restart.keeps)
            if self.now_ns % SCAN_NS == 0:
                self._scan()
            self._step()

    def settle(self) -> bool:
        """Go on until all hold the same; False: in vain."""
        while self.now_ns < LONGEST_NS:
            for _ in range(4):
                self._step()
            if self.level():
                return True
        return False

    def level(self) -> bool:
        """Whether all replicas are the same, and, if no robot forgot its map, those of the undisturbed run."""
        if any(self._behind(node) for node in self.nodes.values()):
            return False
        digests = [node.digests() for node in self.nodes.values()]
        return all(one == digests[0] for one in digests) and (self.schedule.forgets or digests[0] == self.undisturbed())

    def undisturbed(self) -> list[str]:
        out = []
        for channel in sorted(self.schedule.channels):
            whole = Replica(LATTICES[channel], MODEL)
            for node in self.nodes.values():
                if source := node.sources.get(channel):
                    whole.apply(source.delta(0))
            out.append(whole.digest())
        return out

    def _behind(self, node: Node) -> bool:
        assert node.courier is not None
        return any(node.courier.behind(peer) for peer in self.schedule.ways[node.name])

    def _step(self) -> None:
        for node in self.nodes.values():
            node.tick(self.now_ns)
        self.now_ns += STEP_NS

    def _scan(self) -> None:
        for node in self.nodes.values():
            for source in node.sources.values():
                source.revision = min(source.revision + 1, len(source.whole))

    def _restart(self, node: Node, keeps: str) -> None:
        assert node.link is not None
        node.link.close()
        first = max(k for k in BEGINNINGS if k * SCAN_NS <= self.now_ns)
        self._start(node, keeps, first)

    def _start(self, node: Node, keeps: str, first: int) -> None:
        channels = self.schedule.channels
        if keeps != "everything":
            node.beginnings += 1
            node.stores = {channel: self._store(node, channel) for channel in channels}
        elif self._folder is not None:
            node.stores = {channel: SqliteStore.open(self._file(node, channel)) for channel in channels}
        if keeps == "nothing" and node.name in self.schedule.robots:
            made = reports((self.schedule.seed + int(node.name[1:])) % SEQUENCES, first)
            node.sources = {channel: Played(node.name, made[channel]) for channel in channels}
        node.lives += 1
        node.link = self._join(node.name)
        relay = node.name in self.schedule.relays
        node.courier = Courier(
            node.link,
            [Channel(name, node.stores[name], node.sources.get(name), relay) for name in channels],
            settings=replace(SETTINGS, bytes_per_s=self.schedule.bytes_per_s),
        )

    def _store(self, node: Node, channel: str) -> Store:
        """A new one, in place of any before."""
        if self._folder is None:
            return MemoryStore(LATTICES[channel], MODEL)
        return SqliteStore.create(self._file(node, channel), LATTICES[channel], MODEL)

    def _file(self, node: Node, channel: str) -> Path:
        assert self._folder is not None
        return self._folder / f"{node.name}.{channel}.{node.beginnings}.db"

    def _misbehaving(self, name: str) -> Link:
        faults = replace(self.schedule.faults, cuts=self.schedule.cuts[name])
        heard = Neighbours(self._hub.link(name), self.schedule.ways[name])
        return MisbehavingLink(heard, faults, [self.schedule.seed, self.nodes[name].lives, crc32(name.encode())])


def converges(seed: int, watch: Callable[[Run], None] = lambda run: None, folder: Path | None = None) -> bool:
    """Whether all replicas of this schedule end with the same bytes."""
    run = Run(schedule_of(seed), folder=folder)
    run.disturb()
    level = run.settle()
    watch(run)
    return level
