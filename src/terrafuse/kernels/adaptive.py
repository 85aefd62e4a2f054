"""Columns of small numbers as few bytes: an adaptive binary range coder, and the differences that it is fed with.

A symbol s ≥ 0 falls into a class: 0, 1 and 2 are classes by themselves, class c from 3 on holds the 2ᶜ⁻² symbols from
2ᶜ⁻² + 1 on. The class is sent in unary, its bits coded by how often they were what. That is learnt while coding:
nothing is sent for it, so that messages of a hundred cells gain, too. Which symbol of its class it is, is close to
noise and stands in c - 2 plain bits. Two streams share the bytes: coded bits from the front, plain ones from the end.

The coder is LZMA's: 32 bits of range, carries passed on. Decoding trusts nothing: it says False where bytes run out,
are left over, or spell a number that can't be.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from terrafuse.types import Array

DIRECT = 2
"""The largest symbol that is a class by itself; a class c above it has c - 2 plain bits."""
MOST_CLASS = 48
"""So that numbers stay below 2⁴⁷, and sums of a few within 63 bits."""
CLASSES = MOST_CLASS + 1
CONTEXTS = 4
"""A class is learnt apart by the class of the symbol before it in the column: 0, 1, 2, or more; but not in columns of
differences, where that tells little and must be learnt four times."""
ONE, HALF = 1 << 16, 1 << 15
"""Probabilities in 1/65536."""
STEADY = 62
"""A bit that comes after n others of its kind counts 1/(n + 2), but never less than 1/64."""
SHARE = np.array([ONE // (n + 2) for n in range(STEADY + 1)])
RENEW, FULL_RANGE = 1 << 24, (1 << 32) - 1

PLAIN, SIGNED, PREDICTED = range(3)
"""What a column's symbols are: its numbers, which are ≥ 0; its numbers, folded (0, -1, 1, -2, ...); their differences
to what the neighbours let expect, folded."""
MOST = 1 << 44
"""No number is further from 0."""
ALWAYS = -1
"""A column that has a symbol for each cell, not only where another column is not 0."""


class Plan(NamedTuple):
    """What columns hold, (C,) int64 each: their kinds, where they have symbols (where that column is not 0, or ALWAYS),
    their least and greatest numbers."""

    kinds: Array
    where: Array
    lowest: Array
    highest: Array


@njit(inline="always")
def fold(number):
    return (number << 1) ^ (number >> 63)


@njit(inline="always")
def unfold(symbol):
    return (symbol >> 1) ^ -(symbol & 1)


@njit(inline="always")
def middle(a, b, c):
    """Of a, b and a + b - c."""
    low, high = min(a, b), max(a, b)
    return max(low, min(high, a + b - c))


@njit(cache=True, nogil=True)
def neighbours(keys, starts, at, side, west, north):
    """Of each cell the number of the one at (i - 1, j) in its tile, `west`, and of the one at (i, j - 1), `north`, as
    pictures have it, be it in the tile (x, y - 1) just before; -1 where there is none.

    at (K,) flat positions, rising within each tile; tile t, keys[t], holds starts[t]:starts[t + 1].
    """
    latest, rows, oldest = np.full(side, -1, np.int64), np.empty(side, np.int64), np.int64(0)
    for t in range(starts.shape[0] - 1):
        first = starts[t]
        if t > 0 and (keys[t, 0] != keys[t - 1, 0] or keys[t, 1] != keys[t - 1, 1] + 1):
            oldest = first
        for k in range(first, starts[t + 1]):
            row, i = keys[t, 1] * side + at[k] // side, at[k] % side
            west[k] = k - 1 if i > 0 and k > first and at[k - 1] == at[k] - 1 else -1
            north[k] = latest[i] if latest[i] >= oldest and rows[i] == row - 1 else -1
            latest[i], rows[i] = k, row


@njit(cache=True, nogil=True)
def differences(kind, numbers, other, west, north, lowest, highest, symbols, back):
    """One column's numbers (K,) → its symbols, one after the other, or `back`; False for numbers out of bounds.

    `other`: the column that is not 0 where this one has symbols, and numbers that are not 0; empty where it has all.
    What cell k's neighbours let expect is LOCO-I's median of W, N and W + N - NW; else the one there is; else the cell
    before. (A function of the arrays, called for each cell, would take ten times as long: Numba counts references.)
    """
    every, following = other.shape[0] == 0, 0
    for k in range(numbers.shape[0]):
        if not every and other[k] == 0:
            if back:
                numbers[k] = 0
            continue
        guess = np.int64(0)
        if kind == PREDICTED:
            w, n = west[k], north[k]
            if w >= 0 and n >= 0:
                a, b, corner = numbers[w], numbers[n], north[w]
                guess = (a + b) >> 1 if corner < 0 else middle(a, b, numbers[corner])
            elif w >= 0 or n >= 0:
                guess = numbers[max(w, n)]
            elif k > 0:
                guess = numbers[k - 1]
        if back:
            symbol = symbols[following]
            number = guess + (symbol if kind == PLAIN else unfold(symbol))
            if number < lowest or number > highest:
                return False
            numbers[k] = number
        else:
            symbols[following] = numbers[k] if kind == PLAIN else fold(numbers[k] - guess)
        following += 1
    return True


@njit(inline="always")
def class_of(symbol):
    if symbol <= DIRECT:
        return symbol
    bits = 1
    while (symbol - 1) >> (bits + 1):
        bits += 1
    return DIRECT + bits


# --- writing ----------------------------------------------------------------------------------------------------------


@njit(inline="always")
def _shift(low, out, front, held, pending, begun):
    """Give out the highest byte of `low` once no carry can change it any more."""
    if low < 0xFF000000 or low > FULL_RANGE:
        carry = low >> 32
        if begun:
            out[front] = (held + carry) & 255
            front += 1
        for _ in range(pending):
            out[front] = (255 + carry) & 255
            front += 1
        return front, (low >> 24) & 255, 0, True
    return front, held, pending + 1, begun


@njit(cache=True, nogil=True)
def write(symbols, counts, contexts, out):
    """Columns of symbols, counts[c] each, one after the other, learnt in contexts[c] → how many bytes of `out` they
    take; 0 if it is too small."""
    chance, seen = np.empty(CONTEXTS * CLASSES, np.int64), np.empty(CONTEXTS * CLASSES, np.int64)
    low, range_, held, pending, begun = 0, FULL_RANGE, 0, 0, False
    front, back, plain, plain_bits, first = 0, out.shape[0], 0, 0, 0
    for c in range(counts.shape[0]):
        chance[:], seen[:], before = HALF, 0, 0
        for k in range(first, first + counts[c]):
            symbol = symbols[k]
            own = class_of(symbol)
            for step in range(own + 1):
                place = before * CLASSES + step
                p, share = chance[place], SHARE[seen[place]]
                seen[place] = min(seen[place] + 1, STEADY)
                bound = (range_ >> 16) * p
                if step == own:
                    range_ = bound
                    chance[place] = p + (((ONE - p) * share) >> 16)
                else:
                    low += bound
                    range_ -= bound
                    chance[place] = p - ((p * share) >> 16)
                while range_ < RENEW:
                    range_ <<= 8
                    if front + pending + 16 > back:
                        return 0
                    front, held, pending, begun = _shift(low, out, front, held, pending, begun)
                    low = (low & 0xFFFFFF) << 8
            if own > DIRECT:
                plain |= (symbol - 1 - (1 << (own - DIRECT))) << plain_bits
                plain_bits += own - DIRECT
                while plain_bits >= 8:
                    if front + pending + 16 > back:
                        return 0
                    back -= 1
                    out[back] = plain & 255
                    plain >>= 8
                    plain_bits -= 8
            before = min(own, contexts[c] - 1)
        first += counts[c]
    for _ in range(5):
        front, held, pending, begun = _shift(low, out, front, held, pending, begun)
        low = (low & 0xFFFFFF) << 8
    if plain_bits:
        back -= 1
        out[back] = plain & 255
    for k in range(back, out.shape[0]):
        out[front + k - back] = out[k]
    return front + out.shape[0] - back


# --- reading ----------------------------------------------------------------------------------------------------------


CODE, RANGE, FRONT, BACK, PLAIN_BITS, PLAIN_COUNT = range(6)
"""Where reading is, as an array: the coded stream's code and range, where both streams go on, plain bits at hand and
how many."""


@njit(cache=True, nogil=True)
def _begin(data):
    code = (np.int64(data[0]) << 24) | (np.int64(data[1]) << 16) | (np.int64(data[2]) << 8) | np.int64(data[3])
    return np.array([code, FULL_RANGE, 4, data.shape[0], 0, 0])


@njit(cache=True, nogil=True)
def _symbols(data, at, contexts, symbols):
    """The next column, (N,); False where the bytes end before.

    A whole column in one function, and what it counts with in locals: a function for a symbol takes ten times as long.
    Indices are unsigned, or Numba would ask of each whether it counts from the end.
    """
    chance, seen = np.full(CONTEXTS * CLASSES, HALF, np.int64), np.zeros(CONTEXTS * CLASSES, np.int64)
    code, range_, front, back, plain, plain_count = at[0], at[1], at[2], at[3], at[4], at[5]
    first = np.uint64(0)
    for k in range(symbols.shape[0]):
        here, ends = first, False
        while not ends:
            p, n = chance[here], seen[here]
            seen[here] = n + (n < STEADY)
            bound = (range_ >> 16) * p
            ends = code < bound
            if ends:
                range_ = bound
                chance[here] = p + (((ONE - p) * SHARE[np.uint64(n)]) >> 16)
            else:
                code -= bound
                range_ -= bound
                chance[here] = p - ((p * SHARE[np.uint64(n)]) >> 16)
                here += np.uint64(1)
                if here > first + np.uint64(MOST_CLASS):
                    return False
            while range_ < RENEW:
                if front >= back:
                    return False
                range_ <<= 8
                code = (code << 8) | np.int64(data[np.uint64(front)])
                front += 1
        own = np.int64(here - first)
        symbol, bits = own, own - DIRECT
        if bits > 0:
            while plain_count < bits:
                if front >= back:
                    return False
                back -= 1
                plain |= np.int64(data[np.uint64(back)]) << plain_count
                plain_count += 8
            symbol = (np.int64(1) << bits) + (plain & ((np.int64(1) << bits) - 1)) + 1
            plain >>= bits
            plain_count -= bits
        symbols[k] = symbol
        first = np.uint64(CLASSES * min(own, contexts - 1))
    at[0], at[1], at[2], at[3], at[4], at[5] = code, range_, front, back, plain, plain_count
    return True


@njit(cache=True, nogil=True)
def _tiles(data, at, cells, keys, starts):
    """Differences of x, of y, and counts less one → keys (T, 2), starts (T + 1,); False unless there are so many cells,
    and all keys below 2⁴⁴."""
    tiles = keys.shape[0]
    symbols = np.empty(tiles, np.int64)
    for c in range(2):
        if not _symbols(data, at, CONTEXTS, symbols):
            return False
        value = np.int64(0)
        for t in range(tiles):
            value += unfold(symbols[t])
            if abs(value) > MOST:
                return False
            keys[t, c] = value
    if not _symbols(data, at, CONTEXTS, symbols):
        return False
    starts[0] = 0
    for t in range(tiles):
        if symbols[t] >= cells - starts[t]:
            return False
        starts[t + 1] = starts[t] + symbols[t] + 1
    return starts[tiles] == cells


@njit(cache=True, nogil=True)
def _places(gaps, starts, cells, places):
    """Gaps between positions → positions; False if one is not below `cells`."""
    for t in range(starts.shape[0] - 1):
        free = np.int64(0)
        for k in range(starts[t], starts[t + 1]):
            place = free + gaps[k]
            if place >= cells:
                return False
            places[k] = place
            free = place + 1
    return True


@njit(cache=True, nogil=True)
def _column(data, at, kind, other, west, north, lowest, highest, symbols, numbers):
    """The next column's numbers, likewise; False where it has none."""
    every, alike = other.shape[0] == 0, np.empty(1, np.int64)
    if not _symbols(data, at, CONTEXTS, alike):
        return False
    if alike[0] > 0:
        number = unfold(alike[0] - 1)
        for k in range(numbers.shape[0]):
            numbers[k] = number if every or other[k] != 0 else 0
        return lowest <= number <= highest
    own = symbols if every else symbols[: np.count_nonzero(other)]
    contexts = CONTEXTS if kind == PLAIN else 1
    if not _symbols(data, at, contexts, own):
        return False
    return differences(kind, numbers, other, west, north, lowest, highest, own, True)


