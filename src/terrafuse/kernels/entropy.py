"""Columns of small numbers as few bytes: a table-driven entropy coder, and the differences that it is fed with.

A symbol s ≥ 0 falls into a class: 0, 1 and 2 are classes by themselves, class c from 3 on holds the 2ᶜ⁻² symbols from
2ᶜ⁻² + 1 on. Which class it is, is coded by how frequent classes are in the column. Which symbol of its class it is, is
close to noise and stands in c - 2 plain bits. Two streams share the bytes: coded classes from the front, plain bits
from the end.

The coder is rANS (Duda 2013, arXiv:1311.2540): a symbol is read by one look into a table, without a branch. A column's
table is sent before it, roughly, so that messages of a hundred cells gain, too: a class's weight takes four bits. Short
columns go without. Decoding trusts nothing: it says False where bytes run out, are left over, or spell a number that
can't be.
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
UNARY, TABLE, ALIKE = range(3)
"""How a column is written, in MODE_BITS: classes in plain bits, c zeros and a one; by a table; a single symbol, UNARY,
which all are."""
MODE_BITS, COUNT_BITS, WEIGHT_BITS = 2, 6, 4
"""Of a table: how many classes it has, and the weight of each, a level of one bit (`exchange.profiles`). With five bits
long columns would gain a thousandth, and messages of a hundred cells lose a fiftieth."""
MOST_WEIGHT = 3 << 6
"""The number of the largest level."""
SHARE_BITS = 10
SHARES = 1 << SHARE_BITS
"""Of a table, that its classes have together."""
WORD_BITS = 16
RENEW = 1 << WORD_BITS
"""The coder's state is this at least, and below 2³²."""

PLAIN, SIGNED, PREDICTED = range(3)
"""What a column's symbols are: its numbers, which are ≥ 0; its numbers, folded (0, -1, 1, -2, ...); their differences
to what the neighbours let expect, folded."""
WAYS = np.array([PLAIN, PREDICTED])
"""Of the first column of numbers: which of both it is, a column of one symbol before it says."""
MOST = 1 << 44
"""No number is further from 0."""
ALWAYS = -1
"""A column that has a symbol for each cell, not only where another column is not 0."""


class Plan(NamedTuple):
    """What columns hold, (C,) int64 each: their kinds, where they have symbols (where that column is not 0, or ALWAYS),
    their least and greatest numbers. The first one is PLAIN, but PREDICTED where that takes less."""

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


# --- tables -----------------------------------------------------------------------------------------------------------


@njit(inline="always")
def weight_of(level):
    shift = max((level >> 1) - 1, 0)
    return (level - (shift << 1)) << shift


