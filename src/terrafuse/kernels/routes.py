"""Routes of many robots made shorter: threshold accepting (Dueck & Scheuer 1990) over the usual moves of routing.

A *slot* is something to visit, and one of its *options* is where; a robot's start is a slot with one. `rows` (K, slots)
has each robot's route as options, its start first, `counts` (K,) how many these are. What is to become small is the sum
of all routes' lengths to the eighth power, so the longest one counts most, and the others still a little.

A step draws an option b that lies near an active one a, puts it into its slot's place, makes one of MOVES, and keeps
that unless the sum grows by more than a share that shrinks to nothing. Lengths are whole numbers, and the random ones
are those of a xorshift generator: every machine gives the same routes.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from terrafuse.types import Array

UNIT = 1e6
"""Lengths count in these in the sum, so that powers stay in bounds."""
GREED = 4.0
"""At first the sum may grow by this share, over the slots that a route has on average: eight times half of a hop."""
SHIFT, BACKWARDS, TAILS, HEADS, SWAP = 4, 3, 4, 5, 6
"""Of eight kinds: below SHIFT, 1 to 3 stops from b on move behind a, of BACKWARDS the other way round; TAILS, HEADS:
robots exchange what follows a for b's tail, or for its head backwards, and within one route the way from a to b turns
round; SWAP: b and what follows a change places; 7: nothing besides the other option."""


@njit(cache=True, nogil=True)
def drawn(state):
    """Marsaglia's xorshift64."""
    state ^= state << np.uint64(13)
    state ^= state >> np.uint64(7)
    return state ^ (state << np.uint64(17))


@njit(cache=True, nogil=True)
def length_of(lengths, row, count):
    total = np.int64(0)
    for q in range(1, count):
        total += lengths[row[q - 1], row[q]]
    return total


@njit(cache=True, nogil=True)
def largest(values):
    out = values[0]
    for value in values:
        out = max(out, value)
    return out


@njit(cache=True, nogil=True)
def weight(length):
    x = length / UNIT
    x *= x
    x *= x
    return x * x


@njit(cache=True, nogil=True)
def put(spans, n, a0, a1, b0, b1, c0, c1):
    spans[n, 0], spans[n, 1] = a0, a1
    spans[n + 1, 0], spans[n + 1, 1] = b0, b1
    spans[n + 2, 0], spans[n + 2, 1] = c0, c1


@njit(cache=True, nogil=True)
def within(kind, few, spans, count, i, j):
    """Of what spans [start, stop) a route of so many stops consists after a move; how many, 0 if it can't be made."""
    if kind < SHIFT:
        end = min(j + few, count)
        if j <= i < end:
            return 0
        first, last = (end - 1, j - 1) if kind == BACKWARDS else (j, end)
        if i < j:
            put(spans, 0, 0, i + 1, first, last, i + 1, j)
            put(spans, 3, end, count, 0, 0, 0, 0)
        else:
            put(spans, 0, 0, j, end, i + 1, first, last)
            put(spans, 3, i + 1, count, 0, 0, 0, 0)
        return 4
    if kind in (TAILS, HEADS):
        low, high = min(i, j), max(i, j)
        put(spans, 0, 0, low + 1, high, low, high + 1, count)
        return 3
    low, high = min(i + 1, j), max(i + 1, j)
    if kind == SWAP and high == count:
        return 0
    if kind == SWAP and low < high:
        put(spans, 0, 0, low, high, high + 1, low + 1, high)
        put(spans, 3, low, low + 1, high + 1, count, 0, 0)
        return 5
    put(spans, 0, 0, count, 0, 0, 0, 0)
    return 1


