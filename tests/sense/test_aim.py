"""Readings of a log along the beams of a description: by hand, and against what the log's own angles give."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from terrafuse.errors import InputError
from terrafuse.sense import Beams, Mounting, Ring, Sensor, applied, scan_of
from terrafuse.types import NoReturns, Pose, Readings, Scan
from tests.logs.support import pose

NAN, INF = float("nan"), float("inf")
QUARTERS = Ring(4, 0.0, math.pi / 2)
"""Ahead (x), left (y), behind, right."""


def sensor(beams: Ring | Beams | None = QUARTERS, **changes: Any) -> Sensor:
    return Sensor(**{"name": "four", "max_range_m": 10.0, "beams": beams} | changes)


def bare(ranges_m: list[float], T_world_sensor: Pose | None = None, **more: Any) -> Scan:
    """A scan of a log that does not say where its beams look."""
    readings = Readings(np.array(ranges_m), np.ones(len(ranges_m), bool))
    return Scan(5, np.empty((0, 3)), T_world_sensor or Pose.identity(), readings=readings, **more)


def laser(ranges_m: Any, angles_rad: Any, range_max_m: float = INF) -> Scan:
    """A scan of a log that states its angles, as the `ros` reader makes it."""
    ranges, angles = np.asarray(ranges_m, float), np.asarray(angles_rad)
    directions = np.stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))], axis=1)
    seen = (ranges > 0) & (ranges <= range_max_m) & np.isfinite(ranges)
    clear = np.isposinf(ranges) & math.isfinite(range_max_m)
    silent = ~seen & ~clear
    return Scan(
        5, ranges[seen, None] * directions[seen], Pose.identity(),
        misses=range_max_m * directions[clear] if clear.any() else np.empty((0, 3)),
        no_returns=NoReturns(directions[silent], ranges[silent]),
        readings=Readings(ranges, seen, directions, range_max_m),
    )  # fmt: skip


def test_bare_readings_go_where_the_description_says() -> None:
    """2 m ahead and 3 m to the left of a circle of 0.5 m; nothing within 10 m behind; 11 m to the right is none."""
    out = applied(sensor(Ring(4, 0.0, math.pi / 2, radius_m=0.5), no_return="clear"), bare([2, 3, INF, 11]))
    assert np.allclose(out.points, [[2.5, 0, 0], [0, 3.5, 0]])
    assert np.allclose(out.misses, [[-10.5, 0, 0], [0, -10.5, 0]])
    assert np.allclose(out.origins, [[0.5, 0, 0], [0, 0.5, 0], [-0.5, 0, 0], [0, -0.5, 0]])
    assert (out.stamp_ns, out.dropped, out.readings) == (5, {}, None)


def test_it_is_the_scan_of_the_readings() -> None:
    described = sensor(Ring(4, 0.3, 1.1, True, 0.2), min_range_m=1.0, mounting=Mounting(1, 2, 3, yaw_rad=0.5))
    ranges, T = [2.0, 0.5, NAN, 10.0], pose(4, 5, yaw=1.0)
    one, other = applied(described, bare(ranges, T, dropped={"early": 1})), scan_of(described, ranges, 5, T)
    assert np.array_equal(one.points, other.points)
    assert np.array_equal(one.T_world_sensor.matrix, other.T_world_sensor.matrix)
    assert dict(one.dropped) == {**other.dropped, "early": 1}


def test_what_the_log_calls_no_return_stays_none() -> None:
    """8 m is within the sensor's 10, but the log was read with a limit of 5."""
    scan = Scan(5, np.empty((0, 3)), Pose.identity(), readings=Readings(np.array([1, 8, 1, 1.0]), np.arange(4) != 1))
    out = applied(sensor(no_return="clear"), scan)
    assert (len(out.points), len(out.misses), out.dropped) == (3, 0, {"no return": 1})


def test_a_clear_beam_is_so_no_further_than_the_log_says() -> None:
    """+inf of a laser that ends at 4 m: a miss of 4 m, though the description reaches 10."""
    out = applied(sensor(no_return="clear"), laser([1, INF, 1, 1], [0, np.pi / 2, np.pi, 1.5 * np.pi], 4.0))
    assert np.allclose(out.misses, [[0, 4, 0]])


def test_another_number_of_beams() -> None:
    message = "the log has 3 beams, the sensor four has 4: describe the sensor that the log is of"
    with pytest.raises(InputError) as caught:
        applied(sensor(), bare([1, 2, 3]))
    assert str(caught.value) == message
    with pytest.raises(InputError, match=f"{message}; without 'ring' and 'beams' a description leaves the log its"):
        applied(sensor(), laser([1, 2, 3], [0, 1, 2]))
    assert len(applied(sensor(None), laser([1, 2, 3], [0, 1, 2])).points) == 3


def test_other_angles_than_the_log_states() -> None:
    """The third beam looks to 180° by the ring; in the log to 2.5 rad = 143.24°."""
    with pytest.raises(InputError, match=r"beam 2 looks to 143\.24° in the log, to 180\.00° by the sensor four: desc"):
        applied(sensor(), laser([1, 2, 3, 4], [0, np.pi / 2, 2.5, 1.5 * np.pi]))
    tilted = sensor(Ring(4, 0.0, math.pi / 2, elevations_rad=(0.2,)))
    with pytest.raises(InputError, match=r"to 0\.00° in the log, to 0\.00° and 11\.46° up by the sensor four"):
        applied(tilted, laser([1, 2, 3, 4], [0, np.pi / 2, np.pi, 1.5 * np.pi]))
    with pytest.raises(InputError, match=r"looks to nan° in the log"):
        applied(sensor(), laser([1, 2, 3, 4], [NAN, NAN, NAN, NAN]))


def test_angles_of_which_the_log_has_few_digits() -> None:
    """1.57 and 4.71 are 0.0008 and 0.0024 off: the same beams; where they go, the description says."""
    out = applied(sensor(), laser([1, 2, 3, 4], [0, 1.57, 3.14, 4.71]))
    assert np.allclose(out.points, [[1, 0, 0], [0, 2, 0], [-3, 0, 0], [0, -4, 0]], atol=1e-12)


@given(
    st.lists(st.sampled_from([0.0, 0.5, 3.0, 9.99, 10.5, 12.0, 20.0, 81.83, INF, -INF, NAN]), min_size=4, max_size=4),
    st.sampled_from(["clear", "ignore"]),
    st.sampled_from([4.0, 11.0, 30.0, INF]),
)
def test_beams_that_agree_change_nothing(ranges_m: list[float], no_return: str, range_max_m: float) -> None:
    """A description with the log's own beams, against the same without any."""
    scan = laser(ranges_m, [0, np.pi / 2, np.pi, 1.5 * np.pi], range_max_m)
    more: dict[str, Any] = {"min_range_m": 1.0, "no_return": no_return, "sentinels_m": ((12.0, "ignore"),)}
    one, other = applied(sensor(**more), scan), applied(sensor(None, **more), scan)
    for ends, others in ((one.points, other.points), (one.misses, other.misses)):
        assert np.allclose(sorted(ends.round(9).tolist()), sorted(others.round(9).tolist()))
    assert dict(one.dropped) == dict(other.dropped)