@njit(cache=True, nogil=True)
def read(data, side, kinds, where, lowest, highest, keys, starts, table, places, numbers):
    """data (B,) uint8 → keys (T, 2), starts (T + 1,), table (R, P) of numbers ≥ 0, places (K,), numbers (C, K); False
    unless it is just these.

    Tile t of `side`² cells, keys[t], holds starts[t]:starts[t + 1] of the cells. Numbers of column c are lowest[c] to
    highest[c].
    """
    if data.shape[0] < 4:
        return False
    at, cells = _begin(data), places.shape[0]
    if not _tiles(data, at, cells, keys, starts):
        return False
    for row in range(table.shape[0]):
        if not _symbols(data, at, CONTEXTS, table[row]):
            return False
    symbols = np.empty(cells, np.int64)
    if not _symbols(data, at, CONTEXTS, symbols) or not _places(symbols, starts, np.int64(side) * side, places):
        return False
    west, north = np.empty(cells, np.int64), np.empty(cells, np.int64)
    neighbours(keys, starts, places, side, west, north)
    for c in range(numbers.shape[0]):
        other = numbers[where[c]] if where[c] >= 0 else symbols[:0]
        if not _column(data, at, kinds[c], other, west, north, lowest[c], highest[c], symbols, numbers[c]):
            return False
    return at[FRONT] == at[BACK] and at[PLAIN_BITS] == 0


