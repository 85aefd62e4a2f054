"""Truth rasters: against rays shot straight down, and against shapes whose cells are counted by hand."""

from __future__ import annotations

import numpy as np
import pytest

from terrafuse.errors import InputError
from terrafuse.lattice import Lattice
from terrafuse.simulate import truth
from terrafuse.simulate.blocks import Block
from terrafuse.simulate.movers import bodies, body
from terrafuse.simulate.rays import RayCaster
from terrafuse.simulate.regions import Region, StaticLayer
from terrafuse.simulate.streets import Streets
from terrafuse.simulate.terrain import flat
from terrafuse.simulate.world import World
from terrafuse.simulate.worlds.village import village
from terrafuse.types import Bounds, Floats
from tests.simulate.places import hamlet

SQUARE = Bounds(-10.0, -10.0, 10.0, 10.0)
METRE = Lattice(1.0, 100.0)


def seen_from_above(world: World, lattice: Lattice, bounds: Bounds, there: object = None) -> tuple[Floats, Floats]:
    """(truth, what rays straight down meet) at the cells' centres."""
    window = lattice.cell_window(bounds)
    x, y = np.meshgrid(*(lattice.cell_centre(np.arange(a, b)) for a, b in (window[::2], window[1::2])))
    starts = np.stack([x.ravel(), y.ravel(), np.full(x.size, 100.0)], axis=1)
    extra = {} if there is None else {"bodies": there}
    ranges = RayCaster(world).cast(starts, np.tile([0.0, 0.0, -1.0], (x.size, 1)), 200.0, **extra).ranges_m
    return truth.height(world, lattice, window, **extra), 100.0 - ranges.reshape(x.shape)


def test_heights_are_what_rays_straight_down_meet() -> None:
    pytest.importorskip("embreex")
    world = hamlet()
    there = bodies([body("car", 3.0, 6.0, 2.0, 0.3), body("person", -6.0, 6.0, 1.0, 0.0)])
    z, seen = seen_from_above(world, Lattice(0.37, 37.0), Bounds(-38.0, -38.0, 38.0, 38.0), there)
    # Cells whose centre is on a wall to a hundredth of a millimetre would be a matter of rounding; none is.
    np.testing.assert_allclose(z, seen, atol=1e-9)


def test_the_villages_heights_too() -> None:
    pytest.importorskip("embreex")
    world = village(5, side_m=300.0)
    z, seen = seen_from_above(world, Lattice(0.5, 50.0), Bounds(-140.0, -140.0, -20.0, 100.0), world.bodies(40.0))
    np.testing.assert_allclose(z, seen, atol=1e-9)


def plain(**parts: object) -> World:
    return World("plain", SQUARE, flat(SQUARE), **parts)  # type: ignore[arg-type]


def block(x: float, y: float, length: float, width: float, bottom: float, top: float, yaw: float = 0.0) -> Block:
    return Block("wall", x, y, length, width, yaw, bottom, top, top)


def test_a_block_occupies_the_cells_that_it_reaches_into() -> None:
    """3 m × 1 m on cells of 1 m: aligned it fills 3; moved by half a cell along, 4; off by 0.5 mm, still 3."""
    window = METRE.cell_window(SQUARE)
    for x, count in ((0.5, 3), (1.0, 4), (0.5005, 3), (0.502, 4)):
        world = plain(furniture=(block(x, 0.5, 3.0, 1.0, -1.0, 2.0),))
        assert truth.occupied(world, METRE, window, (0.1, 1.0)).sum() == count


def test_a_turned_block_occupies_no_cell_that_it_only_bounds() -> None:
    """A square of side 2√2 turned by 45° is |x| + |y| ≤ 2 around the corner of four cells: of the 4×4 cells around, the
    four in the corners touch it only in a point."""
    world = plain(furniture=(block(0.0, 0.0, 8**0.5, 8**0.5, -1.0, 2.0, np.pi / 4),))
    marked = truth.occupied(world, METRE, METRE.cell_window(SQUARE), (0.1, 1.0))
    expected = np.zeros((20, 20), bool)
    expected[8:12, 8:12] = [[0, 1, 1, 0], [1, 1, 1, 1], [1, 1, 1, 1], [0, 1, 1, 0]]
    np.testing.assert_array_equal(marked, expected)


