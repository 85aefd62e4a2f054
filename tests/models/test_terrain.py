"""The terrain model: the *patrol* paper's formulas with numbers by hand, the rows of its rule, and how it settles."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from terrafuse.errors import InputError
from terrafuse.kernels import terrain as kernel
from terrafuse.kernels.terrain_rule import occupation_reference
from terrafuse.lattice import MAX_CELL, Lattice
from terrafuse.mapper import Mapper
from terrafuse.models.base import Reading
from terrafuse.models.terrain import Terrain
from terrafuse.replica import Replica
from terrafuse.testing.deltas import SECOND_NS, scan_of
from terrafuse.types import Array, Beam, Pose, Scan, pose_of
from terrafuse.views import chosen_layers, mosaic

LATTICE = Lattice(1.0, 4.0)
FAR_AWAY = Terrain(max_range_m=1e8)
"""Range weights of 1, for what is not about range."""
TO_THE_LETTER = replace(FAR_AWAY, wall_slope=None)
"""As in the paper: nothing is a wall."""
SURFACE = kernel.HEIGHT | kernel.GRADIENT_X | kernel.GRADIENT_Y | kernel.OCCUPATION


def layers_of(*scans: Scan, model: Terrain = FAR_AWAY) -> dict[str, Array]:
    """Layers over the tile (0, 0), [j, i], after these scans by one robot."""
    mapper = Mapper("r1", LATTICE, model)
    for scan in scans:
        mapper.integrate(scan)
    replica = Replica(LATTICE, model)
    replica.apply(mapper.delta())
    return mosaic(replica, chosen_layers(replica, None), (0, 0, 4, 4))


def cell(
    height: float, confidence: float, slope: tuple[float, float] = (0.0, 0.0), stamp_s: float = 0.0, more: int = 0
) -> Array:
    """One known cell (1,)."""
    out = np.zeros(1, kernel.CELL)
    share = min(math.hypot(*slope) / 0.3, 1.0)
    for name, value in (("height", height), ("confidence", confidence), ("occupation", share), ("revision", 1)):
        out[name] = value
    out["gradient_x"], out["gradient_y"] = slope
    out["stamp"], out["flags"] = round(stamp_s * 1e9), SURFACE | more
    return out


def fused(a: Array, b: Array, model: Terrain = FAR_AWAY) -> Array:
    return model.fuse(a, b, LATTICE)[0]


def merged(own: Array, new: Array, stamp_s: float, model: Terrain = FAR_AWAY) -> Array:
    """An own cell (1,) after a look, (1,)."""
    tile = model.tile(LATTICE)
    tile.put(np.array([0], np.int32), own)
    tile.merge(np.array([0], np.int32), new.copy(), round(stamp_s * 1e9), 2)
    return tile.changed(0)[1]


# --- heights and gradients -------------------------------------------------------------------------------------------


def test_a_plane_through_three_points() -> None:
    """Eqs. 1 to 7 with z = 0.1 x + 0.2 y + 2: at the centre (0.5, 0.5) it is 2.15."""
    points = [(0.2, 0.2, 2.06), (0.8, 0.2, 2.12), (0.2, 0.8, 2.18)]
    layers = layers_of(scan_of(points))
    assert layers["height"][0, 0] == pytest.approx(2.15)
    assert layers["gradient_x"][0, 0] == pytest.approx(0.1)
    assert layers["gradient_y"][0, 0] == pytest.approx(0.2)


def test_least_squares_over_four_points() -> None:
    """Corners of a square with z = 0, 0, 0, 4: the mean is 1; from the left pair to the right z rises by 2 in 0.6."""
    points = [(0.2, 0.2, 0.0), (0.8, 0.2, 0.0), (0.2, 0.8, 0.0), (0.8, 0.8, 4.0)]
    layers = layers_of(scan_of(points), model=TO_THE_LETTER)
    assert layers["height"][0, 0] == pytest.approx(1.0)
    assert layers["gradient_x"][0, 0] == pytest.approx(2 / 0.6)
    assert layers["gradient_y"][0, 0] == pytest.approx(2 / 0.6)


@pytest.mark.parametrize(
    "points",
    [
        [(0.2, 0.2, 1.0), (0.8, 0.7, 2.0)],
        [(0.1, 0.1, 0.5), (0.5, 0.5, 1.5), (0.9, 0.9, 2.5)],
        [(0.5, 0.5, 0.0), (0.5, 0.5, 1.0), (0.5, 0.5, 3.5)],
        [(0.50, 0.50, 0.0), (0.52, 0.50, 1.0), (0.50, 0.52, 3.5)],
        [(0.1, 0.50, 0.0), (0.5, 0.53, 1.0), (0.9, 0.50, 3.5)],
    ],
    ids=["two", "on a line", "on a spot", "in a corner of 2 cm", "on a line but for 3 cm"],
)
def test_points_that_make_no_plane_give_their_mean(points: list[tuple[float, float, float]]) -> None:
    """All of them have the mean height 1.5, and no neighbours."""
    layers = layers_of(scan_of(points), model=TO_THE_LETTER)
    assert layers["height"][0, 0] == pytest.approx(1.5)
    for name in ("gradient_x", "gradient_y", "occupation"):
        assert np.isnan(layers[name][0, 0])


def over_a_line(across_m: float, slope: float = 0.0) -> Scan:
    """Two points 0.6 m apart and one between, so far beside their line; z rises by so much across.

    From their middle they lie across_m · (-1/3, -1/3, 2/3) across the line, which makes Σ = 2/3 · across_m².
    """
    return scan_of([(0.2, 0.4, 0.0), (0.8, 0.4, 0.0), (0.5, 0.4 + across_m, slope * across_m)])


@pytest.mark.parametrize(("across_m", "known"), [(0.042, False), (0.043, True)])
def test_three_points_make_a_plane_if_they_spread_by_more_than_noise(across_m: float, known: bool) -> None:
    """Their standard deviation across is √(2/9) · across_m: 1.98 and 2.03 cm, against twice 1 cm. Then it is exact."""
    layers = layers_of(over_a_line(across_m, slope=0.5))
    assert np.isfinite(layers["gradient_y"][0, 0]) == known
    if known:
        assert layers["gradient_x"][0, 0] == pytest.approx(0.0, abs=1e-6)
        assert layers["gradient_y"][0, 0] == pytest.approx(0.5, abs=1e-6)


def test_a_better_sensor_makes_planes_of_points_closer_together() -> None:
    """With 1 mm, 4.3 mm across are enough."""
    model = Terrain(max_range_m=1e8, point_sigma_m=0.001)
    assert np.isnan(layers_of(over_a_line(0.0042, 0.5), model=model)["gradient_y"][0, 0])
    assert layers_of(over_a_line(0.0043, 0.5), model=model)["gradient_y"][0, 0] == pytest.approx(0.5, abs=1e-6)


def test_the_error_of_a_slope() -> None:
    """From the middle of (0, 0), (0.6, 0), (0, 0.6): Σx² = Σy² = 0.24 and Σxy = -0.12, so the smallest eigenvalue is
    0.12, and 0.01/√0.12 = 0.028868. Of neighbours: means of 2 and 1 points, 2 m apart, 0.01 · √(1/2 + 1)/2 = 0.0061237;
    one-sided, of 1 and 2 points, 0.01 · √1.5 = 0.0122474."""
    plane = [(0.2, 0.2, 0.0), (0.8, 0.2, 0.0), (0.2, 0.8, 0.0)]
    assert layers_of(scan_of(plane))["gradient_error"][0, 0] == pytest.approx(0.028868, abs=1e-6)
    row = [(0.5, 0.5, 0.0), (0.6, 0.5, 0.0), (1.5, 0.5, 0.0), (2.5, 0.5, 0.0)]
    errors = layers_of(scan_of(row))["gradient_error"]
    assert errors[0, :2] == pytest.approx([0.0122474, 0.0061237], abs=1e-6)
    assert np.isnan(errors[0, 3])


def test_gradients_from_neighbours() -> None:
    """One point a cell. Along x: z = 0, 9, 1, so (9 - 0)/1, (1 - 0)/2, (1 - 9)/1 (eqs. 8, 9); no neighbours along y."""
    layers = layers_of(scan_of([(0.5, 0.5, 0.0), (1.5, 0.5, 9.0), (2.5, 0.5, 1.0)]))
    np.testing.assert_allclose(layers["gradient_x"][0, :3], [9.0, 0.5, -8.0])
    assert np.isnan(layers["gradient_y"][0]).all()


def test_gradients_across_a_tile_border_are_those_within() -> None:
    """Cells 3 and 4 lie in different tiles of 4: the same relief, a cell further west, gives the same."""
    relief = np.array([(k + 0.5, 0.5 + j, 0.1 * k * k + 0.3 * j) for k in range(6) for j in range(3)])
    model, lattice = FAR_AWAY, LATTICE
    across = Mapper("r", lattice, model)
    across.integrate(scan_of(relief))
    inside = Mapper("r", Lattice(1.0, 16.0), model)
    inside.integrate(scan_of(relief))
    heights = []
    for mapper in (across, inside):
        replica = Replica(mapper.lattice, model)
        replica.apply(mapper.delta())
        heights.append(mosaic(replica, chosen_layers(replica, None), (0, 0, 6, 3)))
    for name, values in heights[0].items():
        np.testing.assert_array_equal(values, heights[1][name])
    # Central in cell 3: z = 0.4, _, 1.6 in cells 2 and 4, so (1.6 - 0.4)/2.
    assert heights[0]["gradient_x"][1, 3] == pytest.approx(0.6)


def test_nothing_is_lost_at_utm_coordinates_and_1000_m() -> None:
    rng = np.random.default_rng(1)
    offsets = rng.uniform(0, 4, (400, 3)) * (1, 1, 0.1)
    near, far = Mapper("r", LATTICE, FAR_AWAY), Mapper("r", LATTICE, FAR_AWAY)
    near.integrate(Scan(0, offsets, Pose.identity()))
    far.integrate(Scan(0, offsets, Pose.identity().shifted(500_000, 4_000_000, 1000)))
    (one,), (other,) = near.delta().tiles, far.delta().tiles
    np.testing.assert_array_equal(one.at, other.at)
    np.testing.assert_allclose(other.cells["height"] - 1000, one.cells["height"], atol=1e-8)
    for name in ("gradient_x", "gradient_y", "occupation", "confidence"):
        np.testing.assert_allclose(other.cells[name], one.cells[name], atol=1e-6)


# --- occupation, confidence, age -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("slope", "expected"),
    [((0.0, 0.0), 0.0), ((0.15, 0.0), 0.5), ((0.06, -0.08), 1 / 3), ((0.18, 0.24), 1.0), ((3.0, 0.0), 1.0)],
)
def test_occupation_is_the_share_of_the_passable_slope(slope: tuple[float, float], expected: float) -> None:
    """hypot(0.06, 0.08) = 0.1, a third of 0.3; hypot(0.18, 0.24) = 0.3."""
    points = [(x, y, slope[0] * x + slope[1] * y) for x in (0.2, 0.8) for y in (0.2, 0.8)]
    assert layers_of(scan_of(points))["occupation"][0, 0] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize(
    ("across_m", "slope", "expected"), [(0.15, 0.0, 0.0), (0.1, 0.0, np.nan), (0.1, 0.66, np.nan), (0.1, 0.68, 1.0)]
)
def test_a_slope_that_may_be_level_or_impassable_makes_no_occupation(
    across_m: float, slope: float, expected: float
) -> None:
    """Three errors are 0.03/(√(2/3) · across_m): 0.245 of 0.15 m is less than 0.3; 0.367 of 0.1 m is more, unless the
    slope is impassable all the same: over 0.667."""
    assert layers_of(over_a_line(across_m, slope))["occupation"][0, 0] == pytest.approx(expected, nan_ok=True, abs=1e-6)


def test_one_known_gradient_tells_only_that_a_cell_is_impassable() -> None:
    layers = layers_of(scan_of([(0.5, 0.5, 0.0), (1.5, 0.5, 0.1), (0.5, 2.5, 0.0), (1.5, 2.5, 5.0)]))
    assert np.isnan(layers["occupation"][0, 0])
    assert layers["occupation"][2, 0] == 1.0


def test_confidence_is_the_share_of_subcells_times_the_range_weight() -> None:
    """Four of 16 sub-cells of the cell (3, 0), whose points' middle (3.5, 0.5, 0) lies 3 m from the sensor.

    With 8 m of range: 3/8 of it is half of 0.75, where the weight is 0.9; 4/16 · 0.9 · 255 = 57.375.
    """
    points = np.array([(3.4, 0.4, 0.0), (3.6, 0.4, 0.0), (3.4, 0.6, 0.0), (3.6, 0.6, 0.0)])
    sensor = np.array([3.5, 0.5, 3.0])
    scan = Scan(0, points - sensor, pose_of(np.eye(3), sensor))
    assert layers_of(scan, model=Terrain(max_range_m=8))["confidence"][0, 3] == pytest.approx(57.375, abs=0.01)


def test_subcells_are_a_setting() -> None:
    """Of 5×5 sub-cells of 0.2 m, points at 0.1, 0.3 and 0.35 hit two: 2/25 of 255 is 20.4."""
    scan = scan_of([(0.1, 0.5, 0.0), (0.3, 0.5, 0.0), (0.35, 0.5, 0.0)])
    layers = layers_of(scan, model=Terrain(max_range_m=1e8, subcells=25))
    assert layers["confidence"][0, 0] == pytest.approx(20.4, abs=1e-4)


@pytest.mark.parametrize(
    ("distance_m", "weight"), [(1.5, 0.96), (5.0, 13 / 15), (7.5, 0.8), (8.0, 0.64), (8.75, 0.4), (10.0, 0.0)]
)
def test_range_weight(distance_m: float, weight: float) -> None:
    """Eq. 10 with R = 10 m: 1 - 0.2 · 1.5/7.5; 1 - 0.2 · 5/7.5; the corner; 0.8 · (10 - 8)/2.5; 0.8/2; the end."""
    below = Scan(0, np.array([(0.0, 0.0, -distance_m)]), pose_of(np.eye(3), np.array([0.5, 0.5, 0.0])))
    confidence = layers_of(below, model=Terrain(max_range_m=10))["confidence"][0, 0]
    assert confidence / 255 * 16 == pytest.approx(weight, abs=1e-6)


def test_the_maximum_range_is_the_settings_then_the_sensors_then_50_m() -> None:
    scan = Scan(0, np.array([(0.5, 0.5, 0.0)]), Pose.identity())
    sonar = Scan(0, scan.points, scan.T_world_sensor, beam=Beam(max_range_m=5.0))
    assert (Terrain().range_m(scan), Terrain().range_m(sonar), Terrain(max_range_m=7).range_m(sonar)) == (50, 5, 7)
    assert Terrain().range_m(replace(sonar, beam=Beam(max_range_m=1e200))) == 1e8
    done = Mapper("r", LATTICE, Terrain()).integrate(Scan(0, np.array([(51.0, 0, 0), (5, 0, 0)]), Pose.identity()))
    assert (done.cells, dict(done.dropped)) == (1, {"beyond max_range_m": 1})


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("axis", [0, 1])
def test_points_beyond_the_lattice_are_dropped(axis: int, sign: int) -> None:
    """10 m before the last cell: of points 5, 50 and 9000 m further (the index grid ends at 2048) the first counts."""
    points, place = np.zeros((3, 3)), np.zeros(3)
    points[:, axis], place[axis] = np.multiply(sign, (5.0, 50.0, 9000.0)), sign * (MAX_CELL - 10)
    patch = FAR_AWAY.observer(LATTICE)(Scan(0, points, pose_of(np.eye(3), place)))
    assert (patch.cells, dict(patch.dropped)) == (1, {"beyond the lattice": 2})


@pytest.mark.parametrize(("seconds", "share"), [(0, 1), (600, 1 / 2), (1200, 1 / 4), (300, math.sqrt(0.5))])
def test_confidence_halves_every_half_life(seconds: float, share: float) -> None:
    reading = Reading(LATTICE, round(seconds * 1e9))
    old, given = cell(1.0, 0.8), cell(1.0, 0.8, more=int(kernel.PRIOR))
    assert Terrain().confidence(old, reading)[0] == pytest.approx(255 * 0.8 * share)
    assert Terrain().confidence(given, reading)[0] == pytest.approx(255 * 0.8)
    assert Terrain(half_life_s=None).confidence(old, reading)[0] == pytest.approx(255 * 0.8)


def test_a_half_life_passes_before_two_cells_meet() -> None:
    """0.8 is 0.4 after 600 s: (0.4 · 1.0 + 0.4 · 1.2)/0.8 = 1.1, with 1 - 0.6 · 0.6 = 0.64."""
    out = fused(cell(1.0, 0.8), cell(1.2, 0.4, stamp_s=600))
    assert (out["height"], out["confidence"]) == (pytest.approx(1.1), pytest.approx(0.64))
    assert out["stamp"] == 600 * SECOND_NS


@given(x=st.floats(0, 1100))
def test_powers_of_a_half(x: float) -> None:
    assert kernel.half_power(x) == pytest.approx(2.0**-x, rel=1e-14, abs=1e-300)


# --- the rule --------------------------------------------------------------------------------------------------------

STEEP = (math.tan(math.radians(11)), 0.0)
"""11° from the level."""


def test_similar_cells_become_their_mean_by_confidence() -> None:
    """Eq. 11 with 0.6 and 0.3: (0.6 · 1.0 + 0.3 · 1.09)/0.9 = 1.03; gradient (0.6 · 0 + 0.3 · 0.15)/0.9 = 0.05, of
    which the occupation is 1/6; confidence 1 - 0.4 · 0.7 = 0.72."""
    out = fused(cell(1.0, 0.6), cell(1.09, 0.3, (0.15, 0.0)))
    assert out["height"] == pytest.approx(1.03)
    assert out["gradient_x"] == pytest.approx(0.05)
    assert out["occupation"] == pytest.approx(1 / 6)
    assert out["confidence"] == pytest.approx(0.72)


@pytest.mark.parametrize(("degrees", "similar"), [(9.9, True), (10.1, False)])
def test_ten_degrees_between_normals_part_the_similar_from_the_others(degrees: float, similar: bool) -> None:
    """Whichever way the plane leans: from -4° it is the rest to the other side."""
    low, high = math.tan(math.radians(-4)), math.tan(math.radians(degrees - 4))
    for one, other in (((low, 0.0), (high, 0.0)), ((0.0, low), (0.0, high))):
        out = fused(cell(1.0, 0.9, one), cell(1.2, 0.3, other))
        assert (out["height"] != 1.0) == similar


@pytest.mark.parametrize(
    ("older", "newer", "expected"),
    [
        (0.90, 0.30, "older"),  # gap 0.6 > 2/16: the surer
        (0.30, 0.90, "newer"),
        (0.70, 0.56, "older"),  # gap 0.14, though both are sure
        (0.48, 0.40, "older"),  # gap 0.08, both below 0.5: the surer
        (0.40, 0.48, "newer"),
        (0.70, 0.60, "newer"),  # gap 0.10, both sure: the world has changed
        (0.60, 0.70, "newer"),
        (0.55, 0.45, "newer"),  # gap 0.10, not both below 0.5
    ],
)
@pytest.mark.parametrize("how", ["angle", "height"])
def test_cells_that_disagree(older: float, newer: float, expected: str, how: str) -> None:
    """One row of the rule each; a second apart, which ages them by 0.1 %. A robot's own cell follows the same rows."""
    one = cell(1.0, older, (0.0, 0.0))
    other = cell(2.0 if how == "height" else 1.1, newer, STEEP if how == "angle" else (0.0, 0.0), stamp_s=1)
    chosen = {"older": one, "newer": other}[expected]
    assert fused(one, other)["height"] == chosen["height"][0]
    assert fused(other, one)["height"] == chosen["height"][0]
    assert merged(one, other, 1)["height"] == chosen["height"]
    assert fused(one, other)["confidence"] == chosen["confidence"][0]


