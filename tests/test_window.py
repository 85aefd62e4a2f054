"""Window policies: which tiles are inside, added and dropped, wherever a robot goes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from terrafuse.errors import InputError
from terrafuse.lattice import Lattice
from terrafuse.types import Bounds, TileKey
from terrafuse.window import (
    EVERYWHERE,
    WINDOWS,
    Area,
    Centred,
    KeepAll,
    NineBlock,
    Radius,
    Residency,
    Tiles3x3,
    make_window,
)

LATTICE = Lattice(0.1)
PAPER = Lattice(0.0254, 2.54)
"""The *database* paper's: blocks of 100×100 cells of an inch."""

places = st.floats(-1e4, 1e4) | st.sampled_from([0.0, 40.0, -40.0, 39.99999999, 4.0e6])
lattices = st.sampled_from([LATTICE, Lattice(0.5), Lattice(0.5, 4.0), PAPER, Lattice(0.5, 0.5)])


def tiles(*xs: int, ys: tuple[int, ...]) -> set[TileKey]:
    return {TileKey(x, y) for x in xs for y in ys}


def distance_m(bounds: Bounds, east_m: float, north_m: float) -> float:
    """How far a place lies from a rectangle."""
    return math.hypot(
        max(bounds.west - east_m, 0, east_m - bounds.east), max(bounds.south - north_m, 0, north_m - bounds.north)
    )


# --- nine_block ------------------------------------------------------------------------------------------------------


def test_nine_block_holds_the_robots_block_and_its_neighbours() -> None:
    assert set(NineBlock(LATTICE).around(10, 10)) == tiles(-1, 0, 1, ys=(-1, 0, 1))


@pytest.mark.parametrize(("east", "north"), [(1, 0), (-1, 0), (0, 1), (0, -1)])
def test_a_straight_move_adds_three_blocks(east: int, north: int) -> None:
    window = Residency(NineBlock(PAPER))
    window.move(1.27, 1.27)
    before = set(window.area)
    assert window.move(1.27 + 2.54 * east, 1.27 + 2.54 * north)
    after = set(window.area)
    assert (len(after - before), len(before - after), len(after)) == (3, 3, 9)
    assert TileKey(2 * east, 2 * north) in after - before
    assert TileKey(-east, -north) in before - after


@pytest.mark.parametrize(("east", "north"), [(1, 1), (-1, 1), (1, -1), (-1, -1)])
def test_a_diagonal_move_adds_five_blocks(east: int, north: int) -> None:
    window = Residency(NineBlock(PAPER))
    window.move(1.27, 1.27)
    before = set(window.area)
    assert window.move(1.27 + 2.54 * east, 1.27 + 2.54 * north)
    after = set(window.area)
    assert (len(after - before), len(before - after)) == (5, 5)


def test_nine_block_thrashes_on_a_border_where_tiles3x3_stands() -> None:
    to_and_fro = [2.54 + 0.1 * (-1) ** k for k in range(100)]
    nine, tiles3x3 = Residency(NineBlock(PAPER)), Residency(Tiles3x3(PAPER))
    assert sum(nine.move(east, 1.0) for east in to_and_fro) == 100
    assert sum(tiles3x3.move(east, 1.0) for east in to_and_fro) == 1


def test_a_border_belongs_to_the_block_east_and_north_of_it() -> None:
    assert set(NineBlock(LATTICE).around(40.0, 40.0)) == tiles(0, 1, 2, ys=(0, 1, 2))
    assert set(NineBlock(LATTICE).around(39.999, 40.0)) == tiles(-1, 0, 1, ys=(0, 1, 2))


# --- tiles3x3 --------------------------------------------------------------------------------------------------------


def test_tiles3x3_moves_only_out_of_its_central_half() -> None:
    window = Residency(Tiles3x3(LATTICE))
    assert window.move(20, 20)
    assert set(window.area) == tiles(-1, 0, 1, ys=(-1, 0, 1))
    assert not window.move(49.9, 20)  # 0.75 tiles from the middle
    assert window.move(50.1, 20)
    assert TileKey(2, 0) in window.area
    assert not window.move(31, 20)


def test_walking_along_a_border_does_not_move_tiles3x3() -> None:
    window = Residency(Tiles3x3(LATTICE))
    assert sum(window.move(40.0 + 0.5 * np.sin(k), 20 + k * 0.001) for k in range(1000)) == 1


# --- radius ----------------------------------------------------------------------------------------------------------


def test_equation_3_of_the_database_paper() -> None:
    """R = r + δt·V: 50 inches of range, ten sonar cycles of a second between updates, an inch a second: 60 inches."""
    window = Radius(PAPER, range_m=50 * 0.0254, period_s=10, speed_mps=0.0254)
    assert window.radius_m == pytest.approx(60 * 0.0254)


