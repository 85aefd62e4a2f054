"""The analytic world: what its lidar sees lies on what is there, and its truth is what is there."""

from __future__ import annotations

import math
import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from terrafuse.lattice import Lattice
from terrafuse.testing.analytic.boxes import Box, Car, Pit
from terrafuse.testing.analytic.ground import Ground, Hill, ground_ranges
from terrafuse.testing.analytic.scene import Lidar, Scene, at_time, box_on, covered, first_returns, scan, truth
from terrafuse.testing.analytic.world import LIDAR, ROUNDS, SCENE, T_BASE_SENSOR, pose_on
from terrafuse.types import Array, Floats, Pose, checked_pose

LATTICE = Lattice(0.5, 20.0)
WINDOW = (-40, -40, 40, 40)
MM = 1e-3
EXACT = Lidar(beams=24, columns=90, lowest_deg=-40.0, highest_deg=10.0, max_range_m=60.0, noise_m=0.0)

share = st.floats(-1.0, 1.0)


@st.composite
def grounds(draw: st.DrawFn) -> Ground:
    hills = draw(st.lists(st.tuples(share, share, share, st.floats(6.0, 20.0)), max_size=3))
    return Ground(
        level_m=100 * draw(share),
        slope_east=0.1 * draw(share),
        slope_north=0.1 * draw(share),
        wave_m=0.4 * draw(share),
        wave_length_m=draw(st.floats(15.0, 60.0)),
        hills=tuple(Hill(20 * x, 20 * y, 3 * height, radius) for x, y, height, radius in hills),
    )


@st.composite
def scenes(draw: st.DrawFn) -> Scene:
    """Ground with up to four boxes that stand 3 m or more from the origin."""
    ground = draw(grounds())
    boxes = []
    for far, angle, length, width, height in draw(
        st.lists(
            st.tuples(st.floats(7, 20), st.floats(0, 6.28), st.floats(0.5, 5), st.floats(0.5, 5), st.floats(0.3, 5)),
            max_size=4,
        )
    ):
        x, y = far * math.cos(angle), far * math.sin(angle)
        boxes.append(box_on(ground, x, y, length, width, height, yaw_rad=angle / 2))
    return Scene(ground, tuple(boxes))


def sensor(ground: Ground, heading_rad: float = 0.3) -> Pose:
    """T_world_sensor 1.8 m above the origin's ground."""
    return pose_on(ground, 0.0, 0.0, heading_rad) @ T_BASE_SENSOR


def in_world(points: Array, T_world_sensor: Pose) -> Floats:
    seen = points[np.isfinite(points[:, 0])].astype(np.float64)
    return seen @ T_world_sensor.matrix[:3, :3].T + T_world_sensor.position


def above_ground(ground: Ground, at: Floats) -> Floats:
    return np.asarray(at[..., 2] - ground.height(at[..., 0], at[..., 1]))


def outside(box: Box, at: Floats) -> Floats:
    """How far points (…, 3) are from the box along the axis where they are furthest out; negative inside."""
    c, s = math.cos(box.yaw_rad), math.sin(box.yaw_rad)
    east, north = at[..., 0] - box.x_m, at[..., 1] - box.y_m
    along, across = abs(c * east + s * north) - box.length_m / 2, abs(c * north - s * east) - box.width_m / 2
    return np.asarray(np.maximum(np.maximum(along, across), at[..., 2] - box.top_m))


def free(scene: Scene, at: Floats) -> Floats:
    """How far from the nearest surface points are, roughly; 0 on one, negative inside a solid."""
    return np.minimum.reduce([above_ground(scene.ground, at), *(outside(box, at) for box in scene.boxes)])


# --- ground ----------------------------------------------------------------------------------------------------------


@given(ground=grounds(), x=st.floats(-40, 40), y=st.floats(-40, 40))
@settings(max_examples=100)
def test_the_gradient_is_the_height_s_derivative(ground: Ground, x: float, y: float) -> None:
    step = 1e-4
    east, north = ground.gradient(x, y)
    assert east == pytest.approx((ground.height(x + step, y) - ground.height(x - step, y)) / (2 * step), abs=1e-5)
    assert north == pytest.approx((ground.height(x, y + step) - ground.height(x, y - step)) / (2 * step), abs=1e-5)


