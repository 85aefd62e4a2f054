"""Ray traversal against exact references in rational arithmetic, and by hand."""

from __future__ import annotations

import tracemalloc
from fractions import Fraction
from itertools import product
from math import ceil, floor

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from terrafuse.kernels.rays import (
    MAX_RAY_CELLS,
    MAX_SPREAD_CELLS,
    SUBCELLS,
    crossed_reference,
    extent,
    trace_reference,
)
from terrafuse.kernels.traced import LISTED_CELLS, Tracer
from terrafuse.types import Array

Cells = list[tuple[int, int]]
SIDE = 7
"""Cells along a tile's side."""


def traced(
    ends: Array, marks: Array, cells_per_m: float, tracer: Tracer | None = None, side: int = SIDE
) -> tuple[Cells, Cells]:
    """(hit, crossed) cells, by tile in the order in which they come."""
    tracer = tracer or Tracer(cells_per_m, side)
    found = tracer(np.asarray(ends, np.float64).reshape(-1, 4), np.asarray(marks, bool))
    assert len(set(map(tuple, found.keys.tolist()))) == len(found.keys), "each tile once"
    assert (found.counts > 0).all(), "no tile in vain"
    cells, hits = [], []
    for t, (x, y) in enumerate(found.keys.tolist()):
        at, hit = found.part(t)
        assert len(at) == len(hit) == found.counts[t]
        cells += zip((x * side + at % side).tolist(), (y * side + at // side).tolist(), strict=True)
        hits += hit.tolist()
    assert len(cells) == found.cells
    return [cell for cell, end in zip(cells, hits, strict=True) if end], [
        cell for cell, end in zip(cells, hits, strict=True) if not end
    ]


def crossed(*segment: float) -> set[tuple[int, int]]:
    hit, others = traced(np.array([segment]), np.array([False]), 1.0)
    assert not hit
    return set(others)


anywhere = st.floats(-30, 30)
on_borders = st.integers(-12, 12).map(lambda k: k / 4)
coordinates = st.one_of(anywhere, on_borders)
segments = st.lists(st.tuples(*[coordinates] * 4, st.booleans()), min_size=1, max_size=6)


@given(
    segments, st.sampled_from([1.0, 4.0, 10.0]), st.sampled_from([0.0, 500_000.0]), st.sampled_from([2, 64, 1 << 21])
)
def test_rays_equal_their_reference(
    drawn: list[tuple[float, ...]], cells_per_m: float, away_m: float, listed: int
) -> None:
    """Whether their cells are listed, or too many for that."""
    rows = np.array(drawn, np.float64)
    ends, marks = rows[:, :4] + away_m, rows[:, 4].astype(bool)
    hits, others = traced(ends, marks, cells_per_m, Tracer(cells_per_m, SIDE, listed))
    assert len(set(hits + others)) == len(hits + others), "each cell once"
    assert (set(hits), set(others)) == trace_reference(ends, marks, cells_per_m)


Segment = tuple[Fraction, Fraction, Fraction, Fraction]


def meets(segment: Segment, i: int, j: int, margin: Fraction = Fraction(0)) -> bool:
    """Whether a part of the segment lies in the open square of a cell, grown by a margin on all sides."""
    x0, y0, x1, y1 = segment
    first, last = Fraction(0), Fraction(1)
    for start, step, low, high in (
        (x0, x1 - x0, i - margin, i + 1 + margin),
        (y0, y1 - y0, j - margin, j + 1 + margin),
    ):
        if step == 0:
            if not low < start < high:
                return False
        else:
            near, far = sorted(((low - start) / step, (high - start) / step))
            first, last = max(first, near), min(last, far)
    return first < last


def through_open_squares(segment: Segment) -> set[tuple[int, int]]:
    """The cells whose open square meets the segment, each asked by itself: another way to say "crosses"."""
    i, j = (range(floor(min(segment[k::2])), ceil(max(segment[k::2])) + 1) for k in (0, 1))
    return {cell for cell in product(i, j) if meets(segment, *cell)}


@given(*[st.integers(-6 * SUBCELLS, 6 * SUBCELLS)] * 4)
def test_a_ray_crosses_the_open_squares_that_it_meets(x0: int, y0: int, x1: int, y1: int) -> None:
    exact = tuple(Fraction(value, SUBCELLS) for value in (x0, y0, x1, y1))
    on_a_border = (x0 == x1 and x0 % SUBCELLS == 0) or (y0 == y1 and y0 % SUBCELLS == 0)
    if not on_a_border and (x0, y0) != (x1, y1):
        assert crossed(*map(float, exact)) == through_open_squares(exact)


@given(st.tuples(*[st.floats(-20, 20)] * 4))
def test_rounding_the_ends_moves_a_ray_by_no_more_than_that(segment: tuple[float, ...]) -> None:
    """It differs from the ray between the very floats only in cells that are grazed, by less than two parts of one."""
    exact = tuple(map(Fraction, segment))
    ours, theirs, graze = crossed(*segment), crossed_reference(*exact), Fraction(2, SUBCELLS)
    assert not any(meets(exact, i, j, -graze) for i, j in theirs - ours)
    assert all(meets(exact, i, j, graze) or exact[:2] == exact[2:] for i, j in ours - theirs)


def test_a_ray_by_hand() -> None:
    """From (½, ½) to (2½, 1½): y reaches 1 at x = 1½."""
    assert crossed(0.5, 0.5, 2.5, 1.5) == {(0, 0), (1, 0), (1, 1), (2, 1)}
    assert crossed(2.5, 1.5, 0.5, 0.5) == {(0, 0), (1, 0), (1, 1), (2, 1)}


def test_through_a_corner_a_ray_goes_diagonally() -> None:
    assert crossed(0.5, 0.5, 2.5, 2.5) == {(0, 0), (1, 1), (2, 2)}
    assert crossed(0.5, 1.5, 1.5, 0.5) == {(0, 1), (1, 0)}
    assert crossed(-0.5, -0.5, 0.5, 0.5) == {(-1, -1), (0, 0)}


def test_a_border_belongs_to_the_cell_east_or_north_of_it() -> None:
    assert crossed(0.5, 1.0, 2.5, 1.0) == {(0, 1), (1, 1), (2, 1)}
    assert crossed(1.0, 2.5, 1.0, 0.5) == {(1, 0), (1, 1), (1, 2)}
    assert crossed(0.5, 0.5, 1.0, 0.5) == {(0, 0)}  # it has no length in (1, 0)
    assert crossed(1.0, 0.5, 0.5, 0.5) == {(0, 0)}
    assert crossed(0.25, 0.5, 0.25, 0.5) == {(0, 0)}  # nor has a point any, but it is somewhere


def test_a_hit_marks_the_cell_that_holds_its_end() -> None:
    """Also where the ray only just reaches it: 1.0 is of cell 1."""
    assert traced(np.array([[0.5, 0.5, 1.0, 0.5]]), np.array([True]), 1.0) == ([(1, 0)], [(0, 0)])
    assert traced(np.array([[2.5, 0.5, 1.0, 0.5]]), np.array([True]), 1.0) == ([(1, 0)], [(2, 0)])


def test_hits_come_before_misses_and_each_cell_once() -> None:
    """The second ray passes through the cell that the first hits, the third hits it again."""
    ends = np.array([[0.5, 0.5, 2.5, 0.5], [0.5, 0.5, 4.5, 0.5], [2.5, 3.5, 2.5, 0.5]])
    hits, others = traced(ends, np.array([True, False, True]), 1.0)
    assert hits == [(2, 0)]
    assert sorted(others) == [(0, 0), (1, 0), (2, 1), (2, 2), (2, 3), (3, 0), (4, 0)]


@pytest.mark.parametrize("listed", [512, LISTED_CELLS])
def test_one_scan_leaves_nothing_to_the_next(listed: int) -> None:
    """Of 512 cells, those of the larger ones are not listed."""
    tracer = Tracer(10.0, SIDE, listed)
    rng = np.random.default_rng(0)
    for reach in (2.0, 30.0, 1.0, 12.0):
        ends, marks = rng.uniform(-reach, reach, (20, 4)), rng.random(20) < 0.5
        found, expected = traced(ends, marks, 10.0, tracer), traced(ends, marks, 10.0)
        assert [*map(sorted, found)] == [*map(sorted, expected)]


def test_what_a_scan_holds_is_bounded() -> None:
    """4000 rays of 200 m in cells of 0.1 m cross 8 million cells, of 16 million in the window.

    A byte for each of these, rounded up to a power of two, and 4 bytes for each of 2²¹ in the list.
    """
    angle = np.linspace(0, 2 * np.pi, 4000, endpoint=False)
    ends = np.column_stack([0 * angle, 0 * angle, 200 * np.cos(angle), 200 * np.sin(angle)])
    tracemalloc.start()
    found = Tracer(10.0, 400)(ends, np.ones(len(ends), bool))
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert found.cells > LISTED_CELLS
    assert 4001**2 < most < 2**24 + 4 * LISTED_CELLS + 1_000_000


def test_a_scan_without_rays() -> None:
    assert traced(np.empty((0, 4)), np.empty(0), 1.0) == ([], [])


def test_the_longest_rays_that_a_scan_may_hold() -> None:
    """All around from the furthest that origins may lie apart: a byte a cell of the window, 105 MB, is most of it."""
    angle = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    away = MAX_SPREAD_CELLS * np.sign(np.sin(3 * angle))
    around = MAX_RAY_CELLS * np.column_stack([np.cos(angle), np.sin(angle)])
    ends = np.column_stack([away, away, away + around[:, 0], away + around[:, 1]])
    _, _, width, height, most = extent(ends, 1.0)
    assert width * height <= (2 * (MAX_RAY_CELLS + MAX_SPREAD_CELLS) + 3) ** 2
    hits, others = traced(ends, np.ones(64, bool), 1.0)
    assert len(hits) + len(others) <= most
    assert len(others) > 64 * MAX_RAY_CELLS / 2


@pytest.mark.parametrize("cells_per_m", [1 / 0.1, 1 / 0.0254, 1 / 0.05])
def test_a_hit_lies_where_the_lattice_puts_its_point(cells_per_m: float) -> None:
    rng = np.random.default_rng(1)
    for east, north in rng.uniform(-1e6, 1e6, (200, 2)):
        hits, _ = traced(np.array([[east + 1, north, east, north]]), np.array([True]), cells_per_m)
        assert hits == [(floor(east * cells_per_m), floor(north * cells_per_m))]