def test_radius_by_hand() -> None:
    """A disc of 5 m round (5, 5) on tiles of 4 m.

    It spans 0 to 10 on both axes: tiles 0 to 2, and touches the tiles -1 at the points (0, 5) and (5, 0), which belong
    to tile 0: -1 stays out but for the rounding that is allowed to add it. Tile (2, 2), from (8, 8), is 4.24 m away.
    """
    window = set(Radius(Lattice(0.5, 4.0), range_m=5.0, period_s=0, speed_mps=0).around(5, 5))
    assert window - tiles(-1, 0, 1, 2, ys=(1,)) - tiles(1, ys=(-1, 0, 1, 2)) == tiles(0, 2, ys=(0, 2))
    assert tiles(0, 1, 2, ys=(0, 1, 2)) <= window
    nearer = set(Radius(Lattice(0.5, 4.0), range_m=4.0, period_s=0, speed_mps=0).around(5, 5))
    assert TileKey(2, 2) not in nearer  # 4.24 m
    assert TileKey(2, 1) in nearer  # 3 m
    assert TileKey(0, 0) in nearer  # 1.41 m


@given(lattices, places, places, st.floats(0.01, 60), st.floats(0, 2), st.floats(0, 5))
def test_radius_allocates_only_what_can_be_seen(
    lattice: Lattice, east_m: float, north_m: float, range_m: float, period_s: float, speed_mps: float
) -> None:
    """No tile inside the window lies outside the disc, and no tile that the disc meets is left out."""
    window = Radius(lattice, range_m, period_s, speed_mps)
    area = window.around(east_m, north_m)
    rounding_m = 1e-8 * max(1.0, abs(east_m), abs(north_m), lattice.tile_m)
    for key in area:
        assert distance_m(lattice.tile_bounds(key), east_m, north_m) <= window.radius_m + rounding_m
    for key in ring(area):
        assert distance_m(lattice.tile_bounds(key), east_m, north_m) >= window.radius_m - rounding_m


def ring(area: set[TileKey]) -> set[TileKey]:
    """The neighbours of an area's tiles that are not in it."""
    around = {TileKey(x + dx, y + dy) for x, y, _ in area for dx in (-1, 0, 1) for dy in (-1, 0, 1)}
    return {key for key in around if key not in area}


fractions = st.floats(0, 1)
bearings = st.floats(-math.pi, math.pi)


@given(lattices, places, places, st.floats(0.01, 60), fractions, bearings, fractions, bearings)
def test_what_is_hit_until_the_next_update_is_in_the_window(
    lattice: Lattice, east_m: float, north_m: float, range_m: float, gone: float, way: float, hit: float, beam: float
) -> None:
    """The robot drives on, at most speed · period; whatever it then hits within its range lies inside the window."""
    period_s, speed_mps = 0.5, 3.0
    area = Radius(lattice, range_m, period_s, speed_mps).around(east_m, north_m)
    drive_m, range_hit_m = gone * period_s * speed_mps, hit * range_m
    point = (
        east_m + drive_m * math.cos(way) + range_hit_m * math.cos(beam),
        north_m + drive_m * math.sin(way) + range_hit_m * math.sin(beam),
    )
    assert lattice.tile_at(*point) in area


# --- centred ---------------------------------------------------------------------------------------------------------


def test_centred_by_hand() -> None:
    """The *patrol* paper's local map: 320 cells of 0.5 m, 160 m a side, in tiles of 40 m.

    The robot at (10, 10) is in cell 20; the square has the cells -140 to 179, metres -70 to 90: tiles -2 to 2.
    """
    assert set(Centred(Lattice(0.5)).around(10, 10)) == tiles(-2, -1, 0, 1, 2, ys=(-2, -1, 0, 1, 2))
    # In cell 160 the square has the cells 0 to 319: four tiles, edge to edge.
    assert set(Centred(Lattice(0.5)).around(80, 80)) == tiles(0, 1, 2, 3, ys=(0, 1, 2, 3))
    assert set(Centred(Lattice(0.5), cells=1).around(80, 80)) == tiles(2, ys=(2,))


