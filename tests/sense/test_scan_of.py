"""Raw readings → points, misses, origins. Expected numbers are worked out by hand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from terrafuse.errors import InputError
from terrafuse.sense import Beams, Mounting, Ring, Sensor, load_sensor, scan_of
from terrafuse.types import Pose

HERE = Pose.identity()
FOUR = Ring(count=4, first_rad=0.0, step_rad=math.pi / 2, radius_m=0.5)
NAN, INF = float("nan"), float("inf")


def sensor(**changes: Any) -> Sensor:
    return Sensor(**{"name": "four", "max_range_m": 10.0, "beams": FOUR, "no_return": "clear"} | changes)


def test_a_ring_looks_outward_from_its_circle() -> None:
    """Ahead, left, back, right; each starts 0.5 m out: 0.5 + 1 ahead, 0.5 + 2 left, …"""
    scan = scan_of(sensor(), [1, 2, 3, 4], 7, HERE)
    assert scan.stamp_ns == 7
    assert np.allclose(scan.points, [[1.5, 0, 0], [0, 2.5, 0], [-3.5, 0, 0], [0, -4.5, 0]])
    assert np.allclose(scan.origins, [[0.5, 0, 0], [0, 0.5, 0], [-0.5, 0, 0], [0, -0.5, 0]])
    assert scan.misses.shape == (0, 3)
    assert scan.dropped == {}


def test_a_ring_that_counts_clockwise() -> None:
    """From ahead over the right: the second beam looks to -y."""
    clockwise = Ring(count=4, first_rad=0.0, step_rad=math.pi / 2, clockwise=True)
    scan = scan_of(sensor(beams=clockwise), [1, 2, 3, 4], 0, HERE)
    assert np.allclose(scan.points, [[1, 0, 0], [0, -2, 0], [-3, 0, 0], [0, 4, 0]])
    assert scan.origins is None  # all at the sensor's own


def test_the_nomads_third_sonar() -> None:
    """Two steps of 22.5° are 45°: 0.225 + 1.0 = 1.225 m from the centre, 1.225/√2 = 0.866206 each way."""
    ranges = np.full(16, 1.0)
    scan = scan_of(load_sensor("nomad_200_sonar"), ranges, 0, HERE)
    assert scan.points[2] == pytest.approx([0.866206, 0.866206, 0], abs=1e-6)
    assert scan.origins[2] == pytest.approx([0.159099, 0.159099, 0], abs=1e-6)  # 0.225/√2
    assert scan.points[1] == pytest.approx([1.131752, 0.468787, 0], abs=1e-6)  # 1.225·cos, sin 22.5°
    assert (scan.beam.half_angle_rad, scan.beam.max_range_m) == (pytest.approx(math.radians(12.5)), 50 * 0.0254)


def test_the_soccer_robots_sonars_go_round_anticlockwise() -> None:
    """Eq. 15: sonar v looks to 22.5°·v; the paper measures from the robot's centre."""
    scan = scan_of(load_sensor("soccer_robot_sonar"), np.full(16, 2.0), 0, HERE)
    assert scan.points[4] == pytest.approx([0, 2, 0], abs=1e-12)
    assert scan.points[15] == pytest.approx([1.847759, -0.765367, 0], abs=1e-6)  # 2·cos, -2·sin 22.5°
    assert scan.origins is None


def test_elevations_follow_each_azimuth() -> None:
    """Two azimuths, 0° and 90°, each at 30° and -30°: cos 30° = 0.866025, sin 30° = 0.5; 2 m and 4 m."""
    spinning = Ring(2, 0.0, math.pi / 2, elevations_rad=(math.radians(30), math.radians(-30)))
    scan = scan_of(sensor(beams=spinning), [2, 4, 2, 4], 0, HERE)
    expected = [[1.732051, 0, 1], [3.464102, 0, -2], [0, 1.732051, 1], [0, 3.464102, -2]]
    assert np.allclose(scan.points, expected, atol=1e-6)


def test_beams_of_their_own_angles() -> None:
    listed = Beams((math.radians(90), 0.0), (0.0, math.radians(60)), radius_m=1.0)
    scan = scan_of(sensor(beams=listed), [2, 2], 0, HERE)
    assert np.allclose(scan.points, [[0, 3, 0], [2, 0, 1.7320508]])  # 1 + 2·cos 60° = 2, 2·sin 60° = √3


def test_where_the_beams_start_can_be_moved() -> None:
    scan = scan_of(sensor(origin_m=(1.0, 2.0, 3.0)), [1, 1, 1, 12], 0, HERE)
    assert np.allclose(scan.points[0], [2.5, 2, 3])
    assert np.allclose(scan.misses, [[1, 2 - 0.5 - 10, 3]])
    assert np.allclose(scan.origins[-1], [1, 1.5, 3])


@given(
    st.lists(st.floats(0.01, 9.99), min_size=6, max_size=6),
    st.floats(0, 2),
    st.floats(-6, 6),
    st.booleans(),
    st.floats(-1.5, 1.5),
)
def test_the_reading_is_how_far_the_point_lies_from_its_origin(
    ranges: list[float], radius_m: float, first: float, clockwise: bool, elevation: float
) -> None:
    ring = Ring(6, first, 1.0, clockwise, radius_m, (elevation,))
    scan = scan_of(sensor(beams=ring), ranges, 0, HERE)
    starts = np.zeros((6, 3)) if scan.origins is None else scan.origins
    assert np.allclose(np.linalg.norm(scan.points - starts, axis=1), ranges)


# --- limits and silence ---