@njit(cache=True, nogil=True)
def share(levels, shares):
    """Levels of the classes' weights (M,) → what each has of SHARES, in proportion, 1 at least where there is a weight;
    what is left or lacking is the first one's of the heaviest. False if there is none."""
    total, heaviest = np.int64(0), 0
    for c in range(levels.shape[0]):
        total += weight_of(levels[c])
        heaviest = c if levels[c] > levels[heaviest] else heaviest
    if total == 0:
        return False
    left = np.int64(SHARES)
    for c in range(levels.shape[0]):
        weight = weight_of(levels[c])
        shares[c] = max(weight * SHARES // total, 1) if weight else 0
        left -= shares[c]
    shares[heaviest] += left
    return True


# --- writing ----------------------------------------------------------------------------------------------------------


BITS = np.array([0, *(round(256 * (SHARE_BITS - np.log2(n))) for n in range(1, SHARES + 1))], np.int64)
"""What a class with so many shares costs, in 1/256 bits."""


@njit(inline="always")
def _level(weight):
    """The number of the nearest that has two significant bits."""
    shift = 0
    while weight >> (shift + 2):
        shift += 1
    return (shift << 1) + ((weight + ((1 << shift) >> 1)) >> shift)


@njit(cache=True, nogil=True)
def _table_of(classes, levels, shares):
    """Of a column's classes (N,), levels and shares (CLASSES,) → how many 1/256 bits all takes."""
    counts = np.zeros(CLASSES, np.int64)
    for k in range(classes.shape[0]):
        counts[classes[k]] += 1
    scale, last = 0, 0
    while counts.max() >> scale > MOST_WEIGHT:
        scale += 1
    for c in range(CLASSES):
        levels[c] = _level(max(counts[c] >> scale, 1)) if counts[c] else 0
        last = c + 1 if counts[c] else last
    shares[:] = 0
    share(levels, shares)
    cost = np.int64(256 * (COUNT_BITS + WEIGHT_BITS * last))
    for c in range(last):
        cost += counts[c] * BITS[shares[c]]
    return cost


@njit(cache=True, nogil=True)
def _put(bits, at, value, count):
    """The lowest `count` bits of value, the lowest first → where the next ones go."""
    for k in range(count):
        bits[at + k] = (value >> k) & 1
    return at + count


@njit(cache=True, nogil=True)
def _put_table(bits, at, levels):
    last = 0
    for c in range(CLASSES):
        last = c + 1 if levels[c] else last
    at = _put(bits, at, last, COUNT_BITS)
    for c in range(last):
        at = _put(bits, at, levels[c], WEIGHT_BITS)
    return at


@njit(cache=True, nogil=True)
def _column_of(symbols, bits, at, sizes, firsts):
    """Write a column's plain bits, and of its classes the shares and those before them; none where they are unary."""
    count, alike = symbols.shape[0], True
    classes, unary = np.empty(count, np.int64), np.int64(0)
    for k in range(count):
        classes[k] = class_of(symbols[k])
        unary += 256 * (classes[k] + 1)
        alike &= symbols[k] == symbols[0]
    levels, shares, lower = np.empty(CLASSES, np.int64), np.empty(CLASSES, np.int64), np.zeros(CLASSES, np.int64)
    mode = ALIKE if alike and count > 1 else UNARY if unary <= _table_of(classes, levels, shares) else TABLE
    at = _put(bits, at, mode, MODE_BITS)
    if mode == TABLE:
        at = _put_table(bits, at, levels)
        for c in range(1, CLASSES):
            lower[c] = lower[c - 1] + shares[c - 1]
    for k in range(1 if mode == ALIKE else count):
        own = classes[k]
        if mode == TABLE:
            sizes[k], firsts[k] = shares[own], lower[own]
        else:
            at = _put(bits, at, 1 << own, own + 1)
        if own > DIRECT:
            at = _put(bits, at, symbols[k] - 1 - (1 << (own - DIRECT)), own - DIRECT)
    return at


@njit(cache=True, nogil=True)
def write(symbols, counts):
    """Columns of symbols, counts[c] each, one after the other → (B,) uint8."""
    room, bits_room = symbols.shape[0], 1 << 10
    for k in range(room):
        bits_room += 2 * class_of(symbols[k]) + 1
    bits = np.empty(bits_room + (MODE_BITS + COUNT_BITS + WEIGHT_BITS * CLASSES) * len(counts), np.uint8)
    sizes, firsts = np.zeros(room, np.int64), np.zeros(room, np.int64)
    first, at = 0, 0
    for c in range(counts.shape[0]):
        if counts[c]:
            end = first + counts[c]
            at = _column_of(symbols[first:end], bits, at, sizes[first:end], firsts[first:end])
            first = end
    words, used, x = np.empty(room + 2, np.int64), 0, np.int64(RENEW)
    for k in range(room - 1, -1, -1):
        if sizes[k]:
            if x >= sizes[k] << (32 - SHARE_BITS):
                words[used] = x & 0xFFFF
                used += 1
                x >>= WORD_BITS
            x = (x // sizes[k] << SHARE_BITS) + x % sizes[k] + firsts[k]
    words[used], words[used + 1] = x >> WORD_BITS, x & 0xFFFF
    used += 2
    plain = (at + 7) // 8
    out = np.zeros(2 * used + plain, np.uint8)
    for k in range(used):
        out[2 * k], out[2 * k + 1] = words[used - 1 - k] & 255, words[used - 1 - k] >> 8
    for k in range(at):
        out[out.shape[0] - 1 - (k >> 3)] |= bits[k] << np.uint8(k & 7)
    return out


# --- reading ----------------------------------------------------------------------------------------------------------


STATE, WORD, BIT = range(3)
"""Where reading is, as an array: the coder's state, and where both streams go on."""
FIRST = np.array([c if c <= DIRECT else (1 << (c - DIRECT)) + 1 for c in range(64)])
"""The first symbol of each class."""
NOTHING_LEFT = 8
"""Words that are 0 behind the streams, so that reading a symbol stays within."""


@njit(cache=True, nogil=True)
def _begin(data):
    """Both streams as words: coded ones of 16 bits, plain ones of 64, and where reading begins."""
    words = np.zeros(data.shape[0] // 2 + NOTHING_LEFT, np.int64)
    plain = np.zeros(data.shape[0] // 8 + NOTHING_LEFT, np.uint64)
    for k in range(data.shape[0] // 2):
        words[k] = np.int64(data[2 * k]) | np.int64(data[2 * k + 1]) << 8
    for k in range(data.shape[0]):
        plain[k >> 3] |= np.uint64(data[data.shape[0] - 1 - k]) << np.uint64(8 * (k & 7))
    return words, plain, np.array([words[0] | words[1] << WORD_BITS, 2, 0])


@njit(inline="always")
def _bits(plain, at, count):
    """`count` bits, below 64, from `at` on."""
    word, shift = np.uint64(at) >> np.uint64(6), np.uint64(at) & np.uint64(63)
    both = plain[word] >> shift | plain[word + np.uint64(1)] << np.uint64(1) << (np.uint64(63) - shift)
    return np.int64(both & ((np.uint64(1) << np.uint64(count)) - np.uint64(1)))


@njit(cache=True, nogil=True)
def _unary(plain, at, symbols):
    """A column whose classes are plain; False where the bytes end before."""
    here, end = at[BIT], (plain.shape[0] - NOTHING_LEFT + 1) * 64
    for k in range(symbols.shape[0]):
        own = 0
        while own <= MOST_CLASS and not _bits(plain, here, 1):
            here += 1
            own += 1
        bits = max(own - DIRECT, 0)
        if own > MOST_CLASS or here + bits >= end:
            return False
        symbols[k] = FIRST[own] + _bits(plain, here + 1, bits)
        here += 1 + bits
    at[BIT] = here
    return True


@njit(cache=True, nogil=True)
def _table(plain, at, table):
    """Of each remainder (SHARES,) uint32: the class that it tells of (6 bits), its shares (11), and how far within them
    it is. False for a table that can't be."""
    here = at[BIT]
    classes = _bits(plain, here, COUNT_BITS)
    here += COUNT_BITS
    at[BIT] = here + WEIGHT_BITS * classes
    if classes > CLASSES or at[BIT] > plain.shape[0] * 64 - 64 * NOTHING_LEFT + 64:
        return False
    levels, shares = np.zeros(CLASSES, np.int64), np.zeros(CLASSES, np.int64)
    for c in range(classes):
        levels[c] = _bits(plain, here + WEIGHT_BITS * c, WEIGHT_BITS)
    if not share(levels, shares):
        return False
    slot = 0
    for c in range(classes):
        for within in range(shares[c]):
            table[slot] = c | shares[c] << 6 | within << 17
            slot += 1
    return True


@njit(cache=True, nogil=True)
def _symbols(streams, at, symbols):
    """The next column, (N,); False where the bytes end before.

    A whole column in one function, and what it counts with in locals: a function for a symbol takes ten times as long.
    Indices are unsigned, or Numba would ask of each whether it counts from the end.
    """
    words, plain, table = streams
    if not symbols.shape[0]:
        return True
    mode = _bits(plain, at[BIT], MODE_BITS)
    at[BIT] += MODE_BITS
    if mode == UNARY:
        return _unary(plain, at, symbols)
    if mode == ALIKE:
        if not _unary(plain, at, symbols[:1]):
            return False
        symbols[1:] = symbols[0]
        return True
    if mode != TABLE or not _table(plain, at, table):
        return False
    x, front, here = at[STATE], np.uint64(at[WORD]), at[BIT]
    last, end = np.uint64(words.shape[0] - NOTHING_LEFT), (plain.shape[0] - NOTHING_LEFT + 1) * 64
    for k in range(symbols.shape[0]):
        entry = np.int64(table[np.uint64(x & (SHARES - 1))])
        own = entry & 63
        x = (entry >> 6 & 2047) * (x >> SHARE_BITS) + (entry >> 17)
        more = x < RENEW
        x = (x << WORD_BITS | words[front]) if more else x
        front += np.uint64(more)
        bits = max(own - DIRECT, 0)
        symbols[k] = FIRST[np.uint64(own)] + _bits(plain, here, bits)
        here += bits
        if front > last or here > end:
            return False
    at[STATE], at[WORD], at[BIT] = x, front, here
    return True


@njit(cache=True, nogil=True)
def _tiles(streams, at, cells, keys, starts):
    """Differences of x, of y, and counts less one of all but the last → keys (T, 2), starts (T + 1,); False unless all
    tiles have cells and all keys are below 2⁴⁴."""
    tiles = keys.shape[0]
    symbols = np.empty(tiles, np.int64)
    for c in range(2):
        if not _symbols(streams, at, symbols):
            return False
        value = np.int64(0)
        for t in range(tiles):
            value += unfold(symbols[t])
            if abs(value) > MOST:
                return False
            keys[t, c] = value
    if not _symbols(streams, at, symbols[1:]):
        return False
    starts[0], starts[tiles] = 0, cells
    for t in range(tiles - 1):
        if symbols[t + 1] >= cells - starts[t] - 1:
            return False
        starts[t + 1] = starts[t] + symbols[t + 1] + 1
    return True


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
def _column(streams, at, kind, other, west, north, lowest, highest, symbols, numbers):
    """The next column's numbers, likewise; False where it has none."""
    own = symbols if other.shape[0] == 0 else symbols[: np.count_nonzero(other)]
    if not _symbols(streams, at, own):
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
    words, plain, at = _begin(data)
    streams, cells = (words, plain, np.empty(SHARES, np.uint32)), places.shape[0]
    if not _tiles(streams, at, cells, keys, starts):
        return False
    for row in range(table.shape[0]):
        if not _symbols(streams, at, table[row]):
            return False
    symbols, first = np.empty(cells, np.int64), np.empty(1, np.int64)
    if not _symbols(streams, at, symbols) or not _places(symbols, starts, np.int64(side) * side, places):
        return False
    if not _symbols(streams, at, first) or first[0] > 1:
        return False
    west, north = np.empty(cells, np.int64), np.empty(cells, np.int64)
    neighbours(keys, starts, places, side, west, north)
    for c in range(numbers.shape[0]):
        other = numbers[where[c]] if where[c] >= 0 else symbols[:0]
        kind = kinds[c] if c > 0 else WAYS[first[0]]
        if not _column(streams, at, kind, other, west, north, lowest[c], highest[c], symbols, numbers[c]):
            return False
    bits = at[BIT]
    left = _bits(plain, bits, -bits & 7)
    return at[STATE] == RENEW and 2 * at[WORD] + (bits + 7) // 8 == data.shape[0] and left == 0


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
    columns = [_folded(np.diff(keys[:, 0], prepend=0)), _folded(np.diff(keys[:, 1], prepend=0))]
    columns += [np.diff(starts)[:-1] - 1, *table, gaps]
    ways = [_symbols_of(kind, numbers[0], numbers[0][:0], west, north) for kind in WAYS]
    way = int(np.argmin([len(_written([symbols])) for symbols in ways]))
    columns += [np.array([way]), ways[way]]
    for own, kind, where in zip(numbers[1:], plan.kinds[1:], plan.where[1:], strict=True):
        columns.append(_symbols_of(kind, own, numbers[where] if where >= 0 else own[:0], west, north))
    return _written(columns)


def _symbols_of(kind: int, numbers: Array, other: Array, west: Array, north: Array) -> Array:
    symbols = np.empty(np.count_nonzero(other) if len(other) else len(numbers), np.int64)
    differences(kind, numbers, other, west, north, 0, 0, symbols, False)
    return symbols


def _written(columns: list[Array]) -> bytes:
    return bytes(write(np.concatenate(columns), np.array([len(column) for column in columns])))


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
        self.state, self.front = int.from_bytes(data[:4], "little"), 4
        self.data, self.plain = data, int.from_bytes(data[::-1], "little")

    def bits(self, count: int) -> int:
        out = self.plain & ((1 << count) - 1)
        self.plain >>= count
        return out

    def unary(self) -> int:
        own = 0
        while not self.bits(1):
            own += 1
        return own

    def table(self) -> list[tuple[int, int, int]]:
        """By remainder: class, shares of it, which of these."""
        levels = [self.bits(WEIGHT_BITS) for _ in range(self.bits(COUNT_BITS))]
        return [(c, own, within) for c, own in enumerate(shares_reference(levels)) for within in range(own)]

    def coded(self, table: list[tuple[int, int, int]]) -> int:
        own, shares, within = table[self.state % SHARES]
        self.state = shares * (self.state // SHARES) + within
        if self.state < RENEW:
            self.state = self.state << 16 | int.from_bytes(self.data[self.front : self.front + 2], "little")
            self.front += 2
        return own

    def column(self, count: int) -> list[int]:
        """The next `count` symbols, all of one column."""
        mode = self.bits(MODE_BITS) if count else UNARY
        table = self.table() if mode == TABLE else []
        out = []
        for _ in range(1 if mode == ALIKE else count):
            own = self.coded(table) if table else self.unary()
            bits = max(own - DIRECT, 0)
            out.append(own if own <= DIRECT else (1 << bits) + self.bits(bits) + 1)
        return out * count if mode == ALIKE else out


def shares_reference(levels: list[int]) -> list[int]:
    """What `share` must equal."""
    weights = [(0, 1, 2, 3)[level] if level < 4 else (2 + level % 2) << level // 2 - 1 for level in levels]
    shares = [max(weight * SHARES // sum(weights), 1) if weight else 0 for weight in weights]
    shares[weights.index(max(weights))] += SHARES - sum(shares)
    return shares


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
    counts = [symbol + 1 for symbol in reader.column(tiles - 1)]
    counts.append(cells - sum(counts))
    rows = np.array([reader.column(table[1]) for _ in range(table[0])], np.int64)
    tile_of = [t for t, count in enumerate(counts) for _ in range(count)]
    places: list[int] = []
    for k, gap in enumerate(reader.column(cells)):
        places.append(gap if k == 0 or tile_of[k] != tile_of[k - 1] else places[-1] + 1 + gap)
    columns: list[list[int]] = []
    kinds = [WAYS[reader.column(1)[0]], *plan.kinds[1:].tolist()]
    for kind, other in zip(kinds, plan.where.tolist(), strict=True):
        chosen = [k for k in range(cells) if other == ALWAYS or columns[other][k]]
        symbols = dict(zip(chosen, reader.column(len(chosen)), strict=True))
        found: dict[tuple[int, int, int], int] = {}
        column: list[int] = []
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
