"""The car park: its scenario, its ghosts, and how a closed loop's error is spread back."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from terrafuse.navigate.pose_filter import rotation
from terrafuse.simulate.mission.studies.parking import Drift, Ghosts, spread_back, yaw_of
from terrafuse.types import Pose, pose_of

metres, radians = st.floats(-50, 50), st.floats(-3, 3)
poses = st.builds(
    lambda x, y, z, roll, pitch, yaw: pose_of(rotation(roll / 10, pitch / 10, yaw), np.array([x, y, z])),
    metres, metres, metres, radians, radians, radians,
)  # fmt: skip
trajectories = st.lists(poses, min_size=2, max_size=8)


def at(x: float, y: float, yaw: float = 0.0) -> Pose:
    return pose_of(rotation(0.0, 0.0, yaw), np.array([x, y, 0.0]))


@given(trajectories)
def test_without_an_error_nothing_moves(trajectory: list[Pose]) -> None:
    for before, after in zip(trajectory, spread_back(trajectory, trajectory[-1]), strict=True):
        np.testing.assert_allclose(after.matrix, before.matrix, atol=1e-9)


@given(trajectories, poses)
def test_the_start_stays_and_the_end_is_exact(trajectory: list[Pose], end: Pose) -> None:
    closed = spread_back(trajectory, end)
    np.testing.assert_array_equal(closed[0].matrix, trajectory[0].matrix)
    np.testing.assert_allclose(closed[-1].position, end.position, atol=1e-9)
    off = yaw_of(closed[-1]) - yaw_of(end)
    assert abs(math.remainder(off, math.tau)) < 1e-9


@given(trajectories, poses)
def test_roll_and_pitch_stay(trajectory: list[Pose], end: Pose) -> None:
    for before, after in zip(trajectory, spread_back(trajectory, end), strict=True):
        np.testing.assert_allclose(after.matrix[2, :3], before.matrix[2, :3], atol=1e-12)


def test_an_error_of_place_grows_with_the_way() -> None:
    # 3 m, then 1 m of a way of 4 m: shares 0, 3/4, 1 of (0.4, -0.8).
    closed = spread_back([at(0, 0), at(3, 0), at(4, 0)], at(4.4, -0.8))
    np.testing.assert_allclose([pose.position[:2] for pose in closed], [(0, 0), (3.3, -0.6), (4.4, -0.8)])


def test_a_gyro_that_drifts_evenly_is_put_right() -> None:
    """A circle of 40 steps that the robot believes to be an arc of 350°."""
    true = [at(math.cos(a), math.sin(a), a) for a in np.linspace(0, math.tau, 41)]
    arc, chord = np.linspace(0, math.radians(350), 41), 2 * math.sin(math.tau / 80)
    # The same steps, each at the middle of the yaws at its ends, a quarter turn ahead of the angle.
    steps = [chord * np.array([-math.sin(a), math.cos(a)]) for a in (arc[1:] + arc[:-1]) / 2]
    places = np.array([1.0, 0.0]) + np.vstack([np.zeros(2), np.cumsum(steps, axis=0)])
    believed = [at(x, y, a) for (x, y), a in zip(places.tolist(), arc.tolist(), strict=True)]
    for pose, expected in zip(spread_back(believed, true[-1]), true, strict=True):
        np.testing.assert_allclose(pose.matrix, expected.matrix, atol=1e-9)


def test_a_robot_that_stood_still_keeps_its_first_pose_alone() -> None:
    closed = spread_back([at(1, 1), at(1, 1), at(1, 1)], at(2, 1))
    np.testing.assert_array_equal([pose.position[0] for pose in closed], [1, 2, 2])
    assert spread_back([], at(0, 0)) == []


def _mission(duration_s: float) -> Any:
    pytest.importorskip("embreex")
    from terrafuse.simulate.mission.engine import Mission
    from terrafuse.simulate.scenario import load_scenario
    from terrafuse.simulate.scenario.read import changed

    return Mission(changed(load_scenario("parking"), duration_s=duration_s))


def test_the_same_run_twice_is_the_same_and_has_its_tables() -> None:
    told = []
    for _ in range(2):
        mission = _mission(3.0)
        ghosts, drift = Ghosts(mission), Drift(mission)
        mission.run()
        cells = [vehicle.mapper.delta().tiles for vehicle in mission.vehicles]
        told.append(([tile.cells.tobytes() for tiles in cells for tile in tiles], ghosts.table(), drift.table()))
    assert told[0] == told[1]
    assert [row[0] for row in told[0][1].rows] == ["ground1", "air1", "all"]
    before, after, true = told[0][2].rows
    assert true[1] == 0.0 < after[1] < before[1]  # RMSE of the trajectory
    assert true[3] < before[3]  # of heights


def test_the_dynamic_rule_leaves_no_ghosts_where_beams_came_back() -> None:
    mission = _mission(15.0)
    ghosts = Ghosts(mission)
    mission.run()
    without, with_rule, never_seen_again = ghosts.counts()["all"]
    assert without > 1000
    assert without > 2 * with_rule  # in so short a run, beams come back to few places
    assert without - never_seen_again > 20 * (with_rule - never_seen_again)