@njit(cache=True, nogil=True)
def across(kind, few, spans, a_count, i, b_count, j):
    """The same of two routes: of each three spans, the second one taken from the other."""
    if kind < SHIFT:
        end = min(j + few, b_count)
        first, last = (end - 1, j - 1) if kind == BACKWARDS else (j, end)
        put(spans, 0, 0, i + 1, first, last, i + 1, a_count)
        put(spans, 3, 0, j, 0, 0, end, b_count)
    elif kind == TAILS:
        put(spans, 0, 0, i + 1, j, b_count, 0, 0)
        put(spans, 3, 0, j, i + 1, a_count, 0, 0)
    elif kind == HEADS:
        put(spans, 0, 0, i + 1, j, 0, 0, 0)
        put(spans, 3, 0, 1, a_count - 1, i, j + 1, b_count)
    elif kind == SWAP:
        if i + 1 == a_count:
            return 0
        put(spans, 0, 0, i + 1, j, j + 1, i + 2, a_count)
        put(spans, 3, 0, j, i + 1, i + 2, j + 1, b_count)
    else:
        put(spans, 0, 0, a_count, 0, 0, 0, 0)
        put(spans, 3, 0, b_count, 0, 0, 0, 0)
    return 3


@njit(cache=True, nogil=True)
def joined(row, other, spans, first, count, out):
    """Write so many spans of `row`, the second one of `other`, one after another; one that stops before its start goes
    backwards."""
    at = 0
    for n in range(count):
        source = other if n == 1 else row
        start, stop = spans[first + n, 0], spans[first + n, 1]
        step = 1 if stop >= start else -1
        for q in range(start, stop, step):
            out[at] = source[q]
            at += 1
    return at


@njit(cache=True, nogil=True)
def keep(row, count, robot, rows, counts, slots, route, place):
    counts[robot] = count
    for q in range(count):
        rows[robot, q] = row[q]
        route[slots[row[q]]], place[slots[row[q]]] = robot, q


@njit(cache=True, nogil=True)
def copy(rows, counts, out, out_counts):
    for r in range(counts.size):
        out_counts[r] = counts[r]
        for q in range(counts[r]):
            out[r, q] = rows[r, q]


@njit(cache=True, nogil=True)
def search(lengths, near, slots, rows, counts, steps, state, best, best_counts):
    """Leave the best routes in `best` and `best_counts`; `rows` and `counts` are used up."""
    robots, size = rows.shape
    route, place = np.empty(size, np.int64), np.empty(size, np.int64)
    x, y = np.empty(size, np.int64), np.empty(size, np.int64)
    long, spans = np.empty(robots, np.int64), np.empty((6, 2), np.int64)
    total = 0.0
    for r in range(robots):
        keep(rows[r], counts[r], r, rows, counts, slots, route, place)
        long[r] = length_of(lengths, rows[r], counts[r])
        total += weight(long[r])
    least, longest = total, largest(long)
    copy(rows, counts, best, best_counts)
    for step in range(steps):
        state = drawn(state)
        bits = np.int64(state >> np.uint64(1))
        slot = (bits >> 3) % size
        r, i = route[slot], place[slot]
        b = near[rows[r, i], (bits >> 20) % near.shape[1]]
        s, j = route[slots[b]], place[slots[b]]
        before = rows[s, j]
        rows[s, j] = b
        kind, few, ny = (bits >> 40) & 7, 1 + (bits >> 43) % 3, 0
        if r == s:
            parts = within(kind, few, spans, counts[r], i, j)
            nx = joined(rows[r], rows[r], spans, 0, parts, x)
        else:
            parts = across(kind, few, spans, counts[r], i, counts[s], j)
            nx = joined(rows[r], rows[s], spans, 0, parts, x)
            ny = joined(rows[s], rows[r], spans, 3, parts, y)
        rows[s, j] = before
        if parts == 0:
            continue
        x_long, y_long = length_of(lengths, x, nx), length_of(lengths, y, ny)
        change = weight(x_long) - weight(long[r])
        if r != s:
            change += weight(y_long) - weight(long[s])
        share = GREED * robots / size * (1 - step / steps) * (((bits >> 48) & 255) / 255)
        if change > total * share:
            continue
        total += change
        long[r] = x_long
        keep(x, nx, r, rows, counts, slots, route, place)
        if r != s:
            long[s] = y_long
            keep(y, ny, s, rows, counts, slots, route, place)
        if x_long > longest or y_long > longest:
            continue
        now = largest(long)
        if now < longest or (now == longest and total < least):
            least, longest = total, now
            copy(rows, counts, best, best_counts)


