"""Scans that readers made, as a description has them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from terrafuse.sense import Mounting, Ring, Sensor, applied, scan_of, undescribed
from terrafuse.types import NoReturns, Pose, Scan

HERE = Pose.identity()
NAN, INF = float("nan"), float("inf")


def sensor(**changes: Any) -> Sensor:
    return Sensor(**{"name": "s", "max_range_m": 10.0} | changes)


def scan(points: Any, T_world_sensor: Pose = HERE, **more: Any) -> Scan:
    return Scan(5, np.array(points, np.float64).reshape(-1, 3), T_world_sensor, **more)


def test_points_within_the_limits_stay_in_every_bit() -> None:
    points = np.random.default_rng(0).uniform(-5, 5, (100, 3)).astype(np.float32)
    out = applied(sensor(reliability=0.5), Scan(5, points, HERE))
    assert np.shares_memory(out.points, points)
    assert len(out.points) == 100
    assert out.stamp_ns == 5
    assert (len(out.misses), out.origins, dict(out.dropped)) == (0, None, {})
    assert (out.beam.max_range_m, out.beam.reliability) == (10.0, 0.5)


def test_a_point_beyond_becomes_a_miss_that_ends_at_the_limit() -> None:
    """(6, 0, 8) is 10 m away: at the limit. (0, 12, 16) is 20 m: cut to half, (0, 6, 8)."""
    out = applied(sensor(no_return="clear"), scan([[1, 2, 2], [6, 0, 8], [0, 12, 16]]))
    assert np.allclose(out.points, [[1, 2, 2]])
    assert np.allclose(out.misses, [[6, 0, 8], [0, 6, 8]])
    assert out.dropped == {}


def test_a_point_beyond_is_dropped_where_silence_says_nothing() -> None:
    out = applied(sensor(min_range_m=2.0), scan([[1, 0, 0], [3, 0, 0], [0, 12, 16]]))
    assert np.allclose(out.points, [[3, 0, 0]])
    assert len(out.misses) == 0
    assert out.dropped == {"nearer than the sensor's min_range_m": 1, "no return": 1}


def test_points_that_are_not_finite_are_counted() -> None:
    out = applied(sensor(no_return="clear"), scan([[NAN, 0, 0], [INF, 0, 0], [1, 0, 0], [0, 0, -INF]]))
    assert np.allclose(out.points, [[1, 0, 0]])
    assert len(out.misses) == 0
    assert out.dropped == {"not finite": 3}


def test_a_code_among_points() -> None:
    """5.110 m is a code: points just there are none, whatever their direction."""
    out = applied(sensor(sentinels_m=((5.11, "clear"),)), scan([[0, 5.11, 0], [5, 0, 0]]))
    assert np.allclose(out.points, [[5, 0, 0]])
    assert np.allclose(out.misses, [[0, 10, 0]])


def test_misses_of_the_log() -> None:
    """4 m stays 4 m; 20 m is cut to the sensor's 10; where silence says nothing, both go and are counted."""
    seen = scan([[1, 0, 0]], misses=np.array([[0, 4.0, 0], [0, 0, 20.0]]))
    assert np.allclose(applied(sensor(no_return="clear"), seen).misses, [[0, 4, 0], [0, 0, 10]])
    out = applied(sensor(), seen)
    assert (len(out.misses), out.dropped) == (0, {"no return": 2})


SILENT = NoReturns(np.array([[1.0, 0, 0], [0, 1, 0], [0, -1, 0], [-1, 0, 0]]), np.array([81.83, 0.0, NAN, 4.0]))
"""A code, nothing, not a number, and a reading that only the log was told to leave out."""


def test_silent_beams_of_the_log() -> None:
    seen = scan([[1, 0, 0]], no_returns=SILENT)
    out = applied(sensor(no_return="clear"), seen)
    assert np.allclose(out.misses, [[10, 0, 0]])
    assert out.dropped == {"nearer than the sensor's min_range_m": 1, "not finite": 1, "no return": 1}
    assert out.no_returns is None
    out = applied(sensor(), seen)
    assert (len(out.misses), out.dropped["no return"]) == (0, 2)
    out = applied(sensor(sentinels_m=((0.0, "clear"),)), seen)
    assert np.allclose(out.misses, [[0, 10, 0]])


def test_silent_beams_of_an_undescribed_sensor_are_counted() -> None:
    out = undescribed(scan([[1, 0, 0]], no_returns=SILENT, dropped={"no return": 1, "other": 2}))
    assert out.dropped == {"no return": 5, "other": 2}
    assert out.no_returns is None
    plain = scan([[1, 0, 0]])
    assert undescribed(plain) is plain


