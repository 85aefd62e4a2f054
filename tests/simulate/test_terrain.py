"""Ground: the triangles that it is made of, noise, streets laid into it, DEMs."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from terrafuse.errors import InputError
from terrafuse.simulate.noise import Octave, unit_noise
from terrafuse.simulate.streets import Streets, graded
from terrafuse.simulate.terrain import Terrain, flat, rolling, terrain_of
from terrafuse.simulate.worlds import dem_world
from terrafuse.types import Bounds

TWO = Terrain(10.0, 20.0, 2.0, np.array([[0.0, 1.0], [3.0, 7.0]]))
"""One square: 0 in the south-west, 1 in the south-east, 3 in the north-west, 7 in the north-east."""


def test_the_surface_is_two_triangles_a_square() -> None:
    """At (11.5, 20.5), f = 3/4, g = 1/4, in the south-eastern triangle: 0 + 3/4·(1 - 0) + 1/4·(7 - 1) = 2.25. At
    (10.5, 21.5), north-western: 0 + 1/4·(7 - 3) + 3/4·(3 - 0) = 3.25. Slopes a metre are half of those a square."""
    z, east, north = TWO.surface(np.array([11.5, 10.5]), np.array([20.5, 21.5]))
    assert z.tolist() == [2.25, 3.25]
    assert east.tolist() == [0.5, 2.0]
    assert north.tolist() == [3.0, 1.5]


def test_corners_belong_to_it_and_nothing_beyond() -> None:
    assert TWO.height(np.array([10, 12, 10, 12]), np.array([20, 20, 22, 22])).tolist() == [0, 1, 3, 7]
    assert np.isnan(TWO.height(np.array([9.99, 12.01, np.nan]), 21.0)).all()


@given(st.integers(0, 10**6), st.floats(-5, 5), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_a_plane_stays_one(seed: int, level: float, east: float, north: float) -> None:
    x, y = np.meshgrid(np.arange(5) * 3.0 - 7, np.arange(4) * 3.0 + 2)
    plane = Terrain(-7.0, 2.0, 3.0, level + east * x + north * y)
    rng = np.random.default_rng(seed)
    px, py = rng.uniform(-7, 5, 50), rng.uniform(2, 11, 50)
    np.testing.assert_allclose(plane.height(px, py), level + east * px + north * py, atol=1e-9)


def test_noise_has_the_stated_spread_and_is_smooth() -> None:
    """Mean 0 and variance 1 over 400 waves each way; neighbours a hundredth of a wave apart differ little."""
    axis = np.arange(0.0, 4000.0, 1.0)
    noise = unit_noise(axis, axis[:2000], 10.0, np.random.default_rng(0))
    # 800 × 400 knots, each of which counts as about one independent number.
    assert abs(noise.mean()) < 0.01
    assert noise.std() == pytest.approx(1.0, abs=0.01)
    fine = np.arange(0.0, 50.0, 0.1)
    assert np.abs(np.diff(unit_noise(fine, fine, 10.0, np.random.default_rng(1)), axis=0)).max() < 0.15


def test_one_seed_makes_one_terrain() -> None:
    bounds = Bounds(0, 0, 100, 50)
    one, again, other = (rolling(bounds, 2.0, (Octave(40.0, 1.0),), seed).heights_m for seed in (0, 0, 1))
    assert one.tobytes() == again.tobytes()
    assert one.shape == (26, 51)
    assert (one != other).any()


def test_streets_are_level_across_and_as_high_as_their_bed() -> None:
    """A bed that rises 1 in 10 to the east under bumps of a metre; a street along y = 50."""
    bounds = Bounds(0, 0, 100, 100)
    bumps = rolling(bounds, 1.0, (Octave(12.0, 1.0),), 0)
    bed = Terrain(0.0, 0.0, 1.0, np.broadcast_to(0.1 * np.arange(101.0), (101, 101)).copy())
    rough = Terrain(0.0, 0.0, 1.0, bed.heights_m + bumps.heights_m)
    street = Streets(np.array([(-10.0, 50.0), (110.0, 50.0)]), np.array([(0, 1)]), 6.0)
    out = graded(rough, bed, street, level_m=4.0, blend_m=6.0)
    np.testing.assert_allclose(out.heights_m[46:55], bed.heights_m[46:55], atol=1e-12)
    np.testing.assert_array_equal(out.heights_m[:40], rough.heights_m[:40])
    np.testing.assert_array_equal(out.heights_m[61:], rough.heights_m[61:])
    assert (abs(out.heights_m - rough.heights_m)[40:46] > 0).any()


@pytest.mark.parametrize(
    ("step", "heights", "says"),
    [
        (0.0, np.zeros((2, 2)), "terrain step 0.0 m"),
        (1.0, np.zeros((1, 5)), r"terrain of \(1, 5\) heights: give at least 2×2"),
        (1.0, np.array([[0.0, np.nan], [0, 0]]), "fill the gaps"),
    ],
)
def test_what_is_no_surface_is_refused(step: float, heights: np.ndarray, says: str) -> None:
    with pytest.raises(InputError, match=says):
        Terrain(0.0, 0.0, step, heights)


def write_dem(path: Path, z: np.ndarray, crs: str = "EPSG:32632", sides: tuple[float, float] = (5.0, 5.0)) -> Path:
    """Row 0 of `z` in the north; the raster's north-western corner at (500000, 5400000)."""
    rasterio = pytest.importorskip("rasterio")
    affine = rasterio.transform.Affine(sides[0], 0.0, 500_000.0, 0.0, -sides[1], 5_400_000.0)
    shape = {"height": z.shape[0], "width": z.shape[1], "count": 1}
    with rasterio.open(
        path, "w", driver="GTiff", dtype="float64", crs=crs, transform=affine, nodata=-9999, **shape
    ) as out:
        out.write(z, 1)
    return path


