"""Nodes that were started afresh, have one name, speak another protocol, or a wrong clock."""

from __future__ import annotations

from collections.abc import Iterable

import msgspec
import pytest

from terrafuse.exchange.courier import Channel, Courier, CourierSettings
from terrafuse.exchange.framing import frames_of
from terrafuse.exchange.guard import Guard, Policy, Quotas
from terrafuse.exchange.links import Frame, Link, MemoryHub
from terrafuse.exchange.lives import Lives
from terrafuse.exchange.peer import Peer
from terrafuse.exchange.summary import VERSION
from terrafuse.lattice import Lattice
from terrafuse.mapper import Mapper
from terrafuse.models import make_model
from terrafuse.replica import Replica
from terrafuse.testing.deltas import random_scans, scan_of
from terrafuse.views import chosen_layers, tile_layers

STEP_NS, SECOND_NS = 100_000_000, 1_000_000_000
LATTICE, MODEL = Lattice(0.5, 4.0), make_model("elevation")
QUICK = CourierSettings(period_s=0.5, answer_s=0.1, retry_s=0.5)


class Ether:
    """A hub on which two nodes may have one name, as over a network without a broker."""

    def __init__(self) -> None:
        self.ends: list[End] = []


class End:
    max_frame_bytes = 600

    def __init__(self, ether: Ether, node: str) -> None:
        self.node, self._ether, self._topics, self._arrived = node, ether, [], []  # type: ignore[var-annotated]
        ether.ends.append(self)

    def listen(self, topic: str) -> None:
        self._topics.append(topic)

    def send(self, topic: str, payload: bytes, now_ns: int) -> None:
        for end in self._ether.ends:
            if end is not self and any(topic == own or topic.startswith(own + "/") for own in end._topics):
                end._arrived.append(Frame(topic, payload))

    def receive(self, now_ns: int) -> list[Frame]:
        arrived, self._arrived = self._arrived, []
        return arrived

    def close(self) -> None:
        self._ether.ends.remove(self)


def robot(link: Link, seed: int) -> Courier:
    mapper = Mapper("r1", LATTICE, MODEL)
    for scan in random_scans(seed, 3, 7.0, 40):
        mapper.integrate(scan)
    return Courier(link, [Channel("fine", own=mapper)], peers=["station"], settings=QUICK)


def run(couriers: Iterable[Courier], from_s: float, to_s: float) -> None:
    for now_ns in range(round(from_s * SECOND_NS), round(to_s * SECOND_NS), STEP_NS):
        for courier in couriers:
            courier.tick(now_ns)


def test_of_two_robots_with_one_name_nothing_is_taken_until_one_is_gone() -> None:
    ether = Ether()
    whole = Replica(LATTICE, MODEL)
    station = Courier(End(ether, "station"), [Channel("fine", whole.store)], settings=QUICK)
    first = robot(End(ether, "r1"), 1)
    run([station, first], 0, 3)
    assert first.behind("station") == {}
    impostor = End(ether, "r1")
    second = robot(impostor, 2)
    run([station, first, second], 3, 12)
    assert station.namesakes == first.namesakes == second.namesakes == {"r1"}
    applied = station.counts["deltas_applied"]
    first.post("station", "state", b"here")
    run([station, first, second], 12, 20)
    assert station.counts["deltas_applied"] == applied
    assert station.counts["refused.namesake"] > 0
    impostor.close()
    run([station, first], 20, 50)
    assert station.namesakes == first.namesakes == frozenset()
    assert first.behind("station") == {}


def test_a_robot_that_is_started_again_and_again_is_one() -> None:
    ether = Ether()
    whole = Replica(LATTICE, MODEL)
    station = Courier(End(ether, "station"), [Channel("fine", whole.store)], settings=QUICK)
    for life in range(5):
        end = End(ether, "r1")
        run([station, robot(end, life)], 8 * life, 8 * life + 8)
        assert not station.namesakes
        end.close()