# --- for whoever has arrays -------------------------------------------------------------------------------------------


class Unpacked(NamedTuple):
    """What a body holds: int64, but for places, which may be int32."""

    keys: Array
    """(T, 2), rising."""
    starts: Array
    """(T + 1,): tile t holds starts[t]:starts[t + 1] of the cells, one at least."""
    table: Array
    """(R, P) of numbers ≥ 0 that cells refer to."""
    places: Array
    """(K,) flat positions, rising within each tile."""
    numbers: Array
    """(C, K), within the plan's bounds, and 0 where the plan has none; the first row is below P."""


def packed(whole: Unpacked, side: int, plan: Plan) -> bytes:
    """All that there is of so many tiles of `side`² cells, as bytes."""
    keys, starts, table, places, numbers = whole
    west, north = np.empty(len(places), np.int64), np.empty(len(places), np.int64)
    neighbours(keys, starts, places, side, west, north)
    gaps = np.diff(places, prepend=-1) - 1
    gaps[starts[:-1]] = places[starts[:-1]]
    columns = [_folded(np.diff(keys[:, 0], prepend=0)), _folded(np.diff(keys[:, 1], prepend=0)), np.diff(starts) - 1]
    columns += [*table, gaps]
    for own, kind, where, low, high in zip(numbers, *plan, strict=True):
        other = numbers[where] if where >= 0 else own[:0]
        chosen = own[other != 0] if where >= 0 else own
        alike = len(chosen) == 0 or bool((chosen == chosen[0]).all())
        symbols = np.empty(0 if alike else len(chosen), np.int64)
        if not alike:
            differences(kind, own, other, west, north, low, high, symbols, False)
        columns.append(1 + _folded(chosen[:1] if len(chosen) else np.zeros(1, np.int64)) if alike else NONE_ALIKE)
        columns.append(symbols)
    every, counts = np.concatenate(columns), np.array([len(column) for column in columns])
    contexts = np.full(len(columns), CONTEXTS)
    contexts[len(columns) - 2 * len(numbers) + 1 :: 2][plan.kinds != PLAIN] = 1
    room = 64 + len(every)
    while not (used := write(every, counts, contexts, out := np.empty(room, np.uint8))):
        room *= 4
    return out[:used].tobytes()


