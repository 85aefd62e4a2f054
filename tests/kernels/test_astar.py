"""A*, the distance transform and straight lines, each equal to its slow reference."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from terrafuse.kernels.astar import DIAGONAL, FIRST_ROOM, STRAIGHT, cheapest_way, cheapest_way_reference
from terrafuse.kernels.distance import FAR, squared_distance, squared_distance_reference
from terrafuse.kernels.sight import cross_reference, crossed, shortcuts
from terrafuse.types import Array

SIDES = st.integers(1, 14)
PRICES = st.one_of(st.just(0), st.just(100), st.integers(-2, 32_767))


@st.composite
def problems(draw: Any) -> tuple[Array, tuple[int, int], tuple[int, int]]:
    """Costs with about a third of obstacles, and two cells of them that can be entered."""
    costs = draw(arrays(np.int16, (draw(SIDES), draw(SIDES)), elements=PRICES, fill=st.just(100)))
    free = [(int(i), int(j)) for j, i in np.argwhere(costs > 0)]
    if not free:
        costs[0, 0], free = 100, [(0, 0)]
    return costs, draw(st.sampled_from(free)), draw(st.sampled_from(free))


@given(problems())
def test_the_search_equals_its_reference_step_by_step(problem: Any) -> None:
    """The same way, cost and cells taken; and the cost is the one that Dijkstra's algorithm finds."""
    cells, cost, taken = cheapest_way(*problem)
    assert (list(map(tuple, cells.tolist())), cost, taken) == cheapest_way_reference(*problem)
    assert cost == cheapest_way_reference(*problem, ahead=False)[1]


@given(problems())
def test_a_way_costs_as_much_backwards(problem: Any) -> None:
    costs, start, goal = problem
    assert cheapest_way(costs, start, goal)[1] == cheapest_way(costs, goal, start)[1]


@given(problems())
def test_a_way_is_made_of_allowed_steps_that_add_up(problem: Any) -> None:
    costs, start, goal = problem
    cells, cost, _ = cheapest_way(*problem)
    way, total = list(map(tuple, cells.tolist())), 0
    assert way[0] == start
    assert (cost < 0) == (way[-1] != goal)
    for (i, j), (u, v) in pairwise(way):
        assert max(abs(u - i), abs(v - j)) == 1
        assert min(costs[v, u], costs[j, u], costs[v, i]) > 0
        total += (int(costs[j, i]) + int(costs[v, u])) * (DIAGONAL if u != i and v != j else STRAIGHT)
    assert cost in (total, -1)


def test_a_front_of_many_cells() -> None:
    """The heap grows: on free ground without a way the front gets as long as the map is wide."""
    costs = np.full((2 * FIRST_ROOM, 12), 100, np.int16)
    costs[:, 10] = 0
    costs[::2, 1:9:2] = 3000
    _, cost, taken = cheapest_way(costs, (0, FIRST_ROOM), (11, FIRST_ROOM))
    assert (cost, taken) == (-1, 10 * 2 * FIRST_ROOM)


def test_the_diagonal_is_the_root_of_two() -> None:
    assert DIAGONAL / STRAIGHT == pytest.approx(math.sqrt(2), rel=2e-9)


@given(arrays(bool, st.tuples(SIDES, SIDES), elements=st.sampled_from([True, False, False, False])))
def test_distances_equal_their_reference(marked: Array) -> None:
    np.testing.assert_array_equal(squared_distance(marked), squared_distance_reference(marked))


def test_distances_by_hand() -> None:
    """From the lower left and upper right of 4×3: (3, 0) is √(0 + 4) from (3, 2); (1, 1) is √2 from (0, 0)."""
    marked = np.zeros((3, 4), bool)
    marked[0, 0] = marked[2, 3] = True
    assert squared_distance(marked).tolist() == [[0, 1, 4, 4], [1, 2, 2, 1], [4, 4, 1, 0]]
    assert squared_distance(np.zeros((2, 2), bool)).tolist() == [[FAR, FAR], [FAR, FAR]]
    assert squared_distance(np.zeros((0, 3), bool)).shape == (0, 3)


ENDS = st.integers(-12, 12)


@given(ENDS, ENDS, ENDS, ENDS)
def test_lines_equal_their_reference(i0: int, j0: int, i1: int, j1: int) -> None:
    cells, lengths = crossed(np.array([[i0, j0], [i1, j1]]))
    expected = cross_reference(i0, j0, i1, j1)
    if (i0, j0) == (i1, j1):
        assert (cells.tolist(), lengths.tolist()) == ([[i0, j0]], [0.0])
        return
    assert list(map(tuple, cells.tolist())) == [cell for cell, _ in expected]
    whole = math.hypot(i1 - i0, j1 - j0)
    assert lengths == pytest.approx([float(share) * whole for _, share in expected])


def test_a_line_by_hand() -> None:
    """From the centre of (0, 0) to that of (2, 1), √5 long: it leaves (0, 0) a quarter on, comes to the border of the
    rows half way, in (1, 0), and enters (2, 1) at three quarters."""
    cells, lengths = crossed(np.array([[0, 0], [2, 1]]))
    assert cells.tolist() == [[0, 0], [1, 0], [1, 1], [2, 1]]
    assert lengths == pytest.approx([math.sqrt(5) / 4] * 4)


@given(problems())
def test_shortcuts_cost_no_more_and_cut_no_corner(problem: Any) -> None:
    costs = problem[0]
    way, cost, _ = cheapest_way(*problem)
    kept = shortcuts(costs, way, 1e-9)
    assert (kept[0], kept[-1]) == (0, len(way) - 1)
    assert (np.diff(kept) > 0).all()
    cells, lengths = crossed(way[kept])
    i, j = cells.T
    assert (costs[j, i] > 0).all()
    assert (costs[j[1:], i[:-1]] > 0).all()
    assert (costs[j[:-1], i[1:]] > 0).all()
    if cost >= 0:
        assert (costs[j, i] * lengths).sum() <= cost / (2 * STRAIGHT) * (1 + 1e-8)


def test_a_shortcut_by_hand() -> None:
    """On free ground from (0, 0) to (4, 2) a single line does, √20 instead of 2 + 2√2; not through an obstacle."""
    costs = np.full((3, 5), 100, np.int16)
    way, *_ = cheapest_way(costs, (0, 0), (4, 2))
    assert shortcuts(costs, way, 1e-9).tolist() == [0, 4]
    costs[1, 2] = 0
    way, *_ = cheapest_way(costs, (0, 0), (4, 2))
    assert len(shortcuts(costs, way, 1e-9)) > 2