@given(ground=grounds(), x=st.floats(-40, 40), y=st.floats(-40, 40), angle=st.floats(0, 6.28))
@settings(max_examples=200)
def test_no_curvature_is_over_the_bound(ground: Ground, x: float, y: float, angle: float) -> None:
    step = 1e-2
    dx, dy = step * math.cos(angle), step * math.sin(angle)
    bend = ground.height(x + dx, y + dy) + ground.height(x - dx, y - dy) - 2 * ground.height(x, y)
    assert abs(float(bend)) / step**2 <= ground.curvature + 1e-6


@given(ground=grounds(), heading=st.floats(0, 6.28))
@settings(max_examples=15)
def test_rays_end_on_the_ground_where_a_plain_search_finds_it(ground: Ground, heading: float) -> None:
    """Steps of 2 cm along each ray, then halving: a crest that this misses, too, is a hair's breadth."""
    T_world_sensor = sensor(ground, heading)
    directions = EXACT.directions[::23] @ T_world_sensor.matrix[:3, :3].T
    reach_m = 50.0
    ranges = ground_ranges(ground, T_world_sensor.position, directions, reach_m)
    along = np.arange(0.0, reach_m, 0.02)
    for direction, found in zip(directions, ranges, strict=True):
        below = above_ground(ground, T_world_sensor.position + along[:, None] * direction) < 0
        if not below.any():
            assert found > reach_m - 0.1 or grazes(ground, T_world_sensor.position + found * direction)
            continue
        high = along[below.argmax()]
        low = high - 0.02
        for _ in range(20):
            middle = 0.5 * (low + high)
            under = above_ground(ground, T_world_sensor.position + middle * direction) < 0
            low, high = (low, middle) if under else (middle, high)
        assert found == pytest.approx(high, abs=MM) or grazes(ground, T_world_sensor.position + found * direction)


def grazes(ground: Ground, at: Floats) -> bool:
    """A ray that touches the ground and leaves it again between two steps of the plain search."""
    return abs(float(above_ground(ground, at))) < 1e-5