def test_heights_tell_surfaces_apart_by_more_than_slope_explains() -> None:
    """0.3 m, or 0.3 · 2 m in cells of 2 m; with None the angle alone tells, as in the paper."""
    car, street = cell(1.4, 0.7, stamp_s=1), cell(0.0, 0.7)
    assert fused(street, car)["height"] == pytest.approx(1.4)
    assert fused(street, car, Terrain(similar_height_m=None))["height"] == pytest.approx(0.7, abs=1e-3)
    a, b = cell(0.0, 0.7), cell(0.5, 0.7, stamp_s=1)
    assert fused(a, b)["height"] == 0.5
    assert Terrain().fuse(a, b, Lattice(2.0, 4.0))["height"][0] == pytest.approx(0.25, abs=1e-3)


@pytest.mark.parametrize(("apart_m", "similar"), [(0.299, True), (0.301, False)])
def test_small_cells_differ_from_30_cm_on(apart_m: float, similar: bool) -> None:
    """In cells of 0.1 m; both are sure, so that they become their mean, or the newer one."""
    out = Terrain().fuse(cell(0.0, 0.7), cell(apart_m, 0.7, stamp_s=1), Lattice(0.1, 4.0))
    assert out["height"][0] == pytest.approx(apart_m / 2 if similar else apart_m, abs=1e-3)


