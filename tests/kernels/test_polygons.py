"""Which cells lie in which polygons: the kernel against its reference, and against shapes by hand."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from terrafuse.kernels.polygons import burn, burn_reference
from terrafuse.lattice import Lattice
from terrafuse.prior.burnt import Edges, lay
from terrafuse.types import Array, Floats, TileKey

SIDE = 8
NUMBERS = st.integers(-6, 30).map(lambda k: k / 2) | st.floats(-3, 15)
RINGS = st.lists(st.tuples(NUMBERS, NUMBERS), min_size=4, max_size=7)
POLYGONS = st.lists(st.lists(RINGS, min_size=1, max_size=2), min_size=1, max_size=4)


def laid(polygons: list[list[list[tuple[float, float]]]], values: Floats) -> Edges:
    """Each polygon as a feature of its own, in cells of 1 m."""
    features = [(tuple(np.array(ring, np.float64) for ring in polygon),) for polygon in polygons]
    return lay(features, values, None, Lattice(1.0, float(SIDE)), "feature").edges


def burnt(edges: Edges, i0: int = 0, j0: int = 0) -> Array:
    out = np.full((edges.values.shape[1], SIDE, SIDE), np.nan)
    burn(out, i0, j0, edges.ends, edges.first, edges.windows, edges.values)
    return out


@given(POLYGONS, st.integers(-9, 9), st.integers(-9, 9), st.data())
def test_the_kernel_is_the_reference(
    polygons: list[list[list[tuple[float, float]]]], i0: int, j0: int, data: st.DataObject
) -> None:
    values = np.array([[data.draw(st.sampled_from([np.nan, float(k)])), k + 0.5] for k in range(len(polygons))])
    edges = laid(polygons, values)
    expected = np.full((2, SIDE, SIDE), np.nan)
    burn_reference(expected, i0, j0, edges.ends, edges.first, edges.values)
    np.testing.assert_array_equal(burnt(edges, i0, j0), expected)
    np.testing.assert_array_equal(burnt(edges.meeting(j0, j0 + SIDE), i0, j0), expected)


def test_a_square_with_a_hole_by_hand() -> None:
    """Centres at ½: from 0.5 on they belong to it, up to but not at 5.5; of the hole from 1.6 to 3.5 only 2.5."""
    outer = [(0.5, 0.5), (5.5, 0.5), (5.5, 5.5), (0.5, 5.5)]
    hole = [(1.6, 1.6), (1.6, 3.5), (3.5, 3.5), (3.5, 1.6)]
    expected = np.full((SIDE, SIDE), np.nan)
    expected[0:5, 0:5] = 7.0
    expected[2, 2] = np.nan
    np.testing.assert_array_equal(burnt(laid([[outer, hole]], np.array([[7.0]])))[0], expected)


@given(st.lists(st.tuples(NUMBERS, NUMBERS), min_size=3, max_size=3), NUMBERS, NUMBERS)
def test_polygons_that_share_a_border_share_no_cell(corners: list[tuple[float, float]], x: float, y: float) -> None:
    """A triangle that a point splits into three: the turns of the parts are those of the whole, each border's twice."""
    a, b, c = corners
    parts = [[[*pair, (x, y), pair[0]]] for pair in ((a, b), (b, c), (c, a))]
    cells = np.array([burnt(laid([part], np.ones((1, 1))))[0] == 1 for part in parts])
    whole = burnt(laid([[[a, b, c, a]]], np.ones((1, 1))))[0] == 1
    np.testing.assert_array_equal(np.logical_xor.reduce(cells), whole)


def test_tiles_of_a_lattice_far_out() -> None:
    """A polygon of 3×2 cells about (4,000,001, −7,999,998) lies in the same cells as about the origin."""
    ring = np.array([[1.0, 2.0], [4.0, 2.0], [4.0, 4.0], [1.0, 4.0], [1.0, 2.0]])
    far = ring + np.array([4_000_000, -8_000_000])
    placed = lay([((far,),)], np.array([[1.0]]), None, Lattice(1.0, 8.0), "feature")
    tile = placed.values(TileKey(500_000, -1_000_000)).reshape(8, 8)
    assert sorted(zip(*np.nonzero(tile == 1), strict=True)) == [(j, i) for j in (2, 3) for i in (1, 2, 3)]
    assert [extent.window for extent in placed.extents()] == [(4_000_001, -7_999_998, 4_000_004, -7_999_996)]
