"""The compiled rasteriser equals its reference, bit for bit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from terrafuse.kernels.evidence import EVIDENCE, mean_m, variance_m2
from terrafuse.kernels.rasterise import WINDOW, cell_at, place_of, rasterise_reference
from terrafuse.lattice import Lattice
from terrafuse.models import make_model
from terrafuse.models.elevation import ElevationPatch
from terrafuse.types import Array, Pose, Scan


def flat(patch: ElevationPatch, lattice: Lattice) -> tuple[Array, Array]:
    """A patch as the reference gives it: cells (i, j) in rising (j, i) order, and records."""
    side = lattice.tile_cells
    x, y, _ = np.array(patch.keys, np.int64).reshape(-1, 3)[patch.tile_of].T
    i, j = patch.at % side + x * side, patch.at // side + y * side
    order = np.lexsort((i, j))
    return np.stack([i, j], axis=1)[order], patch.records[order]


def assert_equals_reference(scan: Scan, lattice: Lattice, **gate: float) -> ElevationPatch:
    patch = make_model("elevation", gate).observer(lattice)(scan)
    near, far = gate.get("min_range_m", 0.0), gate.get("max_range_m", 1e8)
    cells, records = rasterise_reference(scan.points, scan.T_world_sensor.matrix, lattice.cells_per_m, near, far)
    got_cells, got = flat(patch, lattice)
    np.testing.assert_array_equal(got_cells, cells)
    np.testing.assert_array_equal(got, records)
    assert patch.points == len(scan.points)
    assert int(records["n"].sum()) + sum(patch.dropped.values()) == len(scan.points)
    return patch


def random_pose(rng: np.random.Generator, reach_m: float) -> Pose:
    return Pose.from_quaternion(rng.uniform(-reach_m, reach_m, 3), rng.normal(size=4))


@given(
    seed=st.integers(0, 2**32),
    count=st.sampled_from([0, 1, 7, 500, 2048, 2049, 5000]),
    spread_m=st.sampled_from([0.3, 5.0, 80.0, 900.0]),
    resolution_m=st.sampled_from([0.1, 0.5, 4.0]),
    dtype=st.sampled_from([np.float32, np.float64]),
)
@settings(max_examples=60)
def test_equals_the_reference(seed: int, count: int, spread_m: float, resolution_m: float, dtype: type) -> None:
    """Also where a scan is wider than the index grid, and where points are NaN, infinite, too near or too far."""
    rng = np.random.default_rng(seed)
    points = rng.normal(0, spread_m, (count, 3)).astype(dtype)
    broken = rng.random(count) < 0.05
    points[broken, rng.integers(0, 3, broken.sum())] = rng.choice([np.nan, np.inf, -np.inf], broken.sum())
    scan = Scan(0, points, random_pose(rng, 3 * spread_m))
    assert_equals_reference(scan, Lattice(resolution_m), min_range_m=0.5 * spread_m, max_range_m=2 * spread_m)


def test_an_observer_is_empty_between_scans() -> None:
    lattice = Lattice(0.5)
    observe = make_model("elevation").observer(lattice)
    rng = np.random.default_rng(1)
    for count in (3000, 10, 40_000, 0, 500):
        points = rng.normal(0, 30, (count, 3))
        cells, records = rasterise_reference(points, np.eye(4), lattice.cells_per_m, 0.0, 1e8)
        got_cells, got = flat(observe(Scan(0, points, Pose.identity())), lattice)
        np.testing.assert_array_equal(got_cells, cells)
        np.testing.assert_array_equal(got, records)


@pytest.mark.parametrize("tile_cells", [1, 31, 33])
def test_tiles_of_few_cells(tile_cells: int) -> None:
    """Of 31 cells and less, the window meets more than are tabled."""
    points = np.random.default_rng(3).normal(0, 30, (3000, 3))
    assert_equals_reference(Scan(0, points, Pose.identity()), Lattice(0.5, 0.5 * tile_cells))


def test_points_on_borders_and_negative_coordinates() -> None:
    grid = np.arange(-30, 31) * 0.1
    x, y = (a.ravel() for a in np.meshgrid(grid, grid))
    assert_equals_reference(Scan(0, np.stack([x, y, x * y], axis=1), Pose.identity()), Lattice(0.1))


def test_no_float32_loss_at_utm_coordinates_and_height() -> None:
    """The same offsets from an origin at UTM coordinates and 1000 m up give the same cells and statistics."""
    rng = np.random.default_rng(2)
    offsets = rng.uniform(0, 20, (4000, 3))
    lattice, far = Lattice(0.5), np.array([500_000.0, 4_000_000.0, 1000.0])
    model = make_model("elevation")
    near_patch = model.observer(lattice)(Scan(0, offsets, Pose.identity()))
    far_patch = model.observer(lattice)(Scan(0, offsets, Pose.identity().shifted(*far)))
    _, near_records = flat(near_patch, lattice)
    _, far_records = flat(far_patch, lattice)
    np.testing.assert_array_equal(far_records["n"], near_records["n"])
    np.testing.assert_allclose(mean_m(far_records) - 1000, mean_m(near_records), atol=1e-5)
    np.testing.assert_allclose(variance_m2(far_records), variance_m2(near_records), atol=1e-5)


def test_dropped_points_are_counted_by_reason() -> None:
    points = np.array([[np.nan, 0, 0], [0, np.inf, 0], [0.1, 0, 0], [90, 0, 0], [5, 0, 0], [5, 0, 20_000.0]])
    patch = make_model("elevation", {"min_range_m": 1, "max_range_m": 50_000}).observer(Lattice(0.1))(
        Scan(0, points, Pose.identity())
    )
    assert dict(patch.dropped) == {"not finite": 2, "nearer than min_range_m": 1, "height beyond ±10 km": 1}
    assert patch.records["n"].sum() == 2


def test_sums_of_squares_use_both_words() -> None:
    """2¹⁰ points at 10 km: Σz² needs over 64 bits."""
    points = np.tile([[0.05, 0.05, 10_000.0]], (1 << 10, 1))
    patch = assert_equals_reference(Scan(0, points, Pose.identity()), Lattice(0.1))
    assert patch.records["sq_hi"][0] > 0
    assert variance_m2(patch.records)[0] == pytest.approx(0, abs=1e-6)


def test_places_are_a_bijection() -> None:
    i, j = np.meshgrid(np.arange(0, WINDOW, 7), np.arange(0, WINDOW, 11))
    places = np.array([place_of(a, b) for a, b in zip(i.ravel(), j.ravel(), strict=True)])
    assert len(np.unique(places)) == places.size
    assert [cell_at(p) for p in places] == list(zip(i.ravel(), j.ravel(), strict=True))


def test_evidence_is_half_a_cache_line() -> None:
    assert EVIDENCE.itemsize == 32