def test_level_and_sloping_ground_is_met_exactly() -> None:
    down = np.array([[0.0, 0.0, -1.0], [0.6, 0.0, -0.8], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    level = ground_ranges(Ground(1.0), np.array([0.0, 0.0, 5.0]), down, 100.0)
    np.testing.assert_allclose(level, [4.0, 5.0, np.inf, np.inf])
    # Up the slope z = x/2 the level ray meets it at x = 10.
    slope = ground_ranges(Ground(slope_east=0.5), np.array([0.0, 0.0, 5.0]), down, 100.0)
    np.testing.assert_allclose(slope, [5.0, 50 / 11, np.inf, 10.0], rtol=1e-9)


def test_a_hill_hides_what_is_behind_it() -> None:
    ground = Ground(hills=(Hill(20.0, 0.0, 3.0, 4.0),))
    rays = np.array([[math.cos(a), 0.0, math.sin(a)] for a in np.radians(np.linspace(-8.0, 6.0, 200))])
    ranges = ground_ranges(ground, np.array([0.0, 0.0, 1.8]), rays, 80.0)
    x = ranges * rays[:, 0]
    hit = np.isfinite(ranges)
    assert not ((x[hit] > 20.0) & (x[hit] < 60.0)).any()  # its shadow reaches past 80 m but for rays over the top
    assert ((x[hit] > 12.0) & (x[hit] < 20.0)).sum() > 50


# --- scans -----------------------------------------------------------------------------------------------------------


@given(scene=scenes(), heading=st.floats(0, 6.28))
@settings(max_examples=40)
def test_points_lie_on_a_surface_and_nothing_is_in_front_of_them(scene: Scene, heading: float) -> None:
    T_world_sensor = sensor(scene.ground, heading)
    points = scan(scene, EXACT, T_world_sensor, 0.0, np.random.default_rng(0))
    assert points.dtype == np.float32
    assert points.shape == (EXACT.beams * EXACT.columns, 3)
    hits = in_world(points, T_world_sensor)
    assert len(hits) > 500
    assert np.abs(free(scene, hits)).max() < MM
    for part in np.linspace(0.02, 0.995, 60):
        way = T_world_sensor.position + part * (hits - T_world_sensor.position)
        assert free(scene, way).min() > -MM


@given(scene=scenes())
@settings(max_examples=20)
def test_rays_without_a_return_meet_nothing(scene: Scene) -> None:
    T_world_sensor = sensor(scene.ground)
    points = scan(scene, EXACT, T_world_sensor, 0.0, np.random.default_rng(0))
    gone = np.isnan(points[:, 0])
    assert np.isnan(points[gone]).all()
    directions = EXACT.directions[gone] @ T_world_sensor.matrix[:3, :3].T
    for range_m in np.linspace(EXACT.min_range_m, EXACT.max_range_m, 100):
        assert free(scene, T_world_sensor.position + range_m * directions).min(initial=1.0) > -MM


def test_the_range_gate() -> None:
    lidar = replace(EXACT, lowest_deg=-60.0, min_range_m=3.0, max_range_m=12.0)
    points = scan(SCENE, lidar, sensor(SCENE.ground), 0.0, np.random.default_rng(0))
    ranges = np.linalg.norm(points[np.isfinite(points[:, 0])].astype(np.float64), axis=1)
    assert (ranges.min(), ranges.max()) == pytest.approx((3.0, 12.0), abs=0.3)
    assert ranges.min() >= 3.0 - MM
    assert ranges.max() <= 12.0 + MM


def test_noise_is_along_the_ray_and_of_the_given_size() -> None:
    T_world_sensor = sensor(SCENE.ground)
    rng = np.random.default_rng(4)
    exact = scan(SCENE, replace(LIDAR, noise_m=0.0), T_world_sensor, 0.0, rng).astype(np.float64)
    noisy = scan(SCENE, replace(LIDAR, noise_m=0.03), T_world_sensor, 0.0, rng).astype(np.float64)
    np.testing.assert_array_equal(np.isnan(exact), np.isnan(noisy))
    off = noisy - exact
    along = np.nansum(off * LIDAR.directions, axis=1)[np.isfinite(exact[:, 0])]
    assert along.std() == pytest.approx(0.03, rel=0.03)
    assert abs(along.mean()) < 0.001
    assert np.nanmax(np.abs(np.cross(off, LIDAR.directions))) < 1e-5


def test_the_seed_decides_the_scan() -> None:
    T_world_sensor = sensor(SCENE.ground)

    def seeded(seed: int) -> bytes:
        return scan(SCENE, LIDAR, T_world_sensor, 8.0, np.random.default_rng(seed)).tobytes()

    assert seeded(1) == seeded(1)
    assert seeded(1) != seeded(2)


def test_orders_are_two_orders_of_the_same_points() -> None:
    T_world_sensor = sensor(SCENE.ground)
    firing, ring = (
        scan(SCENE, replace(EXACT, order=order), T_world_sensor, 8.0, np.random.default_rng(0))
        for order in ("firing", "ring")
    )
    by_firing = firing.reshape(EXACT.columns, EXACT.beams, 3)
    by_ring = ring.reshape(EXACT.beams, EXACT.columns, 3)
    np.testing.assert_array_equal(by_firing, by_ring.swapaxes(0, 1))
    # A firing's beams are lowest first, a ring's firings go round from straight ahead to the left.
    elevation, azimuth = EXACT.directions[:, 2], np.arctan2(EXACT.directions[:, 1], EXACT.directions[:, 0])
    assert (np.diff(elevation.reshape(EXACT.columns, EXACT.beams)) > 0).all()
    assert azimuth[:: EXACT.beams][:3] == pytest.approx(2 * math.pi / EXACT.columns * np.arange(3))


def test_a_scan_of_120_000_points_takes_less_than_a_second() -> None:
    lidar = Lidar(beams=64, columns=1875, lowest_deg=-25.0, highest_deg=3.0)
    T_world_sensor = sensor(SCENE.ground)
    rng = np.random.default_rng(0)
    started = time.process_time()
    assert len(scan(SCENE, lidar, T_world_sensor, 8.0, rng)) == 120_000
    assert time.process_time() - started < 1.0


# --- what moves ------------------------------------------------------------------------------------------------------


def test_a_car_comes_parks_and_goes() -> None:
    car = Car((-10.0, 0.0), (10.0, 0.0), enters_s=5.0, speed_m_s=2.0, parks_s=(8.0, 20.0))
    places = {t: car.place(t) for t in (4.9, 5.0, 7.0, 8.0, 15.0, 20.0, 22.0, 27.0, 27.1)}
    assert places[4.9] is None
    assert places[27.1] is None
    x = {t: place[0] for t, place in places.items() if place is not None}
    assert x == pytest.approx({5.0: -10.0, 7.0: -6.0, 8.0: -4.0, 15.0: -4.0, 20.0: -4.0, 22.0: 0.0, 27.0: 10.0})


def test_a_car_s_heading_is_its_way() -> None:
    place = Car((0.0, 0.0), (3.0, 4.0), enters_s=0.0, speed_m_s=2.5).place(1.0)
    assert place == pytest.approx((1.5, 2.0, math.atan2(4.0, 3.0)))


def test_rays_pass_under_a_car_with_clearance() -> None:
    car = Car((-10.0, 0.0), (10.0, 0.0), enters_s=0.0, speed_m_s=1.0, clearance_m=0.3)
    scene = Scene(Ground(), cars=(car,))
    rays = np.array([[0.0, 1.0, 0.0], [0.0, 1.0, -0.01]])
    origin = np.array([0.0, -3.0, 0.2])
    assert first_returns(scene, origin, rays, 50.0, 10.0) == pytest.approx([np.inf, 20.0], rel=1e-3)
    origin[2] = 0.5
    assert first_returns(scene, origin, rays, 50.0, 10.0) == pytest.approx([2.1, 2.1], rel=1e-3)
    assert first_returns(scene, origin, rays[:1], 50.0, 30.0) == pytest.approx([np.inf])


def test_a_pit_is_seen_while_it_is_open() -> None:
    pit = Pit(Box(5.0, 0.0, 4.0, 4.0, top_m=-1.0), opens_s=10.0, closes_s=20.0)
    scene = Scene(Ground(), pits=(pit,))
    origin = np.array([0.0, 0.0, 2.0])
    # Down to the floor at x = 4.5, to the far wall at x = 7 half a metre down, and past it.
    rays = np.array([[4.5, 0.0, -3.0], [7.0, 0.0, -2.5], [8.0, 0.0, -2.0]])
    lengths = np.linalg.norm(rays, axis=1)
    rays /= lengths[:, None]
    assert first_returns(scene, origin, rays, 50.0, 15.0) == pytest.approx(lengths)
    closed = first_returns(scene, origin, rays, 50.0, 20.0)
    assert closed * -rays[:, 2] == pytest.approx([2.0, 2.0, 2.0])


# --- truth -----------------------------------------------------------------------------------------------------------


@given(scene=scenes())
@settings(max_examples=30)
def test_the_truth_is_the_ground_and_the_tops(scene: Scene) -> None:
    z = truth(scene, LATTICE, WINDOW)
    x = LATTICE.cell_centre(np.arange(-40, 40))
    for j, i in np.random.default_rng(0).integers(0, 80, (60, 2)):
        tops = [box.top_m for box in scene.boxes if outside(box, np.array([x[i], x[j], -1e6])) <= 0]
        assert z[j, i] == max([float(scene.ground.height(x[i], x[j])), *tops])


def test_the_truth_knows_the_time() -> None:
    ground = Ground(1.0)
    car = Car((-15.0, 0.0), (15.0, 0.0), enters_s=0.0, speed_m_s=1.5, length_m=4.0, width_m=2.0)
    scene = Scene(ground, cars=(car,), pits=(Pit(Box(0.0, 10.0, 4.0, 2.0, top_m=0.0), 5.0, 15.0),))
    for time_s, highest, lowest in ((None, 1.0, 1.0), (2.0, 2.5, 1.0), (10.0, 2.5, 0.0), (30.0, 1.0, 1.0)):
        z = truth(scene, LATTICE, WINDOW, time_s)
        assert (z.max(), z.min()) == (highest, lowest)
    z = truth(scene, LATTICE, WINDOW, 10.0)
    assert (z == 2.5).sum() == (z == 0.0).sum() == 4 * 2 / 0.5**2
    np.testing.assert_array_equal(covered(scene, LATTICE, WINDOW, time_s=10.0), z != 1.0)


def test_cells_on_walls_are_the_ones_between_grown_and_shrunk() -> None:
    scene = Scene(Ground(), (Box(0.1, 0.1, 6.0, 4.0, top_m=2.0, yaw_rad=0.5),))
    half = LATTICE.resolution_m * math.sqrt(0.5)
    on_wall = covered(scene, LATTICE, WINDOW, half) & ~covered(scene, LATTICE, WINDOW, -half)
    fine = Lattice(0.05, 20.0)
    tops = truth(scene, fine, tuple(10 * index for index in WINDOW)).reshape(80, 10, 80, 10)
    mixed = tops.max(axis=(1, 3)) != tops.min(axis=(1, 3))
    assert mixed.sum() > 30
    assert (on_wall | ~mixed).all()


def test_what_a_scan_sees_of_the_world_is_its_truth() -> None:
    """Points well within a cell's side of a wall have the truth's height at their cell's centre, but for the slope."""
    time_s, lattice = 10.0, Lattice(0.1)
    T_world_sensor = pose_on(SCENE.ground, *ROUNDS["r1"].place(time_s)) @ T_BASE_SENSOR
    hits = in_world(scan(SCENE, LIDAR, T_world_sensor, time_s, np.random.default_rng(0)), T_world_sensor)
    window = (-600, -600, 600, 600)
    i, j = lattice.cell(hits[:, 0]) + 600, lattice.cell(hits[:, 1]) + 600
    clear = ~covered(SCENE, lattice, window, 0.2, time_s)[j, i]
    error = hits[:, 2] - truth(SCENE, lattice, window, time_s)[j, i]
    assert clear.sum() > 10_000
    assert np.abs(error[clear]).max() < 0.1 * math.sqrt(0.5) * 0.4 + 0.1
    assert np.sqrt(np.mean(error[clear] ** 2)) < 0.01


# --- the drive -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ROUNDS)
def test_a_round_stays_clear_of_boxes_and_of_the_car(name: str) -> None:
    for time_s in np.arange(0.0, 60.0, 0.1):
        x, y, _ = ROUNDS[name].place(time_s)
        for box in at_time(SCENE, time_s).boxes:
            assert not box.covers(np.array(x), np.array(y), grown_m=1.0)


@pytest.mark.parametrize("name", ROUNDS)
def test_a_base_faces_its_way_and_stands_upright_on_the_slope(name: str) -> None:
    step = 1e-4
    for time_s in np.arange(0.0, 30.0, 1.7):
        here, next_ = (pose_on(SCENE.ground, *ROUNDS[name].place(t)) for t in (time_s, time_s + step))
        checked_pose(here.matrix)
        way = (next_.position - here.position) / np.linalg.norm(next_.position - here.position)
        assert here.matrix[:3, 0] == pytest.approx(way, abs=1e-3)
        east, north = SCENE.ground.gradient(*here.position[:2])
        assert here.matrix[:3, 2] @ [1, 0, east] == pytest.approx(0.0, abs=1e-12)
        assert here.matrix[:3, 2] @ [0, 1, north] == pytest.approx(0.0, abs=1e-12)
        assert above_ground(SCENE.ground, here.position) == pytest.approx(0.0, abs=1e-12)
