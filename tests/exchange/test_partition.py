"""Ten minutes without contact: what waits is as much as the area that changed, and how soon all is level again."""

from __future__ import annotations

import pytest

from terrafuse.exchange.coarse import CoarseContribution
from terrafuse.exchange.codec import encode
from terrafuse.exchange.courier import Channel, Courier, CourierSettings
from terrafuse.exchange.links import Cut, Faults, MemoryHub, MisbehavingLink
from terrafuse.lattice import Lattice
from terrafuse.mapper import Mapper
from terrafuse.models import make_model
from terrafuse.replica import Replica
from terrafuse.testing.deltas import random_scans

TICK_NS, SECOND_NS = 100_000_000, 1_000_000_000
LATTICE, FACTOR = Lattice(0.5, 20.0), 5
MODEL = make_model("elevation")
HEALED_S = 605.0
CUT = Faults(cuts=(Cut(5.0, HEALED_S),))


class Pair:
    """A robot that goes over the same 60 m square for so long, a scan each five seconds, and a station."""

    def __init__(self, bytes_per_s: float, faults: Faults = CUT, scans: int = 120) -> None:
        hub = MemoryHub(1400)
        self.mapper = Mapper("r1", LATTICE, MODEL)
        self.coarse = CoarseContribution(self.mapper, FACTOR)
        settings = CourierSettings(bytes_per_s=bytes_per_s)
        self.robot = Courier(
            MisbehavingLink(hub.link("r1"), faults),
            [Channel("coarse", own=self.coarse), Channel("fine", own=self.mapper)],
            peers=["station"],
            settings=settings,
        )
        self.held = {"coarse": Replica(LATTICE.coarser(FACTOR), MODEL), "fine": Replica(LATTICE, MODEL)}
        channels = [Channel(name, replica.store) for name, replica in self.held.items()]
        self.station = Courier(hub.link("station"), channels, settings=settings)
        self.scans = random_scans(1, scans, 60.0, 4000)
        self.now_ns = 0

    def run(self, to_s: float) -> None:
        while self.now_ns < to_s * SECOND_NS:
            if self.now_ns % (5 * SECOND_NS) == 0 and self.scans:
                self.mapper.integrate(self.scans.pop(0))
                self.coarse.update()
            self.robot.tick(self.now_ns)
            self.station.tick(self.now_ns)
            self.now_ns += TICK_NS

    @property
    def backlog(self) -> int:
        """Bytes of what the station lacks of the robot, a channel in one delta, worked out from both maps."""
        sources = {"coarse": self.coarse, "fine": self.mapper}
        lacks = [source.delta(self.held[name].store.revision("r1")) for name, source in sources.items()]  # type: ignore[attr-defined]
        return sum(len(encode(delta)) for delta in lacks)

    @property
    def sent(self) -> int:
        return sum(number for name, number in self.robot.counts.items() if name.startswith("bytes_sent"))

    def until_level(self) -> float:
        """Seconds from now until the station lacks nothing."""
        begun_ns = self.now_ns
        while self.robot.behind("station"):
            self.run(self.now_ns / SECOND_NS + 0.1)
        return (self.now_ns - begun_ns) / SECOND_NS


@pytest.mark.parametrize("bytes_per_s", [5_000.0, 20_000.0])
def test_it_is_level_as_soon_as_the_backlog_fits_the_budget(bytes_per_s: float) -> None:
    pair = Pair(bytes_per_s)
    pair.run(HEALED_S)
    assert not pair.station.reached(pair.now_ns)
    backlog = pair.backlog
    assert backlog > 4 * bytes_per_s
    took_s = pair.until_level()
    # A fifth more: 16 bytes of header in each frame of 256 or more, messages of less than the whole, summaries, and
    # the second until both have heard of each other.
    assert took_s <= 1.2 * backlog / bytes_per_s
    for name, source in (("coarse", pair.coarse), ("fine", pair.mapper)):
        expected = Replica(pair.held[name].lattice, MODEL)
        expected.apply(source.delta())  # type: ignore[attr-defined]
        assert pair.held[name].digest() == expected.digest()


def test_what_waits_is_as_much_as_the_area_not_as_the_time() -> None:
    """All 14,400 cells were seen within the first minute: ten more change them, and add none."""
    backlogs = []
    for scans in (12, 120):
        pair = Pair(20_000.0, scans=scans)
        pair.run(HEALED_S)
        before = pair.sent
        pair.until_level()
        backlogs.append(pair.sent - before)
    assert backlogs[1] < 1.5 * backlogs[0]


def test_at_two_kilobytes_a_second_the_coarse_map_is_there_within_a_minute() -> None:
    """Of what it has driven over when contact begins; the fine map, ten times as much, is still on its way."""
    pair = Pair(2_000.0, Faults(cuts=(Cut(0.0, 60.0),)), scans=12)
    pair.run(60.0)
    driven = pair.coarse.delta()
    pair.run(120.0)
    assert "coarse" not in pair.robot.behind("station")
    assert "fine" in pair.robot.behind("station")
    expected = Replica(LATTICE.coarser(FACTOR), MODEL)
    expected.apply(driven)
    assert pair.held["coarse"].digest() == expected.digest()
