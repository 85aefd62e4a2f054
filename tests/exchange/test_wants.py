"""What goes first, and that nothing starves."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np

from terrafuse.exchange.channel import Channel
from terrafuse.exchange.delta import Delta, TileCells
from terrafuse.exchange.growth import Growth
from terrafuse.exchange.holding import Holding
from terrafuse.exchange.known import Known
from terrafuse.exchange.peer import Peer, PeerChannel
from terrafuse.exchange.wants import AGE_NS, Wants
from terrafuse.lattice import Lattice
from terrafuse.mapper import Mapper
from terrafuse.models import make_model
from terrafuse.store.memory import MemoryStore
from terrafuse.testing.deltas import scan_of
from terrafuse.types import Bounds, TileKey

LATTICE = Lattice(1.0, 2.0)
MODEL = make_model("elevation")
SECOND_NS = 1_000_000_000


def delta(key: TileKey, revision: int, robot: str = "r1") -> Delta:
    """One cell of this tile, as of this revision."""
    mapper = Mapper(robot, LATTICE, MODEL)
    mapper.integrate(scan_of([[2.0 * key.x + 0.5, 2.0 * key.y + 0.5, 0.0]]))
    (tile,) = mapper.delta().tiles
    cells = tile.cells.copy()
    cells["revision"] = revision
    return replace(mapper.delta(), since=revision, revision=revision, tiles=(TileCells(key, tile.at, cells),))


class Robot:
    """What a station holds of r1, tile by tile, and a peer that is to have it."""

    def __init__(self, *, near: bool = False) -> None:
        self.store = MemoryStore(LATTICE, MODEL)
        self.peer, self.known = Peer("r2"), PeerChannel()
        self.near = near
        self.revision = 0

    def report(self, *keys: TileKey) -> None:
        self.revision += 1
        for key in keys:
            self.store.accept(replace(delta(key, self.revision), since=self.revision - 1))

    def hold(self, base: int, ahead: dict[TileKey, int] | None = None) -> None:
        self.known.known["r1"] = Known(base, ahead or {})

    def wants(self, settle_ns: float = 0.0) -> Wants:
        channel = Channel("fine", self.store, relay=True, near=self.near)
        return Wants(Holding(channel, Counter()), settle_ns)

    def order(self, wants: Wants, now_ns: int = 0) -> list[TileKey]:
        return [want.key for want in reversed(wants.of([(self.peer, self.known)], now_ns))]


def test_what_the_peer_has_nothing_of_goes_before_what_it_has_some_of() -> None:
    robot = Robot()
    for _ in range(9):
        robot.report(TileKey(0, 0))
    robot.report(TileKey(0, 0), TileKey(1, 0), TileKey(2, 0))
    robot.hold(0, {TileKey(0, 0): 9, TileKey(2, 0): 5})
    # 1 of tile (1, 0), of which it has nothing; of (2, 0) half of (10 - 5)/10, of (0, 0) half of (10 - 9)/10.
    assert robot.order(robot.wants()) == [TileKey(1, 0), TileKey(2, 0), TileKey(0, 0)]
    robot.hold(10)
    assert robot.order(robot.wants()) == []


def test_what_waits_goes_before_what_is_younger_by_half_a_minute() -> None:
    """Two tiles a second that nobody ever told, and budget for one; and one tile that is worth next to nothing."""
    robot = Robot()
    for _ in range(99):
        robot.report(TileKey(0, 0))
    robot.report(TileKey(0, 0))
    robot.hold(99)
    ahead: dict[TileKey, int] = {}
    wants = robot.wants()
    for second in range(200):
        robot.report(TileKey(1 + second, 0), TileKey(1 + second, 1))
        wants = _anew(robot, wants)
        first = robot.order(wants, second * SECOND_NS)[0]
        if first == TileKey(0, 0):
            break
        ahead[first] = robot.revision
        robot.hold(99, ahead)
    # After 30 s it is worth more than all that comes; what came before, 60 tiles, goes first: at one a second, 60 s.
    assert second <= 2 * AGE_NS / SECOND_NS


def _anew(robot: Robot, before: Wants) -> Wants:
    """With what is in the store now, and for how long it was wanted."""
    wants = robot.wants()
    wants._first_ns = before._first_ns
    return wants


def test_what_others_report_waits_until_peers_said_whether_they_overheard_it() -> None:
    robot = Robot()
    robot.report(TileKey(0, 0))
    wants = robot.wants(settle_ns=SECOND_NS)
    assert robot.order(wants, 0) == []
    assert robot.order(wants, SECOND_NS) == [TileKey(0, 0)]


def test_a_near_channel_is_for_those_who_are_near() -> None:
    """Tile (x, y) is from 2x to 2x + 2 m east."""
    robot = Robot(near=True)
    robot.report(*(TileKey(x, 0) for x in range(5)))
    wants = robot.wants()
    assert robot.order(wants) == []
    robot.peer.area = Bounds(3.0, -5.0, 6.0, 1.0)
    assert sorted(robot.order(wants)) == [TileKey(1, 0), TileKey(2, 0)]


def test_a_tile_s_worth_is_that_to_who_lacks_most_of_it() -> None:
    robot = Robot()
    robot.report(TileKey(0, 0))
    robot.report(TileKey(0, 0))
    robot.hold(1)
    other = PeerChannel(known={"r1": Known(0)})
    (want,) = robot.wants().of([(robot.peer, robot.known), (Peer("r3"), other)], 0)
    assert (want.since, want.worth) == (0, 1.0)
    assert np.isclose(robot.wants().of([(robot.peer, robot.known)], 0)[0].worth, 0.5 * 1 / 2)


def test_new_cells_of_a_known_tile_count_by_their_share() -> None:
    growth = Growth()
    tile = TileKey(0, 0)
    cells = delta(tile, 1).tiles[0].cells
    for revision, at in ((3, [0]), (7, [0, 1]), (9, [1, 2, 3])):
        records = np.repeat(cells, len(at))
        records["revision"] = revision
        growth.note(TileCells(tile, np.array(at, np.int32), records), 2)
    # Four cells at last; 1 at revision 3, 2 at 7.
    assert [growth.unknown(tile, since) for since in (0, 3, 5, 7, 9)] == [1.0, 0.75, 0.75, 0.5, 0.0]
    assert growth.unknown(TileKey(1, 0), 5) is None