def improve(
    lengths: Array, near: Array, slots: Array, routes: list[list[int]], steps: int, seed: int
) -> list[list[int]]:
    """Of the routes that so many steps find, those whose longest is the shortest, of these the ones of the least
    sum. Each begins with its robot's start, one of the first slots.

    `lengths` (options, options) int64, the same both ways; `slots` (options,); `near` (options, n) the nearest options
    of other slots, no starts.
    """
    rows, counts = np.zeros((len(routes), sum(map(len, routes))), np.int64), np.array([len(route) for route in routes])
    for row, route in zip(rows, routes, strict=True):
        row[: len(route)] = route
    best, best_counts = rows.copy(), counts.copy()
    search(lengths, near, slots, rows, counts, steps, np.uint64(seed), best, best_counts)
    return [row[:count].tolist() for row, count in zip(best, best_counts.tolist(), strict=True)]


def improve_reference(
    lengths: Array, near: Array, slots: Array, routes: list[list[int]], steps: int, seed: int
) -> list[list[int]]:
    """What `improve` must equal."""
    total = 0.0
    for route in routes:
        total += _weight(lengths, route)
    best, state = routes, seed
    least = (max(_length(lengths, route) for route in routes), total)
    size = max(slots.tolist()) + 1
    for step in range(steps):
        for shift in (13, -7, 17):
            state ^= (state << shift if shift > 0 else state >> -shift) & (2**64 - 1)
        bits = state >> 1
        places = {int(slots[o]): (r, i) for r, route in enumerate(routes) for i, o in enumerate(route)}
        r, i = places[(bits >> 3) % size]
        b = int(near[routes[r][i], (bits >> 20) % near.shape[1]])
        s, j = places[int(slots[b])]
        b_route = [*routes[s][:j], b, *routes[s][j + 1 :]]
        a_route = b_route if r == s else routes[r]
        move = _moved_within if r == s else _moved_across
        after = dict(zip((r, s), move(bits >> 40 & 7, 1 + (bits >> 43) % 3, a_route, i, b_route, j), strict=False))
        change = 0.0
        for robot, route in after.items():
            change += _weight(lengths, route) - _weight(lengths, routes[robot])
        share = GREED * len(routes) / size * (1 - step / steps) * ((bits >> 48 & 255) / 255)
        if not after or change > total * share:
            continue
        total += change
        routes = [after.get(robot, route) for robot, route in enumerate(routes)]
        longest = max(_length(lengths, route) for route in routes)
        if (longest, total) < least:
            best, least = routes, (longest, total)
    return best


def _weight(lengths: Array, route: list[int]) -> float:
    return float(weight.py_func(_length(lengths, route)))


def _length(lengths: Array, route: list[int]) -> int:
    return int(lengths[route[:-1], route[1:]].sum())


def _moved_within(kind: int, few: int, a: list[int], i: int, b: list[int], j: int) -> list[list[int]]:
    """The route after a move, or nothing."""
    if kind < SHIFT:
        some, rest = a[j : j + few], a[:j] + a[j + few :]
        if a[i] in some:
            return []
        behind = rest.index(a[i]) + 1
        return [rest[:behind] + (some[::-1] if kind == BACKWARDS else some) + rest[behind:]]
    if kind in (TAILS, HEADS):
        low, high = sorted((i, j))
        return [a[: low + 1] + a[low + 1 : high + 1][::-1] + a[high + 1 :]]
    if kind == SWAP:
        if i + 1 == len(a):
            return []
        out = list(a)
        out[i + 1], out[j] = out[j], out[i + 1]
        return [out]
    return [a]


def _moved_across(kind: int, few: int, a: list[int], i: int, b: list[int], j: int) -> list[list[int]]:
    """Both routes after a move, or nothing."""
    if kind < SHIFT:
        some = b[j : j + few]
        return [a[: i + 1] + (some[::-1] if kind == BACKWARDS else some) + a[i + 1 :], b[:j] + b[j + few :]]
    if kind == TAILS:
        return [a[: i + 1] + b[j:], b[:j] + a[i + 1 :]]
    if kind == HEADS:
        return [a[: i + 1] + b[j:0:-1], b[:1] + a[:i:-1] + b[j + 1 :]]
    if kind == SWAP:
        if i + 1 == len(a):
            return []
        return [[*a[: i + 1], b[j], *a[i + 2 :]], [*b[:j], a[i + 1], *b[j + 1 :]]]
    return [a, b]