def test_dropped_adds_up() -> None:
    out = applied(sensor(), scan([[11, 0, 0]], dropped={"no return": 1, "other": 2}))
    assert out.dropped == {"no return": 2, "other": 2}


def test_the_mounting_is_applied_to_the_readers_pose() -> None:
    """At (5, 0, 0) looking north; the sensor 1 m ahead, turned back by 180°: at (5, 1, 0), looking south."""
    T = Pose.from_quaternion((5, 0, 0), (0, 0, math.sin(math.pi / 4), math.cos(math.pi / 4)))
    out = applied(sensor(mounting=Mounting(x_m=1, yaw_rad=math.pi)), scan([[3, 0, 0]], T))
    assert np.allclose((out.T_world_sensor.matrix @ [3, 0, 0, 1])[:3], [5, -2, 0])


def test_without_a_mounting_the_pose_stays_in_every_bit() -> None:
    T = Pose.from_quaternion((5.1, -7.3, 0.2), (0.1, 0.2, 0.3, 0.9))
    assert np.array_equal(applied(sensor(), scan([[3, 0, 0]], T)).T_world_sensor.matrix, T.matrix)


def test_beams_that_start_elsewhere() -> None:
    """From (1, 0, 2): (1, 0, 5) is 3 m away, (21, 0, 2) is 20 m and cut to (11, 0, 2)."""
    out = applied(sensor(origin_m=(1, 0, 2), no_return="clear"), scan([[1, 0, 5], [21, 0, 2]]))
    assert np.allclose(out.points, [[1, 0, 5]])
    assert np.allclose(out.misses, [[11, 0, 2]])
    assert np.allclose(out.origins, [[1, 0, 2], [1, 0, 2]])


def test_origins_of_the_reader_come_first() -> None:
    """Ranges count from them: 9 m from (2, 0, 0), and 12 m from (-1, 0, 0), which ends at 9."""
    seen = scan([[11, 0, 0], [11, 0, 0]], origins=np.array([[2.0, 0, 0], [-1, 0, 0]]))
    out = applied(sensor(no_return="clear"), seen)
    assert np.allclose(out.points, [[11, 0, 0]])
    assert np.allclose(out.misses, [[9, 0, 0]])
    assert np.allclose(out.origins, [[2, 0, 0], [-1, 0, 0]])


def test_a_point_within_the_ring_is_behind_its_beam() -> None:
    ring = sensor(beams=Ring(4, 0.0, math.pi / 2, radius_m=0.5))
    out = applied(ring, scan([[0.3, 0, 0], [1.0, 0, 0]]))
    assert np.allclose(out.points, [[1, 0, 0]])
    assert out.dropped == {"nearer than the sensor's min_range_m": 1}


@given(
    st.lists(st.one_of(st.floats(0.01, 30), st.sampled_from([10.0, 5.0])), min_size=5, max_size=5),
    st.floats(0, 1),
    st.sampled_from(["clear", "ignore"]),
    st.floats(-1.4, 1.4),
    st.booleans(),
)
def test_points_of_all_readings_come_to_what_the_readings_come_to(
    ranges: list[float], radius_m: float, no_return: str, elevation: float, moved: bool
) -> None:
    """A reader that gives the raw ends of all beams, and `applied`, against `scan_of` of the readings."""
    ring = Ring(5, 0.3, 1.1, radius_m=radius_m, elevations_rad=(elevation,))
    origin = (1.0, -2.0, 0.5) if moved else (0.0, 0.0, 0.0)
    described = sensor(beams=ring, no_return=no_return, origin_m=origin)
    everything = scan_of(sensor(beams=ring, max_range_m=1e9, origin_m=origin), ranges, 5, HERE)
    near = [r for r in ranges if abs(r - 10.0) > 1e-6]
    if len(near) < len(ranges) or np.cos(elevation) * min(ranges) < 1e-6:
        return  # on the limit itself rounding decides
    raw = Scan(5, everything.points, HERE)
    one, other = applied(described, raw), scan_of(described, ranges, 5, HERE)
    assert np.allclose(one.points, other.points)
    assert np.allclose(one.misses, other.misses)
    assert dict(one.dropped) == dict(other.dropped)
    assert (one.origins is None) == (other.origins is None)
    if one.origins is not None:
        assert np.allclose(one.origins, other.origins)


@pytest.mark.parametrize("no_return", ["clear", "ignore"])
def test_an_empty_scan(no_return: str) -> None:
    out = applied(sensor(no_return=no_return, origin_m=(1, 0, 0)), scan([]))
    assert (out.points.shape, out.misses.shape, out.origins.shape) == ((0, 3), (0, 3), (0, 3))
