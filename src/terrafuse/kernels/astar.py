"""The cheapest way over a grid of cell costs: A*, eight neighbours, no cut corners, in whole numbers.

Costs are (H, W) int16: over 0 is what crossing a cell of side 1 costs, 0 or less can't be entered. A step from a to b
costs (cost a + cost b) · its length, so a way costs as much as it does backwards; lengths are the whole numbers
STRAIGHT and DIAGONAL. A diagonal step needs both cells beside it. Sums are exact, and every machine gives the same way.

What stands ahead of a cell is the octile distance to the goal over the cheapest cost that there is: exact on an empty
grid of that cost, nowhere too much, and consistent, so that a cell is taken once.
Of cells of equal promise the nearer to the goal by that measure comes first, then the southern, then the western; a
cell's predecessor is the first that reached it at its cost, looking in the order of DI, DJ. That makes the way unique.
"""

from __future__ import annotations

from heapq import heappop, heappush

import numpy as np
from numba import njit

from terrafuse.types import Array

STRAIGHT, DIAGONAL = 13_860, 19_601
"""A convergent of √2: off by 1.3e-9 of itself."""
DI = np.array([1, 0, -1, 0, 1, -1, -1, 1], np.int64)
DJ = np.array([0, 1, 0, -1, 1, 1, -1, -1], np.int64)
"""East, north, west, south, then the diagonals."""

MAX_CELLS = 2**29
"""Three times as many, which a rim makes of a single row, can still be counted in 32 bits."""
UNSEEN, START, TAKEN = 0, 9, 16
"""A cell's state: 0, or 1 + the direction in which it was reached (START: none), plus TAKEN once that is final."""
FIRST_ROOM = 1024


@njit(inline="always")
def octile(di, dj, cost):
    """Cost of the shortest way over cells of this cost."""
    a, b = abs(di), abs(dj)
    return 2 * cost * (STRAIGHT * max(a, b) + (DIAGONAL - STRAIGHT) * min(a, b))


@njit(inline="always")
def before(heap, f, h, cell, other):
    """Whether an entry comes before the one at a place of the heap."""
    if f != heap[other, 0]:
        return f < heap[other, 0]
    return h < heap[other, 1] or (h == heap[other, 1] and cell < heap[other, 2])


@njit(inline="always")
def put(heap, place, at, f, h, cell):
    heap[at, 0], heap[at, 1], heap[at, 2] = f, h, cell
    place[cell] = at


@njit(cache=True, nogil=True)
def rise(heap, place, at, f, h, cell):
    """Put an entry where a heap has a gap, or above it."""
    while at > 0:
        above = (at - 1) >> 1
        if not before(heap, f, h, cell, above):
            break
        put(heap, place, at, heap[above, 0], heap[above, 1], heap[above, 2])
        at = above
    put(heap, place, at, f, h, cell)


@njit(cache=True, nogil=True)
def sink(heap, place, size, f, h, cell):
    """Put an entry in the gap at the top of a heap, or below it."""
    at, below = 0, 1
    while below < size:
        other = below + 1
        if other < size and before(heap, heap[other, 0], heap[other, 1], heap[other, 2], below):
            below = other
        if before(heap, f, h, cell, below):
            break
        put(heap, place, at, heap[below, 0], heap[below, 1], heap[below, 2])
        at, below = below, 2 * below + 1
    put(heap, place, at, f, h, cell)


