"""What is not let in: each attack has its word, is counted, and changes nothing."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from dataclasses import replace
from math import inf

import numpy as np
import pytest

from terrafuse.errors import CodecError, DeltaError, InputError
from terrafuse.exchange.codec import START, decode, encode
from terrafuse.exchange.delta import Delta, TileCells, map_id
from terrafuse.exchange.guard import MOST_PLACES, Guard, Policy, Quotas
from terrafuse.exchange.profiles import report
from terrafuse.lattice import Lattice
from terrafuse.models import make_model
from terrafuse.store.base import check_delta
from terrafuse.store.memory import MemoryStore
from terrafuse.testing.deltas import SECOND_NS, deltas_of, random_scans
from terrafuse.tile import opaque
from terrafuse.types import TileKey
from tests.exchange.golden import GOLDEN
from tests.exchange.make_golden import MODELS

LATTICE, MODEL = Lattice(0.5, 10.0), make_model("elevation")
MAP = map_id("elevation", LATTICE)
NOW = 100 * SECOND_NS
(GOOD,) = deltas_of("r4", random_scans(1, 1, extent_m=12.0), LATTICE, MODEL)
MOVED = replace(GOOD, tiles=tuple(replace(t, key=TileKey(t.key.x + 100, t.key.y)) for t in GOOD.tiles))
"""The same cells, a kilometre further east."""


def stamped(stamp_ns: int) -> Delta:
    """With one cell of this stamp."""
    tiles = [replace(tile, cells=tile.cells.copy()) for tile in GOOD.tiles]
    tiles[-1].cells["stamp"][-1] = stamp_ns
    return replace(GOOD, tiles=tuple(tiles))


def guard(**quotas: float) -> Guard:
    """Robots r1 to r9 report themselves, `station` relays; all that a guard can ask for is asked for."""
    out = Guard(MAP, Quotas(**({"reach_m": 50.0} | quotas)), Policy(["station"], {"van": ["r4", "r5"]}))
    out.place("r4", 0.0, 0.0, NOW - SECOND_NS)
    return out


def state(one: Guard) -> object:
    robots = {name: (sorted(own.tiles), list(own.places), own.heard_ns) for name, own in one._robots.items()}
    return robots, {name: (b.allowed, b.at_ns) for name, b in one._buckets.items()}, one._tiles


@pytest.mark.parametrize("sender", ["r4", "station", "van"])
def test_what_is_right_comes_in(sender: str) -> None:
    one = guard()
    assert one.screen(sender, encode(GOOD)) is None
    assert one.check(sender, GOOD, NOW, 1000) is None
    assert not one.counts


ATTACKS: dict[str, tuple[str, Callable[[Guard], str | None]]] = {
    "another's contributions": ("sender", lambda one: one.check("r5", GOOD, NOW, 1000)),
    "a relay of some": ("sender", lambda one: one.check("van", replace(GOOD, robot="r6"), NOW, 1000)),
    "another model": ("map", lambda one: one.check("r4", replace(GOOD, map=replace(MAP, model="grey")), NOW, 9)),
    "another lattice": ("map", lambda one: one.check("r4", replace(GOOD, map=replace(MAP, tile_m=20.0)), NOW, 9)),
    "another CRS": ("map", lambda one: one.check("r4", replace(GOOD, map=replace(MAP, crs="EPSG:3857")), NOW, 9)),
    "too many bytes": ("size", lambda one: one.check("r4", GOOD, NOW, 2 << 20)),
    "a delta from the future": ("clock", lambda one: one.check("r4", replace(GOOD, stamp_ns=NOW * 2), NOW, 9)),
    "a cell from the future": ("clock", lambda one: one.check("r4", stamped(NOW + 61 * SECOND_NS), NOW, 9)),
    "a kilometre away": ("distance", lambda one: one.check("r4", MOVED, NOW, 9)),
    "nobody knows where": ("place", lambda one: one.check("r5", replace(GOOD, robot="r5"), NOW, 9)),
}  # fmt: skip


@pytest.mark.parametrize("attack", ATTACKS)
def test_attacks(attack: str) -> None:
    reason, act = ATTACKS[attack]
    one = guard()
    before = state(one)
    assert act(one) == reason
    assert one.counts == {reason: 1}
    assert state(one) == before
    assert one.check("r4", GOOD, NOW, 1000) is None


def test_bytes_are_screened_before_they_are_unpacked() -> None:
    one = guard(message_bytes=5000, message_cells=GOOD.cell_count - 1)
    message = encode(GOOD)
    assert one.screen("r4", bytes(5001)) == "size"
    assert one.screen("r4", message[:-1]) == "damaged"
    assert one.screen("r5", message) == "sender"
    assert one.screen("r4", message) == "size"
    assert Guard(replace(MAP, model="grey")).screen("r4", message) == "map"
    assert one.counts == {"size": 2, "damaged": 1, "sender": 1}


def test_a_clock_may_be_a_little_ahead() -> None:
    assert guard().check("r4", stamped(NOW + 59 * SECOND_NS), NOW, 9) is None
    assert guard(ahead_s=5.0).check("r4", stamped(NOW + 6 * SECOND_NS), NOW, 9) == "clock"


def test_a_flood_is_refused_until_the_rate_allows_more() -> None:
    one = guard(bytes_per_s=100.0, burst_s=10.0)
    assert [one.check("r4", GOOD, NOW, 400) for _ in range(4)] == [None, None, "rate", "rate"]
    # 200 of 1000 bytes are left; after 2 s there are 400.
    assert one.check("r4", GOOD, NOW + SECOND_NS, 400) == "rate"
    assert one.check("r4", GOOD, NOW + 2 * SECOND_NS, 400) is None
    assert one.check("station", GOOD, NOW, 400) is None
    # A message of more than the burst is paid for later: after 10 s it lacks 500 of 1000 bytes, after 15 s none.
    assert [one.check("r4", GOOD, 5 * NOW + s * SECOND_NS, 1500) for s in (0, 10, 14, 15)] == [
        None,
        *["rate"] * 2,
        None,
    ]
    # Never more than the burst, however long it was silent.
    assert [one.check("r4", GOOD, 10 * NOW, 600) for _ in range(2)] == [None, "rate"]


def test_a_robot_has_so_many_tiles_and_so_much_ground() -> None:
    count = len(GOOD.tiles)
    for quota, reason in (
        ({"tiles": count}, "tiles"),
        ({"area_m2": count * 100.0}, "area"),
        ({"all_tiles": count}, "tiles"),
    ):
        one = guard(reach_m=inf, **quota)
        assert one.check("r4", GOOD, NOW) is None
        assert one.check("r4", GOOD, NOW) is None
        assert one.check("r4", MOVED, NOW) == reason
        again = guard(reach_m=inf, **quota)
        again.remember("r4", [tile.key for tile in MOVED.tiles])
        assert again.check("r4", GOOD, NOW) == reason


def test_where_a_robot_was_counts_and_where_it_may_have_been() -> None:
    one = guard()
    for second in range(200):  # 1 km east at 5 m/s
        one.place("r4", 5.0 * second, 0.0, NOW + second * SECOND_NS)
    assert one.check("r4", MOVED, NOW * 4) is None
    assert one.check("r4", GOOD, NOW * 4) is None
    north = replace(GOOD, tiles=tuple(replace(t, key=TileKey(t.key.x, t.key.y + 100)) for t in GOOD.tiles))
    assert one.check("r4", north, NOW * 4) == "distance"
    # Not heard of for 100 s, it may have gone 1 km at 10 m/s and come back.
    one.place("r4", 1000.0, 0.0, NOW + 299 * SECOND_NS)
    one.place("r4", 0.0, 0.0, NOW + 399 * SECOND_NS)
    assert one.check("r4", north, NOW * 5) is None


def test_memory_is_bounded() -> None:
    one = guard(robots=3, tiles=1000, all_tiles=1000)
    for k in range(10 * MOST_PLACES):
        one.place("r4", 100.0 * k, 0.0, NOW + k)
    assert len(one._robots["r4"].places) == MOST_PLACES
    for k in range(100):
        one.place(f"x{k}", 0.0, 0.0, NOW)
        one.remember(f"y{k}", [TileKey(0, 0)])
    assert len(one._robots) == 3
    assert one.check("r9", replace(GOOD, robot="r9"), NOW) == "place"
    lax = guard(robots=3, reach_m=inf)
    assert [lax.check(f"r{k}", replace(GOOD, robot=f"r{k}"), NOW) for k in (4, 1, 2, 3)] == [None] * 3 + ["robots"]
    assert len(lax._buckets) == 3


@pytest.mark.parametrize("quota", ["tiles", "robots", "message_cells", "all_tiles"])
def test_what_bounds_memory_is_finite(quota: str) -> None:
    with pytest.raises(InputError, match=f"quota {quota} bounds memory"):
        Quotas(**{quota: inf})
    with pytest.raises(InputError, match=f"quota {quota} 0: give a positive number"):
        Quotas(**{quota: 0})


# --- mutated messages -------------------------------------------------------------------------------------------------

MESSAGES = {
    "golden": GOLDEN["elevation lean"],
    "exact": encode(GOOD),
    "full": encode(report(GOOD, "full", MODEL)),
    "lean": encode(report(GOOD, "lean", MODEL)),
}
EACH = 30_000


def mutants(message: bytes, others: list[bytes], count: int, seed: int) -> list[bytes]:
    """Cut, lengthened, with flipped bits, with stretches of other messages, zeroed, doubled or swapped."""
    rng = np.random.default_rng(seed)
    out = []
    for kind, a, b, c in rng.integers(0, 2**31, (count, 4)).tolist():
        at, n = a % len(message), 1 + b % 16
        if kind % 7 == 0:
            out.append(message[:at])
        elif kind % 7 == 1:
            out.append(message + rng.bytes(n))
        elif kind % 7 == 2:
            out.append(message[:at] + bytes([message[at] ^ (1 << (b % 8))]) + message[at + 1 :])
        elif kind % 7 == 3:
            other = others[c % len(others)]
            out.append(message[:at] + other[b % len(other) :])
        elif kind % 7 == 4:
            out.append(message[:at] + bytes(n) + message[at + n :])
        elif kind % 7 == 5:
            out.append(message[:at] + message[at : at + n] * 2 + message[at + n :])
        else:
            out.append(message[at:] + message[:at])
    return out


@pytest.mark.parametrize("name", MESSAGES)
def test_damaged_messages_are_refused_or_say_the_same(name: str) -> None:
    """120,000 in all. What comes through is what was sent: a mutation that changed nothing."""
    message, others = MESSAGES[name], list(MESSAGES.values())
    same = 0
    for mutant in mutants(message, others, EACH, 1):
        try:
            delta = decode(mutant, MODEL.cell)
        except CodecError:
            continue
        assert mutant in others
        assert encode(delta) == mutant or name == "exact"
        same += 1
    assert same < EACH / 50


def resealed(mutant: bytes) -> bytes:
    """With a right checksum, as an attacker would make it."""
    return mutant[:-4] + struct.pack("<I", zlib.crc32(mutant[:-4]))


@pytest.mark.parametrize("name", ["full", "lean", "exact"])
def test_forged_messages_are_refused_or_could_have_been_sent(name: str) -> None:
    """Checksums right: some lies spell another delta that may be. None spells one that may not, and none breaks."""
    message, others = MESSAGES[name], list(MESSAGES.values())
    store = MemoryStore(LATTICE, MODEL)
    spelt = 0
    for mutant in mutants(message, others, 4000, 2):
        try:
            delta = decode(resealed(mutant), MODEL.cell, most_cells=10_000)
            check_delta(delta, store.map, store.model)
        except (CodecError, DeltaError):
            continue
        spelt += 1
        again = decode(encode(delta), MODEL.cell)
        for one, other in zip(delta.tiles, again.tiles, strict=True):
            assert (opaque(one.cells) == opaque(other.cells)).all()
    assert spelt < 4000


@pytest.mark.parametrize("name", [name for name in GOLDEN if not name.startswith("elevation")])
def test_damaged_messages_of_other_models_are_refused(name: str) -> None:
    cell = MODELS[name.split()[0]].cell
    for mutant in mutants(GOLDEN[name], list(GOLDEN.values()), 1000, 3):
        try:
            assert encode(decode(mutant, cell)) in GOLDEN.values()
        except CodecError:
            continue
        assert mutant in GOLDEN.values()


def test_a_small_message_can_not_ask_for_much_memory() -> None:
    """Cells that are all alike take next to no bytes: their number is bounded before memory is."""
    side = 4096
    at = np.arange(1 << 18, dtype=np.int32)
    cells = np.zeros(len(at), MODEL.cell)
    cells["n"], cells["merges"], cells["revision"] = 1, 1, 1
    flat = Delta(map_id("elevation", Lattice(0.01, side * 0.01)), "r4", 0, 1, 0, (TileCells(TileKey(0, 0), at, cells),))
    message = encode(flat)
    assert len(message) < 2000
    with pytest.raises(CodecError, match="more than 1000 cells"):
        decode(message, MODEL.cell, most_cells=1000)
    assert Guard(flat.map, Quotas(message_cells=1000)).screen("r4", message) == "size"
    assert START.unpack_from(message)[2] == 2