NONE_ALIKE = np.zeros(1, np.int64)


def _folded(numbers: Array) -> Array:
    return (numbers << 1) ^ (numbers >> 63)


def unpacked(data: Array, tiles: int, cells: int, table: tuple[int, int], side: int, plan: Plan) -> Unpacked | None:
    """The inverse of `packed`, of so many tiles, cells, and rows and columns of the table; None for bytes that are not
    just these."""
    highest = plan.highest.copy()
    highest[0] = table[1] - 1
    out = Unpacked(
        np.empty((tiles, 2), np.int64),
        np.empty(tiles + 1, np.int64),
        np.empty(table, np.int64),
        np.empty(cells, np.int32),
        np.empty((len(plan.kinds), cells), np.int64),
    )
    return out if read(data, side, plan.kinds, plan.where, plan.lowest, highest, *out) else None


# --- the same, to be read ---------------------------------------------------------------------------------------------


class ReaderReference:
    """The two streams of a body, read bit by bit: what `read` must equal."""

    def __init__(self, data: bytes) -> None:
        self.data, self.front, self.back = data, 4, len(data)
        self.range, self.code = FULL_RANGE, int.from_bytes(data[:4], "big")
        self.plain, self.plain_bits = 0, 0

    def coded(self, model: dict[tuple[int, int], tuple[int, int]], key: tuple[int, int]) -> bool:
        p, n = model.get(key, (HALF, 0))
        bound, share = (self.range >> 16) * p, ONE // (n + 2)
        ends = self.code < bound
        if ends:
            self.range, p = bound, p + ((ONE - p) * share >> 16)
        else:
            self.code, self.range, p = self.code - bound, self.range - bound, p - (p * share >> 16)
        model[key] = p, min(n + 1, STEADY)
        while self.range < RENEW:
            self.range, self.code = self.range << 8, self.code << 8 | self.data[self.front]
            self.front += 1
        return ends

    def lower(self, count: int) -> int:
        while self.plain_bits < count:
            self.back -= 1
            self.plain |= self.data[self.back] << self.plain_bits
            self.plain_bits += 8
        bits = self.plain & ((1 << count) - 1)
        self.plain >>= count
        self.plain_bits -= count
        return bits

    def column(self, count: int, contexts: int = CONTEXTS) -> list[int]:
        """The next `count` symbols, all of one column."""
        model: dict[tuple[int, int], tuple[int, int]] = {}
        out, before = [], 0
        for _ in range(count):
            own = 0
            while not self.coded(model, (before, own)):
                own += 1
            bits = max(own - DIRECT, 0)
            out.append(own if own <= DIRECT else (1 << bits) + self.lower(bits) + 1)
            before = min(own, contexts - 1)
        return out


