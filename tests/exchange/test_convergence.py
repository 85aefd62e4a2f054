"""Schedules at random: whatever goes wrong, replicas that can reach each other end with the undisturbed run's map."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from terrafuse.exchange.links import Cut, Faults, Link, MemoryHub, MisbehavingLink
from terrafuse.simulate.radio import Place, Radio, RadioCut, RadioSettings, Surroundings
from terrafuse.testing.deltas import random_scans
from terrafuse.types import Scan
from tests.exchange.fleet import QUICK, STATION, Node, agreed, mesh, run, star, undisturbed

DISTURBED_S = 6.0
"""Until then there are scans, cuts and restarts; what the links do to single frames goes on."""
LONGEST_S = 240.0
"""By then all must be level: half of the frames lost both ways makes for long waits, but not for ever."""


@cache
def scans(seed: int) -> list[Scan]:
    return random_scans(seed, 10, 8.0, 12)


@dataclass(frozen=True)
class Restart:
    """At this second a node begins anew; what it keeps depends on the node (see `restart`)."""

    at_s: float
    node: str
    keeps_store: bool


@dataclass(frozen=True)
class Schedule:
    robots: int
    shape: Callable[..., dict[str, Node]]
    seed: int
    faults: Faults
    frame_bytes: int
    cuts: dict[str, tuple[Cut, ...]]
    restarts: tuple[Restart, ...]
    bytes_per_s: float


SECONDS = st.floats(0.0, DISTURBED_S, allow_nan=False).map(lambda value: round(value, 1))
FAULTS = st.builds(
    Faults,
    loss=st.floats(0, 0.5),
    duplication=st.floats(0, 0.5),
    corruption=st.floats(0, 0.2),
    reordering=st.floats(0, 0.5),
    held_s=st.floats(0, 1.5),
    delay_s=st.floats(0, 0.2),
    jitter_s=st.floats(0, 0.3),
)
CUTS = st.builds(lambda start, length: Cut(start, min(start + length, DISTURBED_S)), SECONDS.filter(lambda s: s < 5),
                 st.floats(0.5, 5.0))  # fmt: skip


@st.composite
def schedules(draw: st.DrawFn) -> Schedule:
    robots = draw(st.integers(1, 4))
    shape = draw(st.sampled_from([star, mesh])) if robots > 1 else star
    names = [f"r{k}" for k in range(1, robots + 1)] + ([STATION] if shape is star else [])
    restarts = st.builds(Restart, SECONDS, st.sampled_from(names), st.booleans())
    return Schedule(
        robots,
        shape,
        draw(st.integers(0, 2**16)),
        draw(FAULTS),
        draw(st.sampled_from([120, 300, 2300])),
        {name: tuple(draw(st.lists(CUTS, max_size=2))) for name in names},
        tuple(draw(st.lists(restarts, max_size=3))),
        draw(st.sampled_from([3e3, 1e5, float("inf")])),
    )


def disturb(schedule: Schedule, join: Callable[[str], Link]) -> dict[str, Node]:
    """Run it, with a post from each node to each peer at every second."""
    limited = replace(QUICK, bytes_per_s=schedule.bytes_per_s)
    nodes = schedule.shape([scans(schedule.seed % 50 + k) for k in range(schedule.robots)], join, limited)
    pending = sorted(schedule.restarts, key=lambda one: one.at_s)
    for second in range(round(DISTURBED_S)):
        post_all(nodes, second)
        at_s = float(second)
        while pending and pending[0].at_s < second + 1:
            one = pending.pop(0)
            run(nodes, at_s, one.at_s + 0.1)
            at_s = max(at_s, round(one.at_s + 0.1, 1))
            restart(nodes[one.node], join, one.keeps_store)
        run(nodes, at_s, second + 1)
    return nodes


def settle(nodes: dict[str, Node]) -> None:
    """Go on without scans, cuts and restarts, and check what it comes to."""
    post_all(nodes, "last")
    expected = undisturbed(nodes).digest()

    def level() -> bool:
        return arrived(nodes) and all(node.replica.digest() == expected for node in nodes.values())

    run(nodes, DISTURBED_S, LONGEST_S, until=level)
    assert agreed(nodes)
    assert arrived(nodes)
    for node in nodes.values():
        for payloads in node.posts.values():
            # Each once, none after a newer one: numbers rise, and "last" comes last.
            assert payloads == sorted(set(payloads))


def restart(node: Node, join: Callable[[str], Link], keeps_store: bool) -> None:
    """A robot keeps its own map, as from its disk; its replica, and the station's, may be lost."""
    node.link.close()
    node.start(join(node.name), keep_map=True, keep_store=keeps_store)


