"""Robots and a station that exchange their maps over links of any kind, step by step: to test couriers with."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

from terrafuse.exchange.coarse import CoarseContribution
from terrafuse.exchange.courier import Channel, Courier, CourierSettings
from terrafuse.exchange.links import Link
from terrafuse.lattice import Lattice
from terrafuse.mapper import Mapper
from terrafuse.models import Model, make_model
from terrafuse.replica import Replica
from terrafuse.types import Scan

STEP_NS = 100_000_000
LATTICE = Lattice(0.5, 4.0)
FACTOR = 2
MODEL = make_model("elevation")
STATION = "station"
CHANNEL = "coarse"
QUICK = CourierSettings(period_s=0.5, answer_s=0.1, retry_s=0.5, longest_retry_s=2.0, message_cells=60)

Join = Callable[[str], Link]


@dataclass
class Node:
    """A node whose scans come one by one; the station has none."""

    name: str
    scans: Iterator[Scan]
    peers: Sequence[str] | None
    relay: bool
    settings: CourierSettings = QUICK
    model: Model = MODEL
    mapper: Mapper | None = None
    """Of a robot, once it started."""
    posts: dict[tuple[str, str], list[bytes]] = field(default_factory=dict)
    """What came, by sender and kind."""

    def start(self, link: Link, *, keep_map: bool = False, keep_store: bool = False) -> None:
        """Begin a life, with what is kept of the one before."""
        if self.name != STATION and not (keep_map and self.mapper):
            self.mapper = Mapper(self.name, LATTICE, self.model)
        if not keep_store:
            self.replica = Replica(LATTICE.coarser(FACTOR), self.model)
        self.posts = {}
        self.link = link
        self.own = None if self.mapper is None else CoarseContribution(self.mapper, FACTOR)
        channel = Channel(CHANNEL, self.replica.store, self.own, self.relay)
        self.courier = Courier(link, [channel], peers=self.peers, on_message=self._heard, settings=self.settings)

    def step(self, now_ns: int, scanning: bool) -> None:
        if self.mapper is not None and self.own is not None:
            if scanning and (scan := next(self.scans, None)) is not None:
                self.mapper.integrate(scan)
            self.own.update()
        self.courier.tick(now_ns)

    def _heard(self, sender: str, kind: str, payload: bytes) -> None:
        self.posts.setdefault((sender, kind), []).append(payload)


def star(scans: Sequence[Sequence[Scan]], join: Join, settings: CourierSettings = QUICK) -> dict[str, Node]:
    """A station that passes on, and a robot for each of these."""
    nodes = [Node(f"r{k}", iter(some), [STATION], False, settings) for k, some in enumerate(scans, start=1)]
    return _started([*nodes, Node(STATION, iter(()), None, True, settings)], join)


def mesh(scans: Sequence[Sequence[Scan]], join: Join, settings: CourierSettings = QUICK) -> dict[str, Node]:
    """Robots among themselves, which all pass on."""
    return _started([Node(f"r{k}", iter(some), None, True, settings) for k, some in enumerate(scans, start=1)], join)


def _started(nodes: Sequence[Node], join: Join) -> dict[str, Node]:
    for node in nodes:
        node.start(join(node.name))
    return {node.name: node for node in nodes}


def run(nodes: dict[str, Node], from_s: float, to_s: float, until: Callable[[], bool] = lambda: False) -> float:
    """Steps from one second to another, with a scan of each robot every half one; when it ended."""
    for now_ns in range(round(from_s * 1e9), round(to_s * 1e9), STEP_NS):
        for node in nodes.values():
            node.step(now_ns, scanning=now_ns % 500_000_000 == 0)
        if now_ns % 1_000_000_000 == 0 and until():
            return now_ns / 1e9
    return to_s


def undisturbed(nodes: dict[str, Node]) -> Replica:
    """The map of the robots' own ones, coarsened: what every replica comes to."""
    fine = Replica(LATTICE, next(iter(nodes.values())).model)
    for node in nodes.values():
        if node.mapper is not None:
            fine.apply(node.mapper.delta())
    return Replica(store=fine.store, factor=FACTOR)


def agreed(nodes: dict[str, Node]) -> bool:
    expected = undisturbed(nodes).digest()
    return all(node.replica.digest() == expected for node in nodes.values())