def test_an_unknown_gradient_can_not_tell_cells_apart() -> None:
    """What one of them knows, the mean knows."""
    bare = cell(1.0, 0.5)
    bare["flags"] = kernel.HEIGHT
    out = fused(bare, cell(1.2, 0.5, (0.3, 0.4)))
    assert out["height"] == pytest.approx(1.1)
    assert (out["gradient_x"], out["gradient_y"], out["occupation"]) == pytest.approx((0.3, 0.4, 1.0))


def test_of_equal_stamps_the_surer_is_the_newer() -> None:
    """0.7 and 0.65 are both sure and less than 2/16 apart; of equal confidences one is chosen, in either order."""
    one, two, three = cell(1.0, 0.7), cell(2.0, 0.65), cell(2.0, 0.7)
    assert fused(one, two)["height"] == fused(two, one)["height"] == 1.0
    assert fused(one, three)["height"] == fused(three, one)["height"]


@pytest.mark.parametrize(("error", "similar"), [(0.0, False), (0.08, False), (0.09, True)])
def test_a_gradient_tells_cells_apart_as_far_as_its_error_lets_it(error: float, similar: bool) -> None:
    """0.35 is 19°; three errors of the difference are 3 · √2 · error: 0.339 and 0.382."""
    one, other = cell(1.0, 0.9), cell(1.2, 0.3, (0.35, 0.0))
    one["gradient_error"] = other["gradient_error"] = error
    assert (fused(one, other)["height"] != 1.0) == similar


