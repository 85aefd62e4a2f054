"""World ↔ cell ↔ tile arithmetic."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from terrafuse.errors import LatticeError
from terrafuse.lattice import Lattice, default_tile_m
from terrafuse.types import Bounds, TileKey

RESOLUTIONS = [0.05, 0.1, 0.2, 0.25, 0.5, 1.0, 2.0, 5.0]


@pytest.mark.parametrize("resolution_m", RESOLUTIONS)
@given(index=st.integers(-50_000_000, 50_000_000), part=st.floats(0.001, 0.999))
def test_a_cell_holds_its_inside(resolution_m: float, index: int, part: float) -> None:
    lattice = Lattice(resolution_m, default_tile_m(resolution_m))
    assert lattice.cell((index + part) * resolution_m) == index
    assert lattice.cell(lattice.cell_centre(index)) == index


def test_borders_belong_to_the_cell_north_and_east() -> None:
    lattice = Lattice(0.1)
    assert lattice.cell(0.3) == 3
    assert lattice.cell(-0.1) == -1
    assert lattice.tile_at(40.0, -0.01) == TileKey(1, -1)


def test_tile_bounds_tile_the_plane() -> None:
    lattice = Lattice(0.1)
    assert lattice.tile_cells == 400
    assert lattice.tile_bounds(TileKey(-1, 2)) == pytest.approx((-40, 80, 0, 120))


def test_a_resolution_must_divide_the_tile() -> None:
    with pytest.raises(LatticeError, match=r"0\.3 m does not divide the tile of 40\.0 m.*use 0\.298507 or 0\.300752 m"):
        Lattice(0.3)
    assert Lattice(0.3, 39.9).tile_cells == 133


@pytest.mark.parametrize("resolution_m", [0.0, -1.0, float("nan"), float("inf")])
def test_impossible_resolutions(resolution_m: float) -> None:
    with pytest.raises(LatticeError, match="positive number"):
        Lattice(resolution_m)


def test_windows_of_bounds() -> None:
    lattice = Lattice(0.1)
    assert lattice.cell_window(Bounds(0, 0, 1, 2)) == (0, 0, 10, 20)
    assert lattice.cell_window(Bounds(0.05, 0, 0.1, 0.11)) == (0, 0, 1, 2)
    with pytest.raises(LatticeError, match="hold no cell"):
        lattice.cell_window(Bounds(1, 0, 1, 1))


def test_coarser_lattices_share_tiles() -> None:
    coarse = Lattice(0.1).coarser(10)
    assert coarse.resolution_m == 1.0
    assert coarse.tile_bounds(TileKey(3, 4)) == Lattice(0.1).tile_bounds(TileKey(3, 4))
    with pytest.raises(LatticeError, match="factor 7"):
        Lattice(0.1).coarser(7)


def test_utm_coordinates_keep_their_cells() -> None:
    lattice = Lattice(0.1)
    north = 4_000_000 + np.arange(1000) * 0.1 + 0.05
    np.testing.assert_array_equal(lattice.cell(north), 40_000_000 + np.arange(1000))