@njit(cache=True, nogil=True)
def search(costs, width, start, goal, cheapest, cost_to, place, state):
    """(cost, cells taken, the taken one nearest the goal, the first of these); the cost is -1 if no way leads there.

    `costs` is flat, with a rim that can't be entered; start and goal can. `cost_to` (int64), `place` (int32: where in
    the heap) and `state` (uint8, all UNSEEN) have an element a cell. `state` then has the way back.
    """
    goal_i, goal_j = goal % width, goal // width
    heap = np.empty((FIRST_ROOM, 3), np.int64)
    h = octile(goal_i - start % width, goal_j - start // width, cheapest)
    put(heap, place, 0, h, h, start)
    cost_to[start] = 0
    state[start] = START
    size, taken, nearest, nearest_h = 1, 0, start, h
    while size > 0:
        h, cell = heap[0, 1], heap[0, 2]
        size -= 1
        if size > 0:
            sink(heap, place, size, heap[size, 0], heap[size, 1], heap[size, 2])
        state[cell] += TAKEN
        taken += 1
        if h < nearest_h:
            nearest, nearest_h = cell, h
        if cell == goal:
            return cost_to[goal], taken, nearest
        j = cell // width
        i = cell - j * width
        for way in range(8):
            across, up = cell + DI[way], cell + DJ[way] * width
            there = across + up - cell
            known = state[there]
            # A straight step's cells beside it are its own two.
            if known >= TAKEN or costs[there] <= 0 or costs[across] <= 0 or costs[up] <= 0:
                continue
            length = STRAIGHT if way < 4 else DIAGONAL
            cost = cost_to[cell] + (np.int64(costs[cell]) + np.int64(costs[there])) * length
            if known != UNSEEN and cost >= cost_to[there]:
                continue
            cost_to[there] = cost
            state[there] = way + 1
            h = octile(goal_i - i - DI[way], goal_j - j - DJ[way], cheapest)
            if known != UNSEEN:
                rise(heap, place, np.int64(place[there]), cost + h, h, there)
                continue
            if size == heap.shape[0]:
                larger = np.empty((2 * size, 3), np.int64)
                larger[:size] = heap
                heap = larger
            rise(heap, place, size, cost + h, h, there)
            size += 1
    return np.int64(-1), taken, nearest


@njit(cache=True, nogil=True)
def way_back(state, last, width):
    """Cells (N,) from the start to one that was taken."""
    count, cell = 1, last
    while state[cell] & 15 != START:
        way = (state[cell] & 15) - 1
        cell -= DJ[way] * width + DI[way]
        count += 1
    cells = np.empty(count, np.int64)
    for k in range(count - 1, -1, -1):
        cells[k] = last
        way = (state[last] & 15) - 1
        if k:
            last -= DJ[way] * width + DI[way]
    return cells


def cheapest_way(costs: Array, start: tuple[int, int], goal: tuple[int, int]) -> tuple[Array, int, int]:
    """(cells (N, 2) as i, j, cost, cells taken) of the way between two cells (i, j) of `costs` that can be entered.

    Where no way leads to the goal the cost is -1, and the cells lead to the one nearest it, by octile distance, that
    can be reached. Memory: 15 bytes a cell, 13 of which are only touched where the search looks, and at most 48 a cell
    of its front.
    """
    width = costs.shape[1] + 2
    rimmed = np.pad(costs, 1).reshape(-1)
    cost_to, place = np.empty(rimmed.size, np.int64), np.empty(rimmed.size, np.int32)
    state = np.zeros(rimmed.size, np.uint8)
    first, wanted = (np.int64((j + 1) * width + i + 1) for i, j in (start, goal))
    cost, taken, last = search(rimmed, width, first, wanted, np.int64(cheapest_cost(costs)), cost_to, place, state)
    cells = way_back(state, last, width)
    return np.column_stack([cells % width - 1, cells // width - 1]), int(cost), int(taken)


@njit(cache=True, nogil=True)
def cheapest_cost(costs):
    least = np.int16(32767)
    for j in range(costs.shape[0]):
        for i in range(costs.shape[1]):
            if costs[j, i] > 0:
                least = min(least, costs[j, i])
    return least


def cheapest_way_reference(
    costs: Array, start: tuple[int, int], goal: tuple[int, int], ahead: bool = True
) -> tuple[list[tuple[int, int]], int, int]:
    """What `cheapest_way` must equal; without looking `ahead` it is Dijkstra's algorithm, of the same cost."""
    height, width = costs.shape
    free = {(i, j): int(costs[j, i]) for j in range(height) for i in range(width) if costs[j, i] > 0}
    lowest = min(free.values()) if ahead else 0

    def entry(cell: tuple[int, int]) -> tuple[int, int, int, tuple[int, int]]:
        short, long = sorted((abs(goal[0] - cell[0]), abs(goal[1] - cell[1])))
        h = 2 * lowest * (STRAIGHT * (long - short) + DIAGONAL * short)
        return cost_to[cell] + h, h, cell[1] * width + cell[0], cell

    cost_to, came, taken = {start: 0}, {start: start}, dict[tuple[int, int], int]()
    queue = [entry(start)]
    while queue and goal not in taken:
        _, h, _, (i, j) = heappop(queue)
        if (i, j) in taken:
            continue
        taken[i, j] = h
        for di, dj in zip(DI.tolist(), DJ.tolist(), strict=True):
            there = (i + di, j + dj)
            if there in taken or not {there, (i + di, j), (i, j + dj)} <= free.keys():
                continue
            cost = cost_to[i, j] + (free[i, j] + free[there]) * (DIAGONAL if di and dj else STRAIGHT)
            if cost < cost_to.get(there, cost + 1):
                cost_to[there], came[there] = cost, (i, j)
                heappush(queue, entry(there))
    way = [min(taken, key=taken.__getitem__)]
    while way[-1] != start:
        way.append(came[way[-1]])
    return way[::-1], cost_to[goal] if goal in taken else -1, len(taken)
