"""Columns as codes: as the reference, back again, and never beyond the bytes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from terrafuse.kernels import entropy
from terrafuse.kernels.entropy import ALWAYS, MOST, PLAIN, PREDICTED, SIGNED, Plan, Unpacked

SIDE = 8
KINDS = np.array([PLAIN, SIGNED, PREDICTED, PREDICTED])
WHERE = np.array([ALWAYS, ALWAYS, ALWAYS, 0])
PLAN = Plan(KINDS, WHERE, np.array([0, -MOST, -MOST, -MOST]), np.full(4, MOST))
SPREADS = (0, 1, 2, 5, 300, MOST)


def columns(seed: int, spread: int) -> Unpacked:
    """Tiles, cells and numbers at random; 0 where a column has none."""
    rng = np.random.default_rng(seed)
    counts = rng.integers(1, 1 + rng.integers(1, SIDE * SIDE + 1), rng.integers(1, 5))
    places = np.concatenate([np.sort(rng.choice(SIDE * SIDE, count, replace=False)) for count in counts])
    numbers = rng.integers(-spread, spread, (4, len(places)), endpoint=True)
    numbers[0] = np.minimum(abs(numbers[0]), 300) * (rng.random(len(places)) < 0.5)
    numbers[3, numbers[0] == 0] = 0
    keys = np.array(sorted({(x, y) for x, y in rng.integers(-spread, spread, (20, 2), endpoint=True).tolist()}))
    keys = np.concatenate([keys, keys[-1] + np.arange(1, 5)[:, None] * [0, 1]])[: len(counts)]
    table = rng.integers(0, spread, (2, 1 + int(numbers[0].max())), endpoint=True)
    return Unpacked(keys, np.cumsum([0, *counts]), table, places, numbers)


def packed(whole: Unpacked, plan: Plan = PLAN) -> bytes:
    return entropy.packed(whole, SIDE, plan)


def unpacked(data: bytes, tiles: int, cells: int, table: tuple[int, int] = (0, 3)) -> Unpacked | None:
    return entropy.unpacked(np.frombuffer(data, np.uint8), tiles, cells, table, SIDE, PLAN)


def assert_same(one: Unpacked | None, other: Unpacked) -> None:
    assert one is not None
    for found, given_ in zip(one, other, strict=True):
        np.testing.assert_array_equal(found, given_)


@given(seed=st.integers(0, 2**31), spread=st.sampled_from(SPREADS))
@settings(max_examples=100, deadline=None)
def test_what_is_packed_is_unpacked_as_the_reference_does(seed: int, spread: int) -> None:
    whole = columns(seed, spread)
    size = len(whole.keys), len(whole.places), whole.table.shape
    data = packed(whole)
    assert_same(unpacked(data, *size), whole)
    assert_same(entropy.read_reference(data, *size, SIDE, PLAN), whole)


@given(seed=st.integers(0, 2**31), spread=st.sampled_from(SPREADS), more=st.binary(min_size=1, max_size=3))
@settings(max_examples=50, deadline=None)
def test_bytes_too_few_or_too_many_are_none_or_within_bounds(seed: int, spread: int, more: bytes) -> None:
    whole = columns(seed, spread)
    size, data = (len(whole.keys), len(whole.places), whole.table.shape), packed(whole)
    for wrong in [*(data[:k] for k in range(len(data))), data + more]:
        assert_within_bounds(unpacked(wrong, *size), size[1], size[2][1])


@given(seed=st.integers(0, 2**31), place=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7))
@settings(max_examples=300, deadline=None)
def test_damaged_bytes_are_none_or_within_bounds(seed: int, place: float, bit: int) -> None:
    whole = columns(seed, 5)
    data = bytearray(packed(whole))
    data[int(place * len(data))] ^= 1 << bit
    size = len(whole.keys), len(whole.places), whole.table.shape
    assert_within_bounds(unpacked(bytes(data), *size), size[1], size[2][1])


@given(data=st.binary(max_size=80), tiles=st.integers(1, 5), cells=st.integers(1, 200))
@settings(max_examples=500, deadline=None)
def test_noise_is_none_or_within_bounds(data: bytes, tiles: int, cells: int) -> None:
    assert_within_bounds(unpacked(data, tiles, cells, (1, 3)), cells, 3)


def assert_within_bounds(out: Unpacked | None, cells: int, pairs: int) -> None:
    if out is None:
        return
    assert out.starts[[0, -1]].tolist() == [0, cells]
    assert (np.diff(out.starts) > 0).all()
    assert ((out.places >= 0) & (out.places < SIDE * SIDE)).all()
    assert (abs(out.numbers) <= MOST).all()
    assert ((out.numbers[0] >= 0) & (out.numbers[0] < pairs)).all()
    assert_rising(out)


def assert_rising(out: Unpacked) -> None:
    steps = np.diff(out.places, prepend=-1)
    steps[out.starts[:-1]] = 1
    assert (steps > 0).all()


def test_numbers_beyond_bounds_are_none() -> None:
    numbers = np.array([[0, 1, 2], [5, 5, 5], [1, 2, 4], [0, 0, 0]])
    whole = Unpacked(np.zeros((1, 2), int), np.array([0, 3]), np.empty((0, 3), int), np.array([0, 1, 9]), numbers)
    data = packed(whole)
    assert unpacked(data, 1, 3) is not None
    assert unpacked(data, 1, 3, (0, 2)) is None
    for column, most in ((1, 4), (2, 3)):
        highest = np.full(4, MOST)
        highest[column] = most
        plan = PLAN._replace(highest=highest)
        assert entropy.unpacked(np.frombuffer(data, np.uint8), 1, 3, (0, 3), SIDE, plan) is None


@pytest.mark.parametrize(("count", "sound"), [(1, True), (2, True), (3, False), (4, False), (2**46, False)])
def test_each_tile_has_cells(count: int, sound: bool) -> None:
    """Two tiles of three cells, the first of which has so many."""
    symbols = np.concatenate([np.zeros(4, np.int64), [count - 1], np.zeros(3 + 1 + 3 * 3, np.int64)])
    found = unpacked(entropy.write(symbols, np.array([2, 2, 1, 3, 1, 3, 3, 3])).tobytes(), 2, 3)
    assert (found is not None) == sound


@pytest.mark.parametrize("symbol", [0, 1, 2, 3, 4, 5, 8, 9, 2**20, 2**46])
def test_classes(symbol: int) -> None:
    # 0, 1, 2 by themselves; 3-4 are class 3, 5-8 class 4, 9-16 class 5, ...: class c holds 2^(c-2) + 1 to 2^(c-1).
    own = entropy.class_of(symbol)
    assert own == symbol if symbol <= 2 else 2 ** (own - 2) + 1 <= symbol <= 2 ** (own - 1)


def test_short_columns_are_plain() -> None:
    """The symbols 0, 6: mode 0 is 00, class 0 is 1, class 4 is 00001, of 5 to 8 the one after 5 is 1 in 2 bits: 10.

    From the last byte on, the lowest bit first: 00 1 00001, then 10: 0x84 and 0x01. Before them the state 2¹⁶.
    """
    assert entropy.write(np.array([0, 6]), np.array([2])).tobytes().hex() == "00000100" + "0184"


def test_columns_of_one_symbol_have_it_once() -> None:
    """Mode 2 is 01, class 4 is 00001, of 5 to 8 the one after 5 is 10: 01 00001 1, 0."""
    assert entropy.write(np.full(1000, 6), np.array([1000])).tobytes().hex() == "00000100" + "00c2"


def test_long_columns_have_a_table() -> None:
    """48 symbols 0, then 16 symbols 1.

    Plain: mode 1 is 10; two classes are 010000; weight 48 = 3 · 2⁴ is the level 2 · 4 + 3 = 11, so 1101; 16 = 2 · 2³
    is the level 8: 0001. From the last byte on: 10 010000 = 0x09; 1101 0001 = 0x8b.

    Shares are 48 · 1024 / 64 = 768 and 256; the writer goes from the last symbol to the first.
    """
    x, words = 1 << 16, []
    for shares, before in [(256, 768)] * 16 + [(768, 0)] * 48:
        if x >= shares << 22:
            words.append(x % 2**16)
            x >>= 16
        x = x // shares * 1024 + before + x % shares
    coded = b"".join(word.to_bytes(2, "little") for word in [x % 2**16, x >> 16, *reversed(words)])
    found = entropy.write(np.array([0] * 48 + [1] * 16), np.array([64])).tobytes()
    assert found.hex() == coded.hex() + "8b09"


@given(levels=st.lists(st.integers(0, 15), min_size=1, max_size=entropy.CLASSES))
def test_shares(levels: list[int]) -> None:
    shares = np.empty(len(levels), np.int64)
    if not entropy.share(np.array(levels), shares):
        assert not any(levels)
        return
    assert shares.tolist() == entropy.shares_reference(levels)
    assert shares.sum() == entropy.SHARES
    assert ((shares > 0) == (np.array(levels) > 0)).all()


def test_what_repeats_takes_little() -> None:
    symbols = np.tile([0, 7, 7, 0], 500)
    found = entropy.write(symbols, np.array([2000]))
    # A bit for each class, and 2 plain bits of each 7.
    assert len(found) < 30 + 2000 / 8 + 1000 * 2 / 8


def neighbours(*tiles: tuple[int, int, list[int]]) -> tuple[list[int], list[int]]:
    at = np.array([place for *_, places in tiles for place in places])
    west, north = np.empty((2, len(at)), np.int64)
    keys, starts = np.array([tile[:2] for tile in tiles]), np.cumsum([0, *(len(places) for *_, places in tiles)])
    entropy.neighbours(keys, starts, at, SIDE, west, north)
    return west.tolist(), north.tolist()


def test_neighbours() -> None:
    # Row 0: i = 0, 1, 7; row 1: i = 0, 2, 7. Cell 8 begins a row: 7 is not beside it.
    assert neighbours((0, 0, [0, 1, 7, 8, 10, 15])) == ([-1, 0, -1, -1, -1, -1], [-1, -1, -1, 0, -1, 2])
    # Row 0 and row 2: what lies two rows back is no neighbour.
    assert neighbours((0, 0, [3, 19])) == ([-1, -1], [-1, -1])
    # Row 7 of the tile below, then its row 0; but not of the tile beside, nor of one that is further.
    assert neighbours((0, 0, [56, 57]), (0, 1, [0, 1, 9])) == ([-1, 0, -1, 2, -1], [-1, -1, 0, 1, 3])
    for other in ((1, 1), (0, 2), (1, 0)):
        assert neighbours((0, 0, [56, 57]), (*other, [0, 1])) == ([-1, 0, -1, 2], [-1] * 4)


def expected(numbers: list[int], west: list[int], north: list[int]) -> int:
    """Of the last cell; what is symbols of it and of those before is their difference to that."""
    values, symbols = np.array(numbers), np.empty(len(numbers), np.int64)
    ends = np.array(west), np.array(north), -100, 100
    assert entropy.differences(entropy.PREDICTED, values, values[:0], *ends, symbols, False)
    again = np.empty_like(values)
    assert entropy.differences(entropy.PREDICTED, again, values[:0], *ends, symbols, True)
    assert again.tolist() == numbers
    return numbers[-1] - entropy.unfold_reference(int(symbols[-1]))


def test_what_neighbours_let_expect() -> None:
    # NW = 10, N = 14, W = 12: 12 + 14 - 10 = 16 is over both, so the larger: 14. NW = 13: 13, between them.
    for corner, value in ((10, 14), (13, 13), (20, 12)):
        assert expected([corner, 14, 12, 0], [-1, 0, -1, 2], [-1, -1, 0, 1]) == value
    assert expected([14, 13, 0], [-1, -1, 1], [-1, -1, 0]) == 13  # no NW: (13 + 14) / 2, rounded down
    assert expected([-14, -13, 0], [-1, -1, 1], [-1, -1, 0]) == -14
    assert expected([7, 9, 0], [-1, -1, 1], [-1, -1, -1]) == 9  # W
    assert expected([7, 9, 0], [-1, -1, -1], [-1, -1, 0]) == 7  # N
    assert expected([7, 9, 0], [-1, -1, -1], [-1, -1, -1]) == 9  # the one before
    assert expected([5], [-1], [-1]) == 0