def test_the_error_of_a_mean_slope() -> None:
    """Weights 2/3 and 1/3: √((2/3 · 0.03)² + (1/3 · 0.08)²) = √(0.0004 + 0.00071111) = 0.033333."""
    one, other = cell(1.0, 0.6), cell(1.0, 0.3)
    one["gradient_error"], other["gradient_error"] = 0.03, 0.08
    assert fused(one, other)["gradient_error"] == pytest.approx(0.033333, abs=1e-6)


def test_what_is_given_survives_whatever_is_measured() -> None:
    prior = Terrain().prior([np.nan], [0.0], [2], [1], stamp_ns=5)
    out = fused(prior, cell(3.0, 0.2, stamp_s=1))
    assert (out["height"], out["stamp"]) == (3.0, SECOND_NS)
    assert (out["gps_quality"], out["communications"]) == (3, 2)
    assert not out["flags"] & kernel.PRIOR
    later = Terrain().prior([np.nan], [0.0], [1], None, stamp_ns=9 * SECOND_NS)
    out = fused(out.reshape(1), later)
    assert (out["gps_quality"], out["communications"], out["stamp"]) == (2, 2, SECOND_NS)


# --- a standing robot ------------------------------------------------------------------------------------------------


def looks(own: Array, scans: list[Array], seconds: float = 0.1, model: Terrain = FAR_AWAY) -> list[Array]:
    """The cell after each look."""
    out = []
    for k, scan in enumerate(scans, start=1):
        own = merged(own, scan, k * seconds, model)
        out.append(own[0])
    return out