@given(lattices, places, places, st.integers(1, 200))
def test_centred_holds_exactly_the_tiles_of_its_square(
    lattice: Lattice, east_m: float, north_m: float, cells: int
) -> None:
    i, j = (int(lattice.cell(v)) - cells // 2 for v in (east_m, north_m))
    side = lattice.tile_cells
    xs, ys = ({(first + k) // side for k in range(cells)} for first in (i, j))
    assert set(Centred(lattice, cells).around(east_m, north_m)) == {TileKey(x, y) for x in xs for y in ys}


# --- all of them -----------------------------------------------------------------------------------------------------

BOUNDED = sorted(set(WINDOWS) - {"all"})
walks = st.lists(st.tuples(st.floats(-30, 30), st.floats(-30, 30)), min_size=1, max_size=30)


@pytest.mark.parametrize("name", BOUNDED)
@given(walk=walks)
def test_a_window_counts_what_was_ever_inside(name: str, walk: list[tuple[float, float]]) -> None:
    lattice = Lattice(0.5, 4.0)
    window = Residency(make_window(name, lattice))
    inside: set[TileKey] = set()
    ever: set[TileKey] = set()
    for place in walk:
        moved = window.move(*place)
        assert lattice.tile_at(*place) in window.area
        assert moved == (inside != set(window.area))
        inside = set(window.area)
        assert len(inside) == len(window.area) <= window.most_tiles
        ever |= inside
    assert window.visited == ever


@pytest.mark.parametrize("name", sorted(WINDOWS))
def test_standing_still_moves_nothing(name: str) -> None:
    window = Residency(make_window(name, LATTICE))
    window.move(40.0, -40.0)  # on a corner of tiles
    assert [window.move(40.0, -40.0) for _ in range(5)] == [False] * 5


@pytest.mark.parametrize("name", ["nine_block", "radius", "centred"])
@given(walk=walks)
def test_only_tiles3x3_depends_on_the_way(name: str, walk: list[tuple[float, float]]) -> None:
    lattice = Lattice(0.5, 4.0)
    there, fresh = make_window(name, lattice), make_window(name, lattice)
    for place in walk:
        last = there.around(*place)
    assert last == fresh.around(*walk[-1])


def test_tiles3x3_depends_on_the_way() -> None:
    came, fresh = Tiles3x3(LATTICE), Tiles3x3(LATTICE)
    came.around(20, 20)
    assert came.around(45, 20) != fresh.around(45, 20)


def test_tiles_of_other_levels_are_outside() -> None:
    assert TileKey(0, 0, 1) not in NineBlock(LATTICE).around(10, 10)


def test_all_keeps_all() -> None:
    window = Residency(make_window("all", LATTICE))
    window.move(0, 0)
    assert not window.move(1e6, 0)
    assert window.area is EVERYWHERE is KeepAll(LATTICE).around(3, 4)
    assert TileKey(-9, 10**9) in window.area


def test_a_window_of_your_own() -> None:
    class Here:
        def __init__(self, lattice: Lattice, more: float = 0) -> None:
            self._window = Centred(lattice, 1 + more)

        def around(self, east_m: float, north_m: float) -> Area:
            return self._window.around(east_m, north_m)

    WINDOWS["here"] = Here
    try:
        assert set(make_window("here", LATTICE).around(50, 10)) == {TileKey(1, 0)}
        assert len(make_window("here?more=400", LATTICE).around(50, 10)) == 4
    finally:
        del WINDOWS["here"]


# --- text ------------------------------------------------------------------------------------------------------------


def test_options_reach_the_window() -> None:
    window = make_window("radius?range_m=8&period_s=0.5&speed_mps=0.3", LATTICE)
    assert isinstance(window, Radius)
    assert window.radius_m == pytest.approx(8.15)
    assert len(make_window("centred?cells=1", LATTICE).around(0, 0)) == 1
    assert make_window("radius", LATTICE).radius_m == pytest.approx(52.0)  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("round", "no window 'round'; there are: all, centred, nine_block, radius, tiles3x3"),
        ("", "no window ''"),
        ("radius?rnge_m=8", "no option 'rnge_m'; it takes: range_m, period_s, speed_mps"),
        ("tiles3x3?cells=3", "no option 'cells'; it takes: none"),
        ("radius?range_m", "'range_m' after the '?' is not key=value"),
        ("radius?range_m=far", "range_m=far: give a number, as in 'radius?range_m=8'"),
        ("radius?range_m=0", "range_m=0: give a finite number over 0"),
        ("radius?range_m=nan", "range_m=nan"),
        ("radius?range_m=inf", "range_m=inf"),
        ("radius?period_s=-1", "period_s=-1: give a finite number, 0 or more"),
        ("radius?speed_mps=-1", "speed_mps=-1"),
        ("radius?range_m=1e9", "tiles across; at most 256"),
        ("centred?cells=0", "cells=0: give a whole number over 0"),
        ("centred?cells=3.5", "cells=3.5: give a whole number"),
        ("centred?cells=nan", "cells=nan"),
        ("centred?cells=inf", "cells=inf"),
        ("centred?cells=1e12", "tiles across; at most 256"),
        ("radius?range_m=8&range_m=9", "range_m is given twice"),
    ],
)
def test_bad_text_says_what_is_wrong(text: str, says: str) -> None:
    with pytest.raises(InputError) as fault:
        make_window(text, LATTICE)
    assert says in str(fault.value)
