"""Where the elements of one grid lie in another."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from terrafuse.errors import InputError
from terrafuse.grids import Grid, bounds_in, located, transformed, window_grid
from terrafuse.lattice import Lattice

UTM = Lattice(1.0, 40.0, "EPSG:32632")


def exactly(cells: Grid, grid: Grid) -> list[list[object]]:
    x, y = transformed(*cells.centres(0, cells.rows), cells.crs, grid.crs)
    return [values.tolist() for values in grid.locate(x, y)]


@settings(max_examples=30)
@given(
    st.integers(400_000, 600_000), st.integers(-9_000_000, 9_000_000), st.integers(1, 60), st.integers(1, 60),
    st.floats(-3, 3), st.sampled_from([1e-5, 3e-4, 0.01]),
)  # fmt: skip
def test_places_in_another_crs_are_found_as_if_each_were_transformed(
    i: int, j: int, columns: int, rows: int, turn_rad: float, pixel_deg: float
) -> None:
    """A turned raster in degrees, under windows of cells in UTM: the same pixels in all."""
    cells = window_grid(UTM, (i, j, i + columns, j + rows))
    x, y = transformed(*cells.place(np.array(columns / 2), np.array(rows / 2)), UTM.crs, "EPSG:4326")
    c, s = pixel_deg * np.cos(turn_rad), pixel_deg * np.sin(turn_rad)
    grid = Grid(9, 9, (c, s, float(x) - 4.5 * (c + s), s, -c, float(y) - 4.5 * (s - c)), "EPSG:4326")
    assert [values.tolist() for values in located(cells, grid)] == exactly(cells, grid)


def test_across_the_end_of_longitudes() -> None:
    """Of UTM 1, 180° west is in the middle of this window; pixels of 0.001° from 179.99° on."""
    lattice = Lattice(1.0, 40.0, "EPSG:32601")
    x, y = transformed(np.array(-179.9999), np.array(10.0), "EPSG:4326", lattice.crs)
    i, j = int(x), int(y)
    cells = window_grid(lattice, (i - 100, j - 100, i + 100, j + 100))
    grid = Grid(20, 20, (0.001, 0.0, 179.99, 0.0, -0.001, 10.01), "EPSG:4326")
    found = located(cells, grid)
    assert [values.tolist() for values in found] == exactly(cells, grid)
    assert 0 < found[2].sum() < found[2].size


def test_bounds_without_a_place_there() -> None:
    """The equator 90° east of the zone's middle is infinitely far away in UTM."""
    with pytest.raises(InputError, match="its bounds, 98 to 100 and -1 to 1, have no place in EPSG:32632"):
        bounds_in(Grid(2, 2, (1.0, 0.0, 98.0, 0.0, -1.0, 1.0), "EPSG:4326"), "EPSG:32632")