def test_a_repeated_look_settles() -> None:
    """200 looks with 2 cm of noise: confidence rises and stays below 255, the height stays within the noise's mean."""
    noise = np.random.default_rng(2).normal(0, 0.02, 200)
    states = looks(cell(10.0, 0.4), [cell(10.0 + z, 0.4) for z in noise])
    confidence = np.array([state["confidence"] for state in states])
    assert (np.diff(confidence) > -1e-3).all()
    assert confidence.max() * 255 < 255
    assert confidence[-1] > 0.99
    # The gain is 0.4/1.4 in the end, so the deviation 0.02 · √(0.286/1.714) = 0.0082.
    heights = np.array([state["height"] for state in states[20:]])
    assert heights.std() == pytest.approx(0.0082, rel=0.3)
    assert heights.mean() == pytest.approx(10.0, abs=0.004)
    exact = looks(cell(10.0, 0.4), [cell(10.1, 0.4)] * 60)
    assert exact[-1]["height"] == pytest.approx(10.1, abs=1e-6)


@given(
    confidences=st.tuples(*[st.floats(0.01, 1.0)] * 2),
    first=st.integers(0, 3),
    seconds=st.sampled_from([0.01, 0.1, 1.0]),
)
@hypothesis_settings(max_examples=200)
def test_two_looks_that_disagree_in_turn_settle(confidences: tuple[float, float], first: int, seconds: float) -> None:
    """Whatever they weigh: after the first six looks the cell shows one of them for good."""
    a, b = (cell(height, float(np.float32(c))) for height, c in zip((0.0, 1.0), confidences, strict=True))
    scans = [a] * first + [b, a] * 30
    heights = [float(state["height"]) for state in looks(a, scans, seconds)]
    assert len(set(heights[first + 6 :])) == 1


@given(
    order=st.lists(st.integers(1, 3), min_size=12, max_size=60),
    confidence=st.floats(0.5, 0.99),
    seconds=st.sampled_from([0.01, 0.1, 1.0]),
)
@hypothesis_settings(max_examples=100)
def test_a_held_surface_stays_while_no_two_looks_in_a_row_agree(
    order: list[int], confidence: float, seconds: float
) -> None:
    """Three others in whatever turn: the first was seen twice, and is at least as sure as any look for a minute."""
    turns = [k for k, before in zip(order, [0, *order], strict=False) if k != before]
    states = looks(cell(0.0, confidence), [cell(0.0, confidence)] + [cell(k, confidence) for k in turns], seconds)
    assert {float(state["height"]) for state in states} == {0.0}


def test_three_surfaces_in_turn_settle() -> None:
    """From the first look on, as rays do that end here or there on a wall: the second replaces one that was seen once,
    and is held."""
    scans = [cell(height, 0.7) for height in (0.0, 1.0, 2.0)] * 10
    heights = [float(state["height"]) for state in looks(scans[0], scans[1:])]
    assert set(heights) == {1.0}


@pytest.mark.parametrize("before", [1, 2, 30])
@pytest.mark.parametrize("confidence", [0.5, 0.7, 1.0])
def test_a_real_change_replaces_the_old_surface_at_the_second_sure_look(before: int, confidence: float) -> None:
    """However long the old one was looked at; and back again as soon."""
    street, car = (cell(height, confidence) for height in (0.0, 1.4))
    states = looks(street, [street] * (before - 1) + [car, car] + [car] * 5 + [street, street])
    heights = [float(state["height"]) for state in states]
    assert heights[before] == pytest.approx(1.4)
    assert heights[before + 5] == pytest.approx(1.4)
    assert heights[-1] == pytest.approx(0.0)


def test_unsure_looks_replace_an_old_surface_when_it_has_aged() -> None:
    """0.99 against 0.3: the gap closes to 2/16 when 0.99 is 0.425, and the surer is kept; below 0.3 it goes.

    That takes 600 s · log₂(0.99/0.3) = 1033 s.
    """
    street, car = cell(0.0, 0.99), cell(1.4, 0.3)
    assert merged(street, car, 1030)["height"] == 0.0
    assert merged(street, car, 1037)["height"] == pytest.approx(1.4)


def test_an_unsure_look_that_disagrees_changes_nothing() -> None:
    own = cell(0.0, 0.9)
    np.testing.assert_array_equal(merged(own, cell(5.0, 0.4), 1), own)


def test_a_late_scan_counts_as_the_older_one() -> None:
    """The world's change is not undone by a scan from before it; what agrees is taken in."""
    own = cell(1.4, 0.7, stamp_s=100)
    np.testing.assert_array_equal(merged(own, cell(0.0, 0.7), 50), own)
    agreeing = merged(own, cell(1.6, 0.7), 100)
    assert (agreeing["height"], agreeing["stamp"]) == (pytest.approx(1.5), 100 * SECOND_NS)


def test_a_look_that_contradicts_is_reported_and_leaves_the_surface_as_it_was_seen() -> None:
    """Only what it found instead and the revision change: nobody saw the street at 100 s."""
    street = cell(0.0, 0.9, stamp_s=2, more=int(kernel.HELD))
    expected = street.copy()
    expected["flags"] |= kernel.CONTRADICTED
    expected["rival"], expected["revision"] = 1.5, 2
    np.testing.assert_array_equal(merged(street, cell(1.5, 0.9), 100), expected)


def test_a_surface_is_no_newer_for_having_been_contradicted() -> None:
    """A saw the street at 0, 1 and 2 s and a car at 100 s; B saw the car twice at 99 s: it is there.

    A look hits 12 of 16 sub-cells. A's street has 1 - 0.25³ = 0.984, of which 97 s leave 0.88; B's car has
    1 - 0.25² = 0.94. Both are sure and less than 2/16 apart, so the newer one is the world's.
    """
    middles = np.array([(x, y, 0.0) for x in (0.125, 0.375, 0.625, 0.875) for y in (0.125, 0.375, 0.625)])
    seen = {"A": [(0, 0.0), (1, 0.0), (2, 0.0), (100, 1.5)], "B": [(99, 1.5), (99, 1.5)]}
    replica = Replica(LATTICE, FAR_AWAY)
    for robot, scans in seen.items():
        mapper = Mapper(robot, LATTICE, FAR_AWAY)
        for second, height in scans:
            mapper.integrate(scan_of(middles + np.array([0, 0, height]), second * SECOND_NS))
        replica.apply(mapper.delta())
    layers = mosaic(replica, chosen_layers(replica, None), (0, 0, 1, 1))
    assert layers["height"][0, 0] == pytest.approx(1.5)
    assert layers["stamp"][0, 0] == pytest.approx(99.0)