def test_a_round_body_occupies_no_corner_beyond_its_radius() -> None:
    """A cylinder of radius 1 around a cell's centre reaches into the 4 cells beside (0.5 m away) and the 4 across
    (0.71 m away)."""
    marked = truth.occupied(plain(), METRE, METRE.cell_window(SQUARE), (0.1, 1.0), body("nomad", 0.5, 0.5, 0.0, 0.0))
    assert marked.sum() == 1
    wide = body("nomad", 0.5, 0.5, 0.0, 0.0)
    for radius, count in ((0.6, 5), (0.75, 9)):
        wide["half_length"] = radius
        assert truth.occupied(plain(), METRE, METRE.cell_window(SQUARE), (0.1, 1.0), wide).sum() == count


@pytest.mark.parametrize(("band", "count"), [((0.1, 0.4), 0), ((0.1, 0.6), 1), ((1.9, 3.0), 1), ((2.1, 3.0), 0)])
def test_only_what_is_in_the_band_occupies(band: tuple[float, float], count: int) -> None:
    """A shelf from 0.5 to 2 m above the ground."""
    world = plain(furniture=(block(0.5, 0.5, 0.8, 0.8, 0.5, 2.0),))
    assert truth.occupied(world, METRE, METRE.cell_window(SQUARE), band).sum() == count


def test_footprints_streets_and_layers_are_at_the_cells_centres() -> None:
    house = block(0.0, 0.0, 3.0, 1.0, -1.0, 2.0)
    street = Streets(np.array([(-20.0, 5.0), (20.0, 5.0)]), np.array([(0, 1)]), 3.1)
    ring = ((-10.0, -10.0), (0.0, -10.0), (0.0, 0.0), (-10.0, 0.0))
    layer = StaticLayer(2, (Region(0, ring), Region(1, ((-2.0, -2.0), (2.0, -2.0), (2.0, 2.0), (-2.0, 2.0)))))
    world = plain(furniture=(house,), streets=street, gps_quality=layer)
    window = METRE.cell_window(SQUARE)
    # Centres at -1.5 … 1.5 along, ±0.5 across: on the edge counts.
    assert truth.footprints(world, METRE, window, ("wall",)).sum() == 4 * 2
    assert not truth.footprints(world, METRE, window).any()
    # Centres at 3.5 … 6.5 north are within 1.55 m of 5.
    assert truth.streets(world, METRE, window).sum() == 4 * 20
    gps = truth.static_layer(world, "gps_quality", METRE, window)
    places = [(i + 0.5, j + 0.5) for j in range(-10, 10) for i in range(-10, 10)]
    assert [layer.at_place(*place) for place in places] == gps.ravel().tolist()
    # The later region covers 4×4, 2×2 of it over the earlier one's 10×10.
    assert [(gps == value).sum() for value in (0, 1, 2)] == [96, 16, 400 - 112]
    assert (truth.static_layer(world, "communications", METRE, window) == 1).all()


def test_off_the_terrain_there_is_no_height() -> None:
    z = truth.height(plain(), METRE, (-12, -12, 12, 12))
    assert np.isnan(z).sum() == 24 * 24 - 20 * 20


def test_wrong_questions_are_refused() -> None:
    with pytest.raises(InputError, match="static layer 'wifi': there are gps_quality, communications"):
        truth.static_layer(plain(), "wifi", METRE, (0, 0, 1, 1))
    with pytest.raises(InputError, match="lower height first"):
        truth.occupied(plain(), METRE, (0, 0, 1, 1), (1.0, 1.0))