def test_frames_of_a_former_life_that_come_late_are_no_namesake() -> None:
    lives, peer = Lives(), Peer("r1")
    assert lives.heard(peer, 100, 100, 0)
    assert lives.heard(peer, 200, 200, SECOND_NS)
    for late in range(10):
        assert not lives.heard(peer, 100, 101, (2 + late) * SECOND_NS)
        assert lives.heard(peer, 200, 201 + late, (2 + late) * SECOND_NS)
        assert not lives.namesakes((2 + late) * SECOND_NS)


def test_a_robot_whose_clock_was_set_back_is_heard_again() -> None:
    """It was born in 2026, and is born again in 1970. What it posts is new, too."""
    hub = MemoryHub(600)
    heard: list[bytes] = []
    whole = Replica(LATTICE, MODEL)
    station = Courier(
        hub.link("station"), [Channel("fine", whole.store)], settings=QUICK,
        on_message=lambda sender, kind, payload: heard.append(payload),
    )  # fmt: skip
    year_ns = 1_767_225_600 * SECOND_NS
    for life, began_ns in enumerate((year_ns, 0)):
        link = hub.link("r1")
        again = robot(link, life)
        again.post("station", "state", bytes([life]))
        for k in range(0, 12 * SECOND_NS, STEP_NS):
            again.tick(began_ns + k)
            station.tick(year_ns + 12 * SECOND_NS * life + k)
        assert again.behind("station") == {}
        link.close()
    assert heard == [b"\x00", b"\x01"]
    assert station.namesakes == frozenset()


def test_both_ends_say_that_the_other_speaks_another_version() -> None:
    hub = MemoryHub(600)
    whole = Replica(LATTICE, MODEL)
    station = Courier(hub.link("station"), [Channel("fine", whole.store)], settings=QUICK)
    newer = hub.link("r1")
    newer.listen("summary")
    message = msgspec.msgpack.encode([VERSION + 1, "what is then said", {}])
    for frame in frames_of("summary/r1", message, 600):
        newer.send(*frame, 0)
    station.tick(0)
    assert station.strangers == {"r1": VERSION + 1}
    assert station.counts["refused.version"] == 1
    assert station.reached(0) == []
    # The other reads of ours, which came, the version that it begins with.
    (frame,) = newer.receive(0)
    assert msgspec.msgpack.decode(frame.payload[16:])[0] == VERSION


# --- clocks ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ahead_s", [30, 3600])
def test_one_robot_s_clock_does_not_age_what_others_saw(ahead_s: int) -> None:
    """Up to a minute ahead is taken; beyond, the whole report is refused, and nobody's cells are the older for it."""
    hub = MemoryHub(600)
    whole = Replica(LATTICE, make_model("terrain"))
    guard = Guard(whole.store.map, Quotas(ahead_s=60.0), Policy())
    station = Courier(hub.link("station"), [Channel("fine", whole.store, guard=guard.check)], settings=QUICK)
    robots = []
    for name, x_m, stamp_ns in (("r1", 0.2, 0), ("r2", 2.2, ahead_s * SECOND_NS)):
        mapper = Mapper(name, LATTICE, whole.model)
        mapper.integrate(scan_of([[x_m + 0.1 * k, 0.2, 0.0] for k in range(3)], stamp_ns))
        robots.append(Courier(hub.link(name), [Channel("fine", own=mapper)], peers=["station"], settings=QUICK))
    run([station, *robots], 0, 5)
    taken = ahead_s <= 60
    assert whole.robots == (["r1", "r2"] if taken else ["r1"])
    assert station.counts["refused.clock"] == 0 if taken else station.counts["refused.clock"] > 0
    assert whole.reading.now_ns == (ahead_s * SECOND_NS if taken else 0)
    layers = chosen_layers(whole, ["confidence"])
    assert tile_layers(whole, whole.keys[0], layers)["confidence"].shape == (8, 8)