def test_a_dem_is_a_terrain_with_pixels_as_corners(tmp_path: Path) -> None:
    """12×10 pixels of 5 m: centres from 500002.5 to 500047.5 and from 5399942.5 to 5399997.5."""
    z = np.arange(120.0).reshape(12, 10)
    world = dem_world(write_dem(tmp_path / "hill.tif", z))
    assert world.crs == "EPSG:32632"
    assert world.name == "hill"
    assert tuple(world.bounds) == (500_002.5, 5_399_942.5, 500_047.5, 5_399_997.5)
    assert float(world.terrain.height(500_002.5, 5_399_997.5)) == 0
    assert float(world.terrain.height(500_047.5, 5_399_942.5)) == 119
    # Half way between pixels 0 and 1 of the northern row; then half way down from there to the next row, + 10/2.
    assert float(world.terrain.height(500_005.0, 5_399_997.5)) == 0.5
    assert float(world.terrain.height(500_005.0, 5_399_995.0)) == pytest.approx(5.5)


def test_a_part_of_a_dem_is_what_its_bounds_need(tmp_path: Path) -> None:
    z = np.arange(120.0).reshape(12, 10)
    file = write_dem(tmp_path / "hill.tif", z)
    bounds = Bounds(500_010.0, 5_399_950.0, 500_020.0, 5_399_960.0)
    part, _ = terrain_of(file, bounds)
    whole, _ = terrain_of(file)
    assert part.heights_m.shape == (4, 4)
    x, y = np.meshgrid(np.linspace(500_010, 500_020, 7), np.linspace(5_399_950, 5_399_960, 7))
    np.testing.assert_allclose(part.height(x, y), whole.height(x, y), atol=1e-9)
    assert not np.isnan(part.height(x, y)).any()
    with pytest.raises(InputError, match="its heights cover"):
        dem_world(file, bounds._replace(east=500_100.0))


def test_dems_that_can_not_be_ground_are_refused(tmp_path: Path) -> None:
    z = np.arange(120.0).reshape(12, 10)
    with pytest.raises(InputError, match="counts in degrees"):
        dem_world(write_dem(tmp_path / "degrees.tif", z, "EPSG:4326", (0.001, 0.001)))
    with pytest.raises(InputError, match=re.escape("pixels of 5 m × 4 m")):
        dem_world(write_dem(tmp_path / "oblong.tif", z, sides=(5.0, 4.0)))
    z[3, 4] = -9999
    with pytest.raises(InputError, match="1 of its heights are missing"):
        dem_world(write_dem(tmp_path / "gap.tif", z))


def test_a_surveyed_dem_in_degrees_says_what_to_do(recordings: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(recordings / "rasters/rasterio/N10W110.hgt.zip") as archive:
        archive.extractall(tmp_path)
    with pytest.raises(InputError, match="gdalwarp -t_srs"):
        dem_world(next(tmp_path.glob("*.hgt")))


def test_level_ground_covers_its_bounds() -> None:
    ground = flat(Bounds(-1.0, 2.0, 7.0, 5.0), 1.5)
    assert ground.height(np.array([-1.0, 7.0]), np.array([2.0, 5.0])).tolist() == [1.5, 1.5]
