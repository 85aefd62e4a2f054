"""Robots' motion: by hand where it is simple, by its laws where it is not."""

from __future__ import annotations

from dataclasses import fields, replace
from math import atan, cos, hypot, pi, sin, sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from terrafuse.errors import InputError
from terrafuse.simulate.motion import BODIES, PROBE_M, Body, Command, Ground, Rotors, State, Wheels, placed, step
from terrafuse.simulate.routes import ARRIVED_M, at_start, pursue, routes_of
from terrafuse.simulate.terrain import flat
from terrafuse.types import Array, Bounds, Floats, checked_pose

FLAT = Ground(lambda x, y: np.zeros(x.shape))
SLOPE = Ground(lambda x, y: 0.2 * x + 0.1 * y)
BODY = Body(0.3, 2.0, 1.0, 1.0, 2.0, Wheels(0.4, 0.4))
"""2 m/s, 1 m/s², 1 rad/s, 2 rad/s²."""
DRONE = BODIES["drone"]


def one(ground: Ground = FLAT, body: Body = BODY, x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> State:
    return placed(ground, body, [(x, y)], [yaw])


def told(speed: float, yaw_rate: float = 0.0, altitude: float = 0.0) -> Command:
    return Command(np.array([speed]), np.array([yaw_rate]), np.array([altitude]))


def driven(state: State, command: Command, steps: int, ground: Ground = FLAT, body: Body = BODY) -> State:
    for _ in range(steps):
        state = step(state, command, 0.1, ground, body)
    return state


def until_blocked(state: State, command: Command, ground: Ground, body: Body = BODY) -> State:
    for _ in range(100):
        state = step(state, command, 0.1, ground, body)
        if state.blocked[0]:
            return state
    raise AssertionError("nothing was in the way")


def wall(x_m: float) -> Ground:
    return Ground(FLAT.height, lambda x, y: x >= x_m)


def test_speeding_up_by_hand() -> None:
    """1 m/s²: after 1 s 1 m/s and 0.5 m; after 2 s 2 m/s, its limit, and 2 m; after 3 s 4 m."""
    state = one()
    for speed, x in ((1.0, 0.5), (2.0, 2.0), (2.0, 4.0)):
        state = driven(state, told(9.0), 10)
        assert (state.speed_mps[0], state.position_m[0, 0]) == pytest.approx((speed, x))
    assert state.position_m[0, 1:].tolist() == [0, 0]


def test_braking_and_reversing_by_hand() -> None:
    """From 1 m/s to -1 m/s takes 2 s and leads nowhere; its highest point is 0.5 m further."""
    state = driven(one(), told(1.0), 10)
    before = state.position_m[0, 0]
    assert driven(state, told(-1.0), 10).position_m[0, 0] == pytest.approx(before + 0.5)
    assert driven(state, told(-1.0), 20).position_m[0, 0] == pytest.approx(before)


def test_turning_on_the_spot_by_hand() -> None:
    """2 rad/s²: after 0.5 s it turns at 1 rad/s, its limit, and has turned by 0.25; after 1 s by 0.75."""
    state = driven(one(), told(0.0, 5.0), 10)
    assert (state.yaw_rate_radps[0], state.yaw_rad[0]) == pytest.approx((1.0, 0.75))
    assert state.position_m[0].tolist() == [0, 0, 0]
    assert driven(state, told(0.0, 5.0), 60).yaw_rad[0] == pytest.approx(0.75 + 6 - 2 * pi)


def test_a_circle_by_hand() -> None:
    """At 1 m/s and 1 rad/s the radius is 1: started at speed, after π seconds it is opposite, 2 m to the left."""
    fast = replace(one(), speed_mps=np.ones(1), yaw_rate_radps=np.ones(1))
    after = step(fast, told(1.0, 1.0), pi, FLAT, BODY)
    assert after.position_m[0] == pytest.approx([0.0, 2.0, 0.0])
    assert abs(after.yaw_rad[0]) == pytest.approx(pi)


def test_wheels_limit_speed_and_turn_together() -> None:
    """Axle 0.5 m, wheels of 1 m/s: 1 m/s and 4 rad/s would need 1 + 4·0.25 = 2 m/s, so both are halved."""
    body = Body(0.3, 1.0, 100.0, 10.0, 100.0, Wheels(0.4, 0.4), axle_m=0.5)
    state = step(one(body=body), told(1.0, 4.0), 1.0, FLAT, body)
    assert (state.speed_mps[0], state.yaw_rate_radps[0]) == pytest.approx((0.5, 2.0))


def test_standing_on_a_slope_by_hand() -> None:
    """dz/dx = 0.2, dz/dy = 0.1. Looking east the nose is up by atan 0.2, the left up by atan2(0.1, √1.04)."""
    state = one(SLOPE)
    assert (state.pitch_rad[0], state.roll_rad[0]) == pytest.approx((-atan(0.2), atan(0.1 / sqrt(1.04))))
    north = one(SLOPE, yaw=pi / 2)
    assert (north.pitch_rad[0], north.roll_rad[0]) == pytest.approx((-atan(0.1), -atan(0.2 / sqrt(1.01))))
    assert one(SLOPE, x=3.0, y=2.0).position_m[0, 2] == pytest.approx(0.8)


@given(st.floats(-1, 1), st.floats(-1, 1), st.floats(-pi, pi))
def test_a_robot_stands_square_on_its_slope(a: float, b: float, yaw: float) -> None:
    """Its up is the plane's normal (-a, -b, 1), and its nose points along its yaw, seen from above."""
    pose = one(Ground(lambda x, y: a * x + b * y), yaw=yaw).pose(0)
    checked_pose(pose.matrix)
    ahead, up = pose.matrix[:3, 0], pose.matrix[:3, 2]
    assert up == pytest.approx(np.array([-a, -b, 1]) / sqrt(a * a + b * b + 1), abs=1e-9)
    assert ahead[:2] / hypot(*ahead[:2]) == pytest.approx([cos(yaw), sin(yaw)], abs=1e-9)


def test_uphill_the_way_is_along_the_ground() -> None:
    """A slope of 3 in 4: 1 m along it is 0.8 m ahead and 0.6 m up."""
    ground = Ground(lambda x, y: 0.75 * x)
    before = driven(one(ground), told(1.0), 10, ground)
    after = driven(before, told(1.0), 10, ground)
    assert (after.position_m - before.position_m)[0] == pytest.approx([0.8, 0.0, 0.6])


def test_it_stops_at_a_wall_and_says_so() -> None:
    """A wall from x = 5 on and a radius of 0.3: it ends at most PROBE_M before 4.7, and backs off when told."""
    ground = wall(5.0)
    state = until_blocked(one(ground), told(2.0), ground)
    assert state.speed_mps[0] == 0
    assert driven(state, told(2.0), 40, ground).position_m[0, 0] < 4.7
    assert 4.7 - PROBE_M <= state.position_m[0, 0] < 4.7
    turned = driven(state, told(0.0, 1.0), 10, ground)
    assert not turned.blocked[0]
    assert turned.yaw_rad[0] > 0.5
    back = driven(state, told(-1.0), 10, ground)
    assert not back.blocked[0]
    assert back.position_m[0, 0] < 4.3


def test_what_came_into_its_place_it_can_leave_but_not_pass() -> None:
    """A wall that came 10 cm into the disc at the origin: away from it, but no deeper into it."""
    near = wall(BODY.radius_m - 0.1)
    inside = one()
    assert driven(inside, told(1.0), 10, near).position_m[0, 0] <= PROBE_M
    left = driven(inside, told(-1.0), 20, near)
    assert left.position_m[0, 0] < -0.5
    assert not left.blocked[0]


def test_where_there_is_no_ground_nobody_goes() -> None:
    ground = Ground(flat(Bounds(-5.0, -5.0, 5.0, 5.0)).height)
    state = until_blocked(one(ground), told(2.0), ground)
    assert np.isfinite(state.position_m).all()
    assert 4.7 - PROBE_M <= state.position_m[0, 0] <= 4.7


def discs(x: Floats, y: Floats) -> Array:
    """Pillars of 0.4 m on a square lattice of 2 m."""
    return np.hypot((x + 1) % 2 - 1, (y + 1) % 2 - 1) < 0.4


@settings(max_examples=40)
@given(st.integers(0, 2**32), st.sampled_from(["summit_xl", "nomad", "soccer", "drone"]))
def test_nobody_ever_enters_what_is_blocked_nor_breaks_a_limit(seed: int, name: str) -> None:
    """Twenty robots commanded at random among pillars, for 5 s."""
    rng, body, ground = np.random.default_rng(seed), BODIES[name], Ground(FLAT.height, discs)
    start = 2 * rng.integers(-5, 5, (20, 2)) + 1.0
    state = placed(ground, body, start, rng.uniform(-pi, pi, 20))
    for _ in range(25):
        command = Command(rng.uniform(-9, 9, 20), rng.uniform(-9, 9, 20), rng.uniform(0, 9, 20))
        before, state = state, step(state, command, 0.2, ground, body)
        moved = np.hypot(*(state.position_m - before.position_m)[:, :2].T)
        assert not discs(*state.position_m[:, :2].T).any()
        assert (moved <= body.max_speed_mps * 0.2 + 1e-9).all()
        assert (np.abs(state.speed_mps) <= body.max_speed_mps).all()
        assert (np.abs(state.speed_mps - before.speed_mps)[~state.blocked] <= body.max_mps2 * 0.2 + 1e-9).all()
        assert (np.abs(state.yaw_rate_radps) <= body.max_yaw_rate_radps).all()
        assert (state.position_m[:, 2] >= 0).all()


@settings(max_examples=20)
@given(st.integers(0, 2**32))
def test_many_robots_move_as_each_alone(seed: int) -> None:
    rng, body, ground = np.random.default_rng(seed), BODIES["summit_xl"], Ground(SLOPE.height, discs)
    places, yaws = 2 * rng.integers(-5, 5, (8, 2)) + 1.0, rng.uniform(-pi, pi, 8)
    together = placed(ground, body, places, yaws)
    alone = [placed(ground, body, places[n], yaws[n]) for n in range(8)]
    for _ in range(10):
        speed, yaw_rate = rng.uniform(-4, 4, (2, 8))
        together = step(together, Command(speed, yaw_rate), 0.2, ground, body)
        alone = [
            step(state, Command(speed[[n]], yaw_rate[[n]]), 0.2, ground, body) for n, state in enumerate(alone)
        ]  # fmt: skip
    for field in fields(State):
        expected = np.concatenate([getattr(state, field.name) for state in alone])
        assert getattr(together, field.name) == pytest.approx(expected, abs=1e-9)


def test_a_robot_in_something_is_refused() -> None:
    with pytest.raises(InputError, match=r"robot 1 at \(0\.0, 0\.5\)"):
        placed(Ground(FLAT.height, discs), BODY, [(1.0, 1.0), (0.0, 0.5)], [0.0, 0.0])


def test_a_step_changes_nothing_of_the_state_before() -> None:
    state = driven(one(), told(1.0, 0.5), 5)
    kept = {field.name: getattr(state, field.name).copy() for field in fields(State)}
    step(state, told(2.0, -1.0), 0.1, FLAT, BODY)
    assert all((getattr(state, name) == value).all() for name, value in kept.items())


# Flying


def test_climbing_by_hand() -> None:
    """3 m/s², 3 m/s at most: after 1 s 3 m/s and 1.5 m; after 2 s 4.5 m; then it comes to 20 m and no higher."""
    state = driven(one(body=DRONE), told(0.0, 0.0, 20.0), 10, body=DRONE)
    assert (state.climb_mps[0], state.position_m[0, 2]) == pytest.approx((3.0, 1.5))
    state = driven(state, told(0.0, 0.0, 20.0), 10, body=DRONE)
    assert state.position_m[0, 2] == pytest.approx(4.5)
    heights = []
    for _ in range(150):
        state = step(state, told(0.0, 0.0, 20.0), 0.1, FLAT, DRONE)
        heights.append(state.position_m[0, 2])
    assert max(heights) <= 20.05
    assert heights[-1] == pytest.approx(20.0, abs=0.01)
    landed = driven(state, told(0.0), 200, body=DRONE)
    assert landed.position_m[0, 2] == pytest.approx(0.0, abs=0.01)


def test_it_holds_its_height_above_the_ground() -> None:
    """Over a hill at 4 m/s, 10 m above ground: within 2 m, where the ground rises by at most 0.8 m a second."""
    ground = Ground(lambda x, y: 5 * np.sin(x / 25))
    state = driven(one(ground, DRONE), told(0.0, 0.0, 10.0), 150, ground, DRONE)
    for _ in range(300):
        state = step(state, told(4.0, 0.0, 10.0), 0.1, ground, DRONE)
        x, _, z = state.position_m[0]
        assert abs(z - 5 * sin(x / 25) - 10) < 2.0
        assert state.roll_rad[0] == state.pitch_rad[0] == 0


def test_it_does_not_fly_into_a_cliff_but_over_it() -> None:
    """15 m of rock from x = 20 on: at 10 m it stops before it, at 16 m it passes."""
    ground = Ground(lambda x, y: np.where(x >= 20, 15.0, 0.0))
    up = driven(one(ground, DRONE), told(0.0, 0.0, 10.0), 150, ground, DRONE)
    stopped = until_blocked(up, told(4.0, 0.0, 10.0), ground, DRONE)
    assert 19.6 - PROBE_M <= stopped.position_m[0, 0] < 19.6
    over = driven(driven(stopped, told(0.0, 0.0, 16.0), 100, ground, DRONE), told(4.0, 0.0, 16.0), 10, ground, DRONE)
    assert not over.blocked[0]
    assert over.position_m[0, 0] > 20


def test_on_the_ground_it_can_t_fly_sideways() -> None:
    assert driven(one(body=DRONE), told(2.0), 1, body=DRONE).blocked[0]
    assert isinstance(DRONE.carriage, Rotors)


# Routes


def followed(
    way: list[tuple[float, float]], body: Body, speed: float, yaw: float = 0.0, ground: Ground = FLAT
) -> tuple[np.ndarray, bool, int]:
    """Where a robot came along a way, whether it arrived, and after how many steps of 0.1 s."""
    routes = routes_of([way], body)
    state, progress = placed(ground, body, [way[0]], [yaw]), at_start(routes)
    track = [state.position_m[0, :2]]
    for k in range(3000):
        command, progress = pursue(state, routes, progress, body, speed)
        if progress.arrived[0]:
            return np.array(track), True, k
        state = step(state, command, 0.1, ground, body)
        track.append(state.position_m[0, :2])
    return np.array(track), False, len(track)


def off_route(track: np.ndarray, way: list[tuple[float, float]]) -> float:
    """Greatest distance of the track from the way."""
    points = routes_of([way], BODY).points_m
    return float(np.hypot(*(track[:, None] - points).transpose(2, 0, 1)).min(axis=1).max())


@pytest.mark.parametrize("speed", [0.5, 1.5, 3.0])
@pytest.mark.parametrize("name", ["summit_xl", "nomad", "soccer"])
def test_it_follows_corners_closely_and_stops_at_the_end(name: str, speed: float) -> None:
    """Within 0.45 m, at any speed that it has, and without wavering: so in less than twice the time of a straight."""
    way = [(0.0, 0.0), (8.0, 0.0), (8.0, 8.0), (0.0, 8.0), (0.0, 1.0), (4.0, 4.0)]
    track, arrived, steps = followed(way, BODIES[name], speed)
    assert arrived
    assert off_route(track, way) < 0.45
    assert np.hypot(*(track[-1] - way[-1])) <= ARRIVED_M
    seconds = (8 + 8 + 8 + 7 + 5) / min(speed, BODIES[name].max_speed_mps)
    # Corners are cut, so it may even be a little shorter.
    assert 0.95 * seconds < steps * 0.1 < 1.85 * seconds


def test_what_turns_slowly_holds_its_line_when_it_is_fast() -> None:
    """A drone at 8 m/s and 3 m/s²: 180 m in less than half again the time, 22.5 s, and soon straight after a corner."""
    way = [(0.0, 0.0), (0.0, 30.0), (150.0, 30.0)]
    routes = routes_of([way], DRONE)
    state, progress = driven(one(body=DRONE, yaw=pi / 2), told(0.0, 0.0, 10.0), 150, FLAT, DRONE), at_start(routes)
    for _ in range(340):
        command, progress = pursue(state, routes, progress, DRONE, 8.0, 10.0)
        state = step(state, command, 0.1, FLAT, DRONE)
        assert abs(state.position_m[0, 1] - 30) < 0.3 or state.position_m[0, 0] < 30
    assert progress.arrived[0]


def test_it_turns_round_before_it_leaves() -> None:
    track, arrived, _ = followed([(0.0, 0.0), (-5.0, 0.0)], BODIES["summit_xl"], 1.0)
    assert arrived
    assert np.abs(track[:, 1]).max() < 0.3


def test_a_route_that_crosses_itself_is_followed_in_order() -> None:
    way = [(0.0, 0.0), (10.0, 0.0), (10.0, 5.0), (5.0, 5.0), (5.0, -5.0)]
    track, arrived, _ = followed(way, BODIES["summit_xl"], 1.0)
    assert arrived
    assert track[:, 0].max() > 9.5
    assert track[:, 1].max() > 4.5


def test_a_route_of_one_point_is_done_at_once() -> None:
    _, arrived, steps = followed([(1.0, 1.0)], BODIES["nomad"], 1.0)
    assert (arrived, steps) == (True, 0)


def test_several_robots_follow_their_own_routes() -> None:
    ways = [[(0.0, 0.0), (5.0, 0.0)], [(0.0, 10.0), (0.0, 12.0)], [(3.0, -3.0)]]
    body = BODIES["nomad"]
    routes = routes_of(ways, body)
    state, progress = placed(FLAT, body, [way[0] for way in ways], [0.0] * 3), at_start(routes)
    for _ in range(300):
        command, progress = pursue(state, routes, progress, body, 0.6)
        state = step(state, command, 0.1, FLAT, body)
    assert progress.arrived.all()
    assert state.position_m[:, :2] == pytest.approx(np.array([way[-1] for way in ways]), abs=ARRIVED_M)


def test_it_is_slow_enough_for_corners_in_time_by_hand() -> None:
    """A right angle, taken over 2·0.5 m: π/2 rad/m, so at 1 rad/s 2/π = 0.637 m/s, from 0.5 m before to 0.5 m after it.

    2 m before that it may be √(0.637² + 1·2) = 1.551 m/s, with half of the brakes of 1 m/s².
    """
    routes = routes_of([[(0.0, 0.0), (4.0, 0.0), (4.0, 4.0)]], BODY)
    assert routes.points_m[[15, 35, 45]].tolist() == pytest.approx(np.array([[1.5, 0], [3.5, 0], [4, 0.5]]))
    assert routes.fastest_mps[[36, 40, 44]] == pytest.approx([0.6366] * 3, abs=1e-4)
    assert routes.fastest_mps[15] == pytest.approx(1.5510, abs=1e-3)
    assert routes.fastest_mps[60] > 1e3


def test_a_route_without_points_is_refused() -> None:
    with pytest.raises(InputError, match="robot 1"):
        routes_of([[(0.0, 0.0)], []], BODY)
    with pytest.raises(InputError, match="finite"):
        routes_of([[(0.0, np.nan)]], BODY)
