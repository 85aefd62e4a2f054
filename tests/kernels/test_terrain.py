"""The compiled terrain kernels equal their references."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from terrafuse.kernels import (
    terrain,
    terrain_coarsen,
    terrain_fuse,
    terrain_merge,
    terrain_planes,
    terrain_points,
)
from terrafuse.kernels.rasterise import DROP_REASONS, WINDOW
from terrafuse.lattice import Lattice
from terrafuse.models.terrain import Terrain, TerrainPatch
from terrafuse.types import Array, Pose, Scan
from tests.kernels.test_rasterise import random_pose
from tests.models.test_terrain import some_cells

FIELDS = terrain.CELL.names or ()


@njit
def bits(x):
    return terrain_planes.bits(x)


def same(one: Array, other: Array) -> None:
    for name in FIELDS:
        np.testing.assert_allclose(one[name], other[name], rtol=1e-5, atol=1e-6, err_msg=name)


def flat(patch: TerrainPatch, lattice: Lattice) -> tuple[Array, Array, Array]:
    """(i, j, records) of a patch in rising (j, i) order."""
    side, keys = lattice.tile_cells, np.array(patch.keys, int).reshape(-1, 3)[patch.tile_of]
    i, j = keys[:, 0] * side + patch.at % side, keys[:, 1] * side + patch.at // side
    order = np.lexsort((i, j))
    return i[order], j[order], patch.records[order]


def observe_reference(scan: Scan, lattice: Lattice, model: Terrain) -> tuple[Array, Array, Array]:
    """(i, j, CELL records) of a scan, in rising (j, i) order."""
    T, per_m, far_m = scan.T_world_sensor.matrix, lattice.cells_per_m, model.range_m(scan)
    i, j, *uvw = terrain_points.locate_reference(scan.points, T, per_m, model.min_range_m, far_m)
    i, j, sums = terrain_points.add_up_reference(i, j, *uvw, round(model.subcells**0.5))
    cells = terrain_planes.fit_reference(sums, T[2, 3], per_m, model.shape(lattice.resolution_m))
    terrain_planes.difference_neighbours_reference(i, j, sums, cells, per_m, model.point_sigma_m)
    cells["confidence"] = terrain_planes.assess_reference(i, j, sums, T, per_m, far_m, model.subcells)
    terrain_planes.occupy_reference(cells, model.max_slope)
    return i, j, cells


def assert_equals_reference(scan: Scan, lattice: Lattice, model: Terrain) -> int:
    i, j, records = flat(model.observer(lattice)(scan), lattice)
    expected_i, expected_j, expected = observe_reference(scan, lattice, model)
    np.testing.assert_array_equal(i, expected_i)
    np.testing.assert_array_equal(j, expected_j)
    same(records, expected)
    return len(i)


@given(
    seed=st.integers(0, 2**32),
    count=st.sampled_from([1, 7, 500, 2049, 20_000]),
    spread_m=st.sampled_from([0.5, 5.0, 60.0]),
    resolution_m=st.sampled_from([0.5, 4.0]),
    dtype=st.sampled_from([np.float32, np.float64]),
)
@settings(max_examples=40)
def test_a_scan_equals_the_reference(seed: int, count: int, spread_m: float, resolution_m: float, dtype: type) -> None:
    """Also where points are NaN, infinite, too near or too far."""
    rng = np.random.default_rng(seed)
    points = (rng.normal(0, spread_m, (count, 3)) * (1, 1, 0.05)).astype(dtype)
    points[0] = spread_m  # one that counts
    broken = rng.random(count) < 0.05
    broken[0] = False
    points[broken, rng.integers(0, 3, broken.sum())] = rng.choice([np.nan, np.inf, -np.inf], broken.sum())
    scan = Scan(0, points, random_pose(rng, 3 * spread_m))
    assert_equals_reference(scan, Lattice(resolution_m), Terrain(min_range_m=0.3 * spread_m, max_range_m=2 * spread_m))


def test_a_scan_wider_than_the_window_equals_the_reference() -> None:
    """Cells find their neighbours also where two blocks of the index grid meet."""
    rng = np.random.default_rng(1)
    length_m = 1.5 * WINDOW * 0.1
    points = rng.uniform((-length_m, -1, -1), (length_m, 1, 1), (60_000, 3))
    model = Terrain(max_range_m=1e8)
    assert assert_equals_reference(Scan(0, points, random_pose(rng, 10)), Lattice(0.1), model) > 30_000


@pytest.mark.parametrize("subcells", [1, 16, 64])
@pytest.mark.parametrize("below", [-1e-18, -5e-324, np.nextafter(0.0, -1.0), np.nextafter(1.0, 0.0)])
def test_points_just_below_a_border_hit_the_last_subcell(below: float, subcells: int) -> None:
    """In both axes: of 4×4 sub-cells number 15, of 8×8 number 63."""
    across, lattice, model = round(subcells**0.5), Lattice(1.0), Terrain(subcells=subcells)
    scan = Scan(0, np.array([(below, below, 0.0)]), Pose.identity())
    points, dropped = terrain_points.new_points(1), np.zeros(len(DROP_REASONS) + 1, np.int64)
    T, gate, later = scan.T_world_sensor.matrix, (0.0, 100.0), np.empty(1, np.int64)
    terrain_points.locate(scan.points, T, 1.0, -9, -9, *gate, across, *points, dropped, later)
    assert points.parts.tolist() == [subcells - 1]
    ends = terrain_points.locate_reference(scan.points, T, 1.0, *gate)
    assert terrain_points.add_up_reference(*ends, across)[2]["hit"].tolist() == [1 << (subcells - 1)]
    assert assert_equals_reference(scan, lattice, model) == 1


def test_an_observer_is_empty_between_scans() -> None:
    lattice, model = Lattice(0.5), Terrain()
    observe = model.observer(lattice)
    rng = np.random.default_rng(2)
    for count in (3000, 10, 40_000, 500):
        scan = Scan(0, rng.normal(0, 8, (count, 3)), random_pose(rng, 20))
        i, j, records = flat(observe(scan), lattice)
        expected = observe_reference(scan, lattice, model)
        np.testing.assert_array_equal((i, j), expected[:2])
        same(records, expected[2])


@pytest.mark.parametrize("slope", [(0.0, 0.0), (0.3, -0.2)])
def test_planes_are_numpys_least_squares(slope: tuple[float, float]) -> None:
    rng = np.random.default_rng(3)
    points = rng.uniform(0, 1, (12, 3))
    points[:, 2] = points[:, :2] @ slope + rng.normal(0, 0.1, 12)
    X = np.column_stack([np.ones(12), points[:, :2]])
    c, a, b = np.linalg.lstsq(X, points[:, 2], rcond=None)[0]
    records = Terrain().observer(Lattice(1.0))(Scan(0, points, random_pose(rng, 0).identity())).records
    assert records["gradient_x"][0] == pytest.approx(a, rel=1e-5)
    assert records["gradient_y"][0] == pytest.approx(b, rel=1e-5)
    assert records["height"][0] == pytest.approx(c + (a + b) / 2)


@given(seed=st.integers(0, 10_000))
def test_ageing_equals_the_reference(seed: int) -> None:
    cells, rules = some_cells(seed), Terrain().rules(0.5)
    expected = terrain.aged_reference(cells, 10**12, rules)
    np.testing.assert_allclose(terrain.aged_at(cells, 10**12, rules), expected, rtol=1e-14)


@given(seed=st.integers(0, 10_000), resolution_m=st.sampled_from([0.5, 5.0]))
@settings(max_examples=60)
def test_fuse_equals_the_reference(seed: int, resolution_m: float) -> None:
    rules = Terrain().rules(resolution_m)
    own, new = some_cells(seed), some_cells(seed + 1)
    expected = terrain_fuse.fuse_reference(own, new, rules)
    terrain_fuse.fuse(own, new, rules)
    same(own, expected)


@given(seed=st.integers(0, 10_000), late=st.booleans())
@settings(max_examples=60)
def test_merge_equals_the_reference(seed: int, late: bool) -> None:
    rules = Terrain().rules(0.5)
    own, new = some_cells(seed, 200), some_cells(seed + 1, 200)
    new = new[new["flags"] & terrain.HEIGHT != 0]
    new["flags"] &= terrain.KNOWN
    at = np.random.default_rng(seed).permutation(200)[: len(new)].astype(np.int32)
    stamp = 10**11 if late else 2 * 10**12
    halves = [own[:100], own[100:]]
    expected = own.copy()
    expected[at] = terrain_merge.merge_reference(own[at], new, stamp, 77, rules)
    addresses = np.array([half.ctypes.data for half in halves])
    terrain_merge.merge(addresses, (at // 100).astype(np.int32), at % 100, new, stamp, 77, rules)
    same(own, expected)


@given(seed=st.integers(0, 10_000), factor=st.sampled_from([2, 4, 8]))
@settings(max_examples=60)
def test_coarsen_equals_the_reference(seed: int, factor: int) -> None:
    rules = Terrain().rules(0.0)
    cells = some_cells(seed, 256).reshape(16, 16)
    cells["confidence"][cells["height"] > 4] = 0.0
    out = np.zeros((16 // factor, 16 // factor), terrain.CELL)
    terrain_coarsen.coarsen(cells, factor, rules, out)
    same(out, terrain_coarsen.coarsen_reference(cells, factor, rules))


@given(x=st.integers(0, 2**64 - 1))
def test_bits(x: int) -> None:
    assert bits(np.uint64(x)) == x.bit_count()