@pytest.mark.parametrize(
    ("reading", "becomes"),
    [
        (0.5, "point"),  # the nearer limit belongs to the range
        (0.4999, "nearer than the sensor's min_range_m"),
        (0.0, "nearer than the sensor's min_range_m"),
        (-1.0, "nearer than the sensor's min_range_m"),
        (-INF, "nearer than the sensor's min_range_m"),
        (9.9999, "point"),
        (10.0, "miss"),  # the further one does not
        (11.0, "miss"),
        (INF, "miss"),
        (NAN, "not finite"),
        (5.11, "miss"),  # a code that says clear
        (7.0, "no return"),  # a code that says nothing
        (7.0004, "no return"),
        (7.0006, "point"),
        (81.83, "no return"),  # a code beyond the limit
    ],
)
def test_what_a_reading_becomes(reading: float, becomes: str) -> None:
    described = sensor(min_range_m=0.5, sentinels_m=((5.11, "clear"), (7.0, "ignore"), (81.83, "ignore")))
    scan = scan_of(described, [1, 1, 1, reading], 0, HERE)
    assert len(scan.points) == (4 if becomes == "point" else 3)
    assert len(scan.misses) == (becomes == "miss")
    assert scan.dropped == ({} if becomes in ("point", "miss") else {becomes: 1})
    assert len(scan.origins) == len(scan.points) + len(scan.misses)


def test_a_miss_ends_at_the_maximum_range() -> None:
    scan = scan_of(sensor(), [1, 1, 1, 12], 0, HERE)
    assert np.allclose(scan.misses, [[0, -10.5, 0]])
    assert np.allclose(scan.origins[3], [0, -0.5, 0])


def test_silence_that_says_nothing_is_counted() -> None:
    scan = scan_of(sensor(no_return="ignore"), [1, INF, 10, 30], 0, HERE)
    assert (len(scan.points), len(scan.misses), scan.dropped) == (1, 0, {"no return": 3})


def test_zero_is_no_distance_even_without_a_lower_limit() -> None:
    assert scan_of(sensor(), [0, 1, 1, 1], 0, HERE).dropped == {"nearer than the sensor's min_range_m": 1}


@given(st.lists(st.one_of(st.floats(), st.sampled_from([0.0, 5.0, 10.0, 81.83])), min_size=4, max_size=4))
def test_every_reading_is_a_point_a_miss_or_counted(ranges: list[float]) -> None:
    for silence in ("clear", "ignore"):
        scan = scan_of(sensor(no_return=silence, sentinels_m=((5.0, "ignore"),)), ranges, 0, HERE)
        assert len(scan.points) + len(scan.misses) + sum(scan.dropped.values()) == 4
        assert np.isfinite(scan.points).all()


@pytest.mark.parametrize("ranges", [[], [1, 2, 3], [1] * 5, [[1, 2, 3, 4]], 1.0])
def test_another_number_of_readings(ranges: Any) -> None:
    with pytest.raises(InputError, match=r"sensor four: readings of shape .* for 4 beams; give 4 numbers"):
        scan_of(sensor(), ranges, 0, HERE)


def test_a_sensor_without_beams_has_no_readings() -> None:
    with pytest.raises(InputError, match="four describes no beams"):
        scan_of(sensor(beams=None), [1.0], 0, HERE)


# --- mounting ---


def test_a_mounting_by_octomaps_numbers() -> None:
    """octomap's own test: (1, .1, .1), roll 0, pitch .1, yaw π/4 takes (1, .1, .1) to these."""
    mounting = Mounting(1, 0.1, 0.1, 0.0, 0.1, math.pi / 4)
    point = mounting.T_base_sensor.matrix @ [1, 0.1, 0.1, 1]
    assert point[:3] == pytest.approx([1.6399229, 0.8813442, 0.099667005], abs=1e-7)


def test_rolled_pitched_turned_in_this_order() -> None:
    """Quarter turns. Roll: y → z. Then pitch: z → x. Then yaw: x → y. So y ends as y, and x → x → -z → -z."""
    quarter = math.pi / 2
    rotation = Mounting(roll_rad=quarter, pitch_rad=quarter, yaw_rad=quarter).T_base_sensor.matrix[:3, :3]
    assert np.allclose(rotation @ [0, 1, 0], [0, 1, 0])
    assert np.allclose(rotation @ [1, 0, 0], [0, 0, -1])
    assert np.allclose(rotation @ [0, 0, 1], [1, 0, 0])  # roll: z → -y; pitch: -y; yaw: -y → x


def test_a_sensor_mounted_sideways_on_a_robot_that_is_somewhere() -> None:
    """The robot stands at (10, 20, 0) and looks north: its x is the world's y. The sensor sits 1 m ahead and 2 m up,
    turned left by 90°: its x is the robot's y, the world's -x. A reading of 3 m ahead from a ring of 0.5 m:
    (10, 20, 0) + ahead 1 → (10, 21, 2), then 3.5 m to the west → (6.5, 21, 2)."""
    T_world_base = Pose.from_quaternion((10, 20, 0), (0, 0, math.sin(math.pi / 4), math.cos(math.pi / 4)))
    sideways = sensor(mounting=Mounting(x_m=1, z_m=2, yaw_rad=math.pi / 2))
    scan = scan_of(sideways, [3, 1, 1, 1], 0, T_world_base)
    assert np.allclose(scan.T_world_sensor.position, [10, 21, 2])
    world = scan.T_world_sensor.matrix @ [*scan.points[0], 1]
    assert np.allclose(world[:3], [6.5, 21, 2])