def unfold_reference(symbol: int) -> int:
    return -(symbol + 1) // 2 if symbol % 2 else symbol // 2


def expected_reference(numbers: dict[tuple[int, int, int], int], x: int, j: int, i: int, last: int) -> int:
    """What `expected` must equal, of numbers by (tile's x, row of all tiles, column of the tile)."""
    w, n = numbers.get((x, j, i - 1)), numbers.get((x, j - 1, i))
    if w is None or n is None:
        return next((number for number in (w, n) if number is not None), last)
    corner = numbers.get((x, j - 1, i - 1))
    return (w + n) // 2 if corner is None else sorted((w, n, w + n - corner))[1]


def read_reference(data: bytes, tiles: int, cells: int, table: tuple[int, int], side: int, plan: Plan) -> Unpacked:
    """What `unpacked` must equal, of bytes that are sound."""
    reader = ReaderReference(data)
    x, y = (np.cumsum([unfold_reference(symbol) for symbol in reader.column(tiles)]) for _ in range(2))
    counts = [symbol + 1 for symbol in reader.column(tiles)]
    rows = np.array([reader.column(table[1]) for _ in range(table[0])], np.int64)
    tile_of = [t for t, count in enumerate(counts) for _ in range(count)]
    places: list[int] = []
    for k, gap in enumerate(reader.column(cells)):
        places.append(gap if k == 0 or tile_of[k] != tile_of[k - 1] else places[-1] + 1 + gap)
    columns: list[list[int]] = []
    for kind, other in zip(plan.kinds.tolist(), plan.where.tolist(), strict=True):
        chosen = [k for k in range(cells) if other == ALWAYS or columns[other][k]]
        (alike,) = reader.column(1)
        if alike:
            column = [0] * cells
            for k in chosen:
                column[k] = unfold_reference(alike - 1)
            columns.append(column)
            continue
        contexts = CONTEXTS if kind == PLAIN else 1
        symbols = dict(zip(chosen, reader.column(len(chosen), contexts), strict=True))
        found: dict[tuple[int, int, int], int] = {}
        column = []
        for k in range(cells):
            number = symbols.get(k, 0) if kind == PLAIN else unfold_reference(symbols.get(k, 0))
            j, i = divmod(places[k], side)
            place = int(x[tile_of[k]]), int(y[tile_of[k]]) * side + j, i
            if kind == PREDICTED and k in symbols:
                number += expected_reference(found, *place, column[-1] if column else 0)
            found[place] = number
            column.append(number)
        columns.append(column)
    starts = np.cumsum([0, *counts])
    keys = np.stack([x, y], axis=1)
    return Unpacked(keys, starts, rows, np.array(places, np.int32), np.array(columns, np.int64))