def peers_of(nodes: dict[str, Node], name: str) -> list[str]:
    own = nodes[name].peers
    return [other for other in nodes if other != name and (own is None or other in own)]


def post_all(nodes: dict[str, Node], what: object) -> None:
    for name, node in nodes.items():
        for peer in peers_of(nodes, name):
            node.courier.post(peer, "state", f"{name} {what}".encode())


def arrived(nodes: dict[str, Node]) -> bool:
    """Whether the last post of each node to each peer came, after all others."""
    return all(
        nodes[peer].posts.get((name, "state"), [b""])[-1] == f"{name} last".encode()
        for name in nodes
        for peer in peers_of(nodes, name)
    )


MANY = settings(max_examples=100, suppress_health_check=[HealthCheck.too_slow])


@given(schedule=schedules())
@MANY
def test_over_links_that_misbehave(schedule: Schedule) -> None:
    hub = MemoryHub(schedule.frame_bytes)
    lives: dict[str, int] = {}

    def join(name: str) -> Link:
        lives[name] = lives.get(name, 0) + 1
        faults = replace(schedule.faults, cuts=schedule.cuts[name])
        return MisbehavingLink(hub.link(name), faults, schedule.seed + 1000 * lives[name] + len(lives))

    settle(disturb(schedule, join))


PLACES = st.tuples(st.floats(-40, 40), st.floats(-40, 40), st.just(0.0))


@given(schedule=schedules(), places=st.lists(PLACES, min_size=5, max_size=5), wall_m=st.floats(-30, 30))
@MANY
def test_over_radios_with_walls_cuts_and_places(schedule: Schedule, places: list[Place], wall_m: float) -> None:
    """A wall from south to north leaves 35 m of range; in the end it falls, and all come near."""
    standing = [True]

    def sees(one: Place, two: Place) -> bool:
        return not standing[0] or (one[0] < wall_m) == (two[0] < wall_m)

    cuts = tuple(RadioCut(cut.from_s, cut.to_s, name) for name, some in schedule.cuts.items() for cut in some)
    faults = replace(schedule.faults, bytes_per_s=50_000.0, overhead_bytes=12, queue_bytes=30_000.0)
    radio = Radio(
        RadioSettings(100.0, 0.35, frame_bytes=schedule.frame_bytes, faults=faults, cuts=cuts),
        Surroundings(sees),
        schedule.seed,
    )
    where = dict(zip(["r1", "r2", "r3", "r4", STATION], places, strict=True))
    slower = replace(schedule, bytes_per_s=min(schedule.bytes_per_s, 40_000.0))
    nodes = disturb(slower, lambda name: radio.link(name, where[name]))
    standing[0] = False
    for name in nodes:
        radio.move(name, (0.0, 0.0, 0.0), round(DISTURBED_S * 1e9))
    settle(nodes)


def test_nothing_of_it_is_random() -> None:
    """The same schedule gives the same bytes on the air."""

    def sent() -> list[dict[str, int]]:
        hub = MemoryHub(300)
        faults = Faults(loss=0.3, duplication=0.2, corruption=0.1, reordering=0.2)
        seeds = iter(range(10))
        nodes = star([scans(k) for k in range(3)], lambda name: MisbehavingLink(hub.link(name), faults, next(seeds)))
        run(nodes, 0, 10)
        return [dict(node.courier.counts) for node in nodes.values()]

    assert sent() == sent()