def test_a_scene_that_changes_under_a_standing_robot() -> None:
    """By scans: a street, on which a car parks that covers some cells and leaves again."""
    rng = np.random.default_rng(3)

    def scan(k: int, top_m: float) -> Scan:
        xy = rng.uniform(0, 4, (1500, 2))
        z = np.where((xy >= 1).all(axis=1) & (xy < 3).all(axis=1), top_m, 0.0) + rng.normal(0, 0.01, len(xy))
        return Scan(k * SECOND_NS // 10, np.column_stack([xy, z]), Pose.identity())

    scene = [0.0] * 20 + [1.4] * 3
    layers = layers_of(*(scan(k, top) for k, top in enumerate(scene)))
    car = np.zeros((4, 4), bool)
    car[1:3, 1:3] = True
    np.testing.assert_allclose(layers["height"], np.where(car, 1.4, 0.0), atol=0.02)
    layers = layers_of(*(scan(k, top) for k, top in enumerate([*scene, 0.0, 0.0])))
    np.testing.assert_allclose(layers["height"], 0.0, atol=0.02)


# --- coarsening ------------------------------------------------------------------------------------------------------


def test_four_cells_become_one() -> None:
    """Confidences 0.8, 0.4 and 0.1, one unknown: (0.8 · 1 + 0.4 · 2 + 0.1 · 6)/1.3 = 2.2/1.3; mean 1.3/4.

    The occupation is the worst of those with 2/16 or more: 0.5 of a slope of 0.15, not 1 of the unsure one.
    """
    cells = np.zeros((2, 2), kernel.CELL)
    cells[0, 0], cells[0, 1], cells[1, 0] = cell(1.0, 0.8)[0], cell(2.0, 0.4, (0.15, 0.0))[0], cell(6.0, 0.1, STEEP)[0]
    cells["occupation"][1, 0] = 1.0
    (out,) = FAR_AWAY.coarsen(cells, 2).reshape(-1)
    assert out["height"] == pytest.approx(2.2 / 1.3)
    assert out["gradient_x"] == pytest.approx((0.4 * 0.15 + 0.1 * STEEP[0]) / 1.3)
    assert out["confidence"] == pytest.approx(0.325)
    assert out["occupation"] == pytest.approx(0.5)


@pytest.mark.parametrize(("confidence", "worst"), [(0.124, 0.0), (0.126, 1.0)])
def test_two_sixteenths_are_sure_enough_for_a_coarse_occupation(confidence: float, worst: float) -> None:
    cells = np.zeros((2, 2), kernel.CELL)
    cells[0, 0], cells[0, 1] = cell(1.0, 0.8)[0], cell(1.0, confidence, (0.4, 0.0))[0]
    assert Terrain().coarsen(cells, 2)["occupation"][0, 0] == worst


def test_the_error_of_a_coarse_slope() -> None:
    """0.8 and 0.2 of errors 0.05 and 0.1: √((0.8 · 0.05)² + (0.2 · 0.1)²)/1 = √0.002 = 0.044721."""
    cells = np.zeros((2, 2), kernel.CELL)
    cells[0, 0], cells[0, 1] = cell(1.0, 0.8)[0], cell(1.0, 0.2)[0]
    cells["gradient_error"][0] = 0.05, 0.1
    assert Terrain().coarsen(cells, 2)["gradient_error"][0, 0] == pytest.approx(0.044721, abs=1e-6)


def test_a_coarse_cell_ages_its_cells_to_the_newest() -> None:
    """0.8 of 600 s ago counts as 0.4: (0.4 · 1 + 0.4 · 2)/0.8 = 1.5; mean of 0.4 and 0.4 over 4 cells: 0.2."""
    cells = np.zeros((2, 2), kernel.CELL)
    cells[0, 0], cells[1, 1] = cell(1.0, 0.8)[0], cell(2.0, 0.4, stamp_s=600)[0]
    (out,) = FAR_AWAY.coarsen(cells, 2).reshape(-1)
    assert (out["height"], out["confidence"]) == (pytest.approx(1.5), pytest.approx(0.2))


def test_a_wall_is_not_lost_where_robots_agree() -> None:
    """The mean slopes of two coarse cells are level; the worst of their fine cells was not."""
    level, wall = cell(1.0, 0.6, more=int(kernel.COARSE)), cell(1.0, 0.6, more=int(kernel.COARSE))
    wall["occupation"] = 1.0
    assert fused(level, wall)["occupation"] == fused(wall, level)["occupation"] == 1.0


@given(seed=st.integers(0, 10_000))
@hypothesis_settings(max_examples=40)
def test_coarsening_in_two_steps_is_coarsening_at_once(seed: int) -> None:
    """Where every known cell knows its gradients: all but the occupation, to float32's rounding.

    The occupation does not compose, as a coarse cell with few known ones is less sure: the threshold then may leave
    out what it let in before. Without a threshold it does.
    """
    rng = np.random.default_rng(seed)
    cells = np.concatenate(
        [cell(z, c, (x, y), t) for z, c, x, y, t in rng.uniform((0, 0.1, -1, -1, 0), (9, 1, 1, 1, 900), (64, 5))]
    ).reshape(8, 8)
    cells[rng.random((8, 8)) < 0.3] = np.zeros((), kernel.CELL)
    model = Terrain(coarse_confidence=0.0)
    twice, once = model.coarsen(model.coarsen(cells, 2), 4), model.coarsen(cells, 8)
    for name in once.dtype.names or ():
        np.testing.assert_allclose(twice[name], once[name], rtol=1e-5, atol=1e-6, err_msg=name)


def test_a_coarse_cell_promises_the_least_of_what_is_given() -> None:
    cells = Terrain().prior([np.nan] * 4, [0] * 4, [2, 1, np.nan, 2], [1, 1, 1, 0]).reshape(2, 2)
    out = Terrain().coarsen(cells, 2)
    assert (out["gps_quality"], out["communications"]) == (2, 1)  # stored as value + 1
    assert Terrain().known(out).all()


# --- layers, prior, settings -----------------------------------------------------------------------------------------


def test_layers_of_a_prior_map() -> None:
    model = Terrain()
    cells = model.prior([5.0, np.nan, np.nan], [0.2, 0.0, 0.0], [2, 1, np.nan], [1, np.nan, np.nan], SECOND_NS)
    read = {
        name: layer.compute(cells.reshape(1, -1), Reading(LATTICE, 10**13))[0] for name, layer in model.layers.items()
    }
    nan = np.nan
    np.testing.assert_array_equal(model.known(cells), [True, True, False])
    np.testing.assert_array_equal(read["height"], [5.0, nan, nan])
    np.testing.assert_array_equal(read["occupation"], [nan, nan, nan])
    np.testing.assert_allclose(read["confidence"], [51.0, 0.0, nan], rtol=1e-6)
    np.testing.assert_array_equal(read["gps_quality"], [2, 1, nan])
    np.testing.assert_array_equal(read["communications"], [1, nan, nan])
    np.testing.assert_array_equal(read["stamp"], [1.0, 1.0, nan])
    np.testing.assert_array_equal(cells["revision"], [1, 1, 0])
    assert not cells[2].tobytes().strip(b"\0")


def test_a_robot_that_is_surer_replaces_the_prior() -> None:
    """0.3 against 0.6, which disagree by 2 m; a robot's 0.1 does not."""
    prior = Terrain().prior([5.0], [0.3])
    assert fused(prior, cell(7.0, 0.6, stamp_s=1e6))["height"] == 7.0
    assert fused(prior, cell(7.0, 0.1, stamp_s=1e6))["height"] == 5.0


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (([np.inf], [0.1], None, None), "finite heights"),
        (([1.0], [1.1], None, None), "from 0 to 1"),
        (([1.0], [0.1], [3], None), "gps_quality"),
        (([1.0], [0.1], None, [0.5]), "communications"),
    ],
)
def test_a_prior_is_checked(values: tuple, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Terrain().prior(*values)


@pytest.mark.parametrize(
    "wrong",
    [{"subcells": 15}, {"subcells": 81}, {"subcells": -4}, {"max_slope": 0.0}, {"half_life_s": -1.0},
     {"confidence_gap": 2.0}, {"max_range_m": -1.0}, {"max_range_m": 0.0}, {"max_range_m": 2e8},
     {"min_range_m": 60.0, "max_range_m": 50.0}, {"point_sigma_m": 0.0}],
)  # fmt: skip
def test_settings_are_checked(wrong: dict[str, float]) -> None:
    with pytest.raises(
        InputError, match=next(iter(wrong)) if len(wrong) == 1 and "range" not in str(wrong) else "range"
    ):
        Terrain(**wrong)


# --- laws ------------------------------------------------------------------------------------------------------------


def some_cells(seed: int, count: int = 64) -> Array:
    """Cells of every kind: unknown, given, static only, with and without gradients, sure and not."""
    rng = np.random.default_rng(seed)
    out = np.zeros(count, kernel.CELL)
    out["stamp"], out["revision"] = rng.integers(0, 10**12, count), rng.integers(1, 9, count)
    out["height"], out["confidence"] = (
        rng.choice([0.0, 0.1, 5.0], count) + rng.normal(0, 0.05, count),
        rng.random(count),
    )
    known_x, known_y = rng.random((2, count)) < 0.8
    out["gradient_x"] = np.where(known_x, rng.normal(0, 0.1, count), 0)
    out["gradient_y"] = np.where(known_y, rng.normal(0, 0.1, count), 0)
    flags = kernel.HEIGHT | np.where(known_x, kernel.GRADIENT_X, 0) | np.where(known_y, kernel.GRADIENT_Y, 0)
    error = np.where(known_x | known_y, rng.choice([0.0, 0.02, 0.15], count), 0).astype(np.float32)
    out["gradient_error"] = error
    wall = rng.random(count) < 0.3
    for name in ("gradient_x", "gradient_y", "gradient_error"):
        out[name][wall] = 0
    flags = np.where(wall, kernel.HEIGHT | kernel.WALL, np.where(rng.random(count) < 0.5, flags | kernel.PLANE, flags))
    slopes = (out[name].astype(float) for name in ("gradient_x", "gradient_y", "gradient_error"))
    share, known = occupation_reference(*slopes, known_x & known_y & ~wall, wall, 0.3)
    out["occupation"] = share
    for flag in (kernel.PRIOR, kernel.HELD, kernel.CONTRADICTED):
        flags = flags | np.where(rng.random(count) < 0.2, flag, 0)
    out["flags"] = flags | np.where(known, kernel.OCCUPATION, 0)
    out["rival"] = np.where(flags & kernel.CONTRADICTED, rng.choice([0.1, 5.0], count), 0)
    out["flags"] |= np.where((flags & kernel.CONTRADICTED != 0) & (rng.random(count) < 0.5), kernel.RIVAL_WALL, 0)
    given = rng.random(count) < 0.3
    out["gps_quality"], out["communications"] = given * rng.integers(0, 4, count), given * rng.integers(0, 3, count)
    for name in ("height", "gradient_x", "gradient_y", "gradient_error", "occupation", "confidence", "rival"):
        out[name][:5] = 0
    out["flags"][:5], out["gps_quality"][:5] = kernel.PRIOR, 1
    out[rng.random(count) < 0.2] = np.zeros((), kernel.CELL)
    return out


@given(seeds=st.tuples(*[st.integers(0, 10_000)] * 2), stamps=st.sampled_from([1, 3, 10**12]))
@hypothesis_settings(max_examples=100)
def test_fuse_commutes(seeds: tuple[int, int], stamps: int) -> None:
    """Also where stamps are equal, and confidences, too."""
    a, b = (some_cells(seed) for seed in seeds)
    rng = np.random.default_rng(seeds)
    for cells in (a, b):
        cells["stamp"] %= stamps
        alike = (rng.random(len(cells)) < 0.5) & (cells["confidence"] > 0)
        cells["confidence"][alike] = 0.7
    assert FAR_AWAY.fuse(a, b, LATTICE).tobytes() == FAR_AWAY.fuse(b, a, LATTICE).tobytes()


@given(seed=st.integers(0, 10_000))
def test_unknown_is_neutral(seed: int) -> None:
    cells = some_cells(seed)
    nothing = np.zeros_like(cells)
    assert FAR_AWAY.fuse(cells, nothing, LATTICE).tobytes() == cells.tobytes()
    assert FAR_AWAY.fuse(nothing, cells, LATTICE).tobytes() == cells.tobytes()


def test_the_map_is_the_same_whatever_the_order_of_reports() -> None:
    """Three robots' deltas in every order, some twice."""
    rng = np.random.default_rng(4)
    deltas = []
    for k in range(3):
        mapper = Mapper(f"r{k}", LATTICE, FAR_AWAY)
        for n in range(3):
            points = rng.uniform(0, 4, (150, 3)) * (1, 1, 0.3) + (0, 0, k * 0.4)
            mapper.integrate(scan_of(points, (n * 3 + k) * 100 * SECOND_NS))
        deltas.append(mapper.delta())
    digests = set()
    for order in itertools.permutations(deltas):
        replica = Replica(LATTICE, FAR_AWAY)
        for delta in (*order, order[0]):
            replica.apply(delta)
        digests.add(replica.digest())
    assert len(digests) == 1


def test_a_record_has_no_gaps() -> None:
    assert kernel.CELL.itemsize == sum(kernel.CELL[name].itemsize for name in kernel.CELL.names) == 48


# --- walls -----------------------------------------------------------------------------------------------------------


def wall(height: float, confidence: float, stamp_s: float = 0.0) -> Array:
    """One cell (1,) of a wall up to this height."""
    out = cell(height, confidence, stamp_s=stamp_s)
    out["occupation"], out["flags"] = 1.0, kernel.HEIGHT | kernel.OCCUPATION | kernel.WALL
    return out


def plane(height: float, confidence: float, stamp_s: float = 0.0) -> Array:
    return cell(height, confidence, stamp_s=stamp_s, more=kernel.PLANE)


def loose(height: float, confidence: float) -> Array:
    """One cell (1,) whose points made no plane."""
    out = cell(height, confidence)
    out["occupation"], out["flags"] = 0.0, kernel.HEIGHT
    return out


@pytest.mark.parametrize(("top", "height", "occupation"), [(2.2, 2.2, 1.0), (2.0, 1.0, math.nan)])
def test_points_over_more_height_than_ground_has_are_a_wall(top: float, height: float, occupation: float) -> None:
    """Ground of slope 1.5 rises by 1.5 · √2 = 2.12 m from corner to corner of a cell of 1 m."""
    layers = layers_of(scan_of([(0.5, 0.5, 0.0), (0.5, 0.52, top)]))
    assert layers["height"][0, 0] == pytest.approx(height)
    np.testing.assert_equal(layers["occupation"][0, 0], occupation)
    assert np.isnan(layers["gradient_x"][0, 0])


def test_a_wall_says_nothing_of_the_slope_beside_it() -> None:
    """Level ground at x = 0.5 and 1.5, a wall at 2.5: one-sided from the west, not up the wall."""
    ground = [(0.5, 0.5, 0.0), (1.5, 0.5, 0.1)]
    layers = layers_of(scan_of([*ground, (2.5, 0.5, 0.0), (2.5, 0.5, 4.0)]))
    assert layers["gradient_x"][0, 1] == pytest.approx(0.1)


def test_walls_keep_the_higher_top() -> None:
    """Confidence as of any two that are alike: 1 - 0.8 · 0.5 = 0.6."""
    for own, new in ((3.0, 8.0), (8.0, 3.0)):
        after = merged(wall(own, 0.2), wall(new, 0.5), 0.0)
        assert after["height"] == 8.0
        assert after["confidence"] == pytest.approx(0.6)
        assert fused(wall(own, 0.2), wall(new, 0.5))["height"] == 8.0


@pytest.mark.parametrize(("met", "top"), [(1.0, 3.0), (5.0, 5.0)])
def test_a_ring_that_meets_a_wall_contradicts_nothing(met: float, top: float) -> None:
    for after in (merged(wall(3.0, 0.2), loose(met, 0.9), 1.0), merged(loose(met, 0.9), wall(3.0, 0.2), 1.0)):
        assert (after["height"], after["confidence"]) == (top, pytest.approx(0.2))
        assert after["flags"] & kernel.WALL
    assert fused(wall(3.0, 0.2), loose(met, 0.9)) == fused(loose(met, 0.9), wall(3.0, 0.2))


def test_a_roof_at_its_top_is_of_the_wall() -> None:
    """0.3 m apart is near enough: 3.2 is the higher of both."""
    after = merged(wall(3.0, 0.2), plane(3.2, 0.5), 1.0)
    assert (after["height"], after["occupation"]) == (3.2, 1.0)


def test_a_parked_car_appears_and_its_ground_comes_back() -> None:
    """A car's side fills few sub-cells: it takes two looks in a row, whatever they see of its top; two of the ground
    take it away again."""
    seen = merged(plane(0.0, 0.9), plane(0.0, 0.9), 1.0)
    once = merged(seen, wall(1.2, 0.2), 2.0)
    assert once["height"] == 0.0
    parked = merged(once, wall(1.5, 0.2), 3.0)
    assert (parked["height"], parked["occupation"]) == (1.5, 1.0)
    leaves = merged(parked, plane(0.0, 0.6), 4.0)
    gone = leaves if leaves["height"] == 0.0 else merged(leaves, plane(0.0, 0.6), 5.0)
    assert (gone["height"], gone["occupation"]) == (0.0, 0.0)


def test_what_was_only_given_raises_no_wall() -> None:
    """Somebody took the building for 10 m high: what is seen of it counts, as it is surer by more than 2/16."""
    given = cell(10.0, 0.1)
    given["flags"] = kernel.HEIGHT | kernel.PRIOR
    assert fused(given, wall(4.0, 0.5))["height"] == 4.0
    assert fused(wall(4.0, 0.5), given)["height"] == 4.0


def test_a_plane_beside_its_points_is_none() -> None:
    """Three points in a corner, 0.05 m apart, of 1 cm each: at the centre, 0.6 m away, a plane through them is off by
    more than 0.1 m, so the cell has their mean, 0.1."""
    corner = [(0.05, 0.05, 0.1), (0.12, 0.05, 0.1), (0.05, 0.12, 0.1)]
    layers = layers_of(scan_of(corner))
    assert layers["height"][0, 0] == pytest.approx(0.1)
    assert np.isnan(layers["gradient_x"][0, 0])
    assert layers_of(scan_of(corner), model=replace(FAR_AWAY, point_sigma_m=1e-5))["gradient_x"][0, 0] == pytest.approx(
        0
    )
