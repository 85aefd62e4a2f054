"""Robots with mass and wheels: they do what they are told where the ground allows it, and pass through nothing."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import fields
from math import atan, pi
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from terrafuse.errors import InputError, MissingExtra
from terrafuse.simulate.blocks import Block
from terrafuse.simulate.houses import Wall
from terrafuse.simulate.motion import BODIES, Command, Ground, State, placed
from terrafuse.simulate.movers import Mover, drive
from terrafuse.simulate.physics import MACHINES, Physics, PhysicsSettings
from terrafuse.simulate.physics.machines import skid_track
from terrafuse.simulate.terrain import Terrain, flat
from terrafuse.simulate.world import World
from terrafuse.types import Bounds, Floats
from tests.simulate.places import hamlet

pytest.importorskip("mujoco")

BOUNDS = Bounds(-50.0, -50.0, 50.0, 50.0)
LEVEL = World("level", BOUNDS, flat(BOUNDS))
WALL = World("wall", BOUNDS, flat(BOUNDS), walls=(Wall(5.0, -20.0, 5.0, 20.0, 1.5, 0.3),))
"""Its near face is at 5 - 0.3/2 = 4.85."""
WHEELED = ("summit_xl", "nomad", "soccer")
AHEAD_M = {"summit_xl": 0.72 / 2, "nomad": 0.534 / 2, "soccer": 0.4 / 2, "drone": 0.8 / 2}
"""From the middle to the front."""


def slope(rise: float) -> World:
    """Level to the west of x = 0, then rising to the east."""
    x_m = np.linspace(-50, 50, 41)
    return World("slope", BOUNDS, Terrain(-50.0, -50.0, 2.5, np.tile(rise * x_m.clip(0), (41, 1))))


def standing(world: World, body: str, x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> State:
    return placed(Ground(world.terrain.height), BODIES[body], [(x, y)], [yaw])


def alone(world: World, body: str, x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> Physics:
    return Physics(world, {"r": body}, {"r": standing(world, body, x, y, yaw)})


def told(speed: float, yaw_rate: float = 0.0, altitude: float = 0.0) -> Command:
    return Command(np.array([speed]), np.array([yaw_rate]), np.array([altitude]))


def driven(physics: Physics, command: Command, seconds: float, start_s: float = 0.0) -> list[State]:
    """Its states, ten a second."""
    return [
        physics.step({"r": command}, 0.1, start_s + k * 0.1)["r"] for k in range(round(10 * seconds))
    ]  # fmt: skip


def mean_of(states: list[State], field: str) -> float:
    return float(np.mean([getattr(state, field)[0] for state in states]))


# Level ground


@pytest.mark.parametrize("body", WHEELED)
@pytest.mark.parametrize("share", [0.2, -0.5, 1.0])
def test_straight_ahead_at_the_commanded_speed(body: str, share: float) -> None:
    """Within 0.5 %, on a straight line, as high as it stands."""
    speed = share * BODIES[body].max_speed_mps
    states = driven(alone(LEVEL, body), told(speed), 4)
    assert mean_of(states[25:], "speed_mps") == pytest.approx(speed, rel=5e-3)
    assert abs(states[-1].position_m[0, 1]) < 0.01
    assert abs(states[-1].yaw_rad[0]) < 2e-3
    assert max(abs(state.position_m[0, 2]) for state in states) < 1.5e-3
    assert not any(state.blocked[0] for state in states)


@pytest.mark.parametrize("body", WHEELED)
@pytest.mark.parametrize(("speed", "yaw_rate"), [(0.0, 0.3), (0.0, -1.0), (0.3, 0.5), (0.4, -0.3)])
def test_turns_at_the_commanded_rate(body: str, speed: float, yaw_rate: float) -> None:
    """Within 3 %, the skid-steered one too; the middle stays in its place where it shall."""
    states = driven(alone(LEVEL, body), told(speed, yaw_rate), 5)
    assert mean_of(states[20:], "yaw_rate_radps") == pytest.approx(yaw_rate, rel=0.03)
    assert mean_of(states[20:], "speed_mps") == pytest.approx(speed, rel=0.02, abs=1e-3)
    if speed == 0:
        assert np.hypot(*states[-1].position_m[0, :2]) < 0.01


def test_skid_steering_by_hand() -> None:
    """Wheels 0.45 m apart along and 0.47 m across: (0.2025 + 0.2209)/0.47 = 0.9009 m, 1.92 times the track."""
    assert skid_track(0.45, 0.47) == pytest.approx(0.9009, abs=1e-4)


@pytest.mark.parametrize("yaw", [0.0, 0.4, pi / 2, 2.5])
def test_skid_steering_does_not_depend_on_the_compass(yaw: float) -> None:
    states = driven(alone(LEVEL, "summit_xl", yaw=yaw), told(0.0, 0.8), 4)
    assert mean_of(states[20:], "yaw_rate_radps") == pytest.approx(0.8, rel=0.02)


def test_it_speeds_up_and_brakes_as_fast_as_its_body_may() -> None:
    """1.5 m/s²: after 1 s 1.5 m/s and 0.75 m, as without forces."""
    physics = alone(LEVEL, "summit_xl")
    after = driven(physics, told(3.0), 1)[-1]
    assert after.speed_mps[0] == pytest.approx(1.5, abs=0.02)
    assert after.position_m[0, 0] == pytest.approx(0.75, abs=0.02)
    assert driven(physics, told(0.0), 1)[-1].speed_mps[0] == pytest.approx(0.0, abs=0.02)


def test_it_goes_on_from_how_it_moved() -> None:
    """A state in motion is taken over: no stop, no jump."""
    moving = driven(alone(LEVEL, "summit_xl"), told(2.0), 3)[-1]
    after = driven(Physics(LEVEL, {"r": "summit_xl"}, {"r": moving}), told(2.0), 1)
    assert min(state.speed_mps[0] for state in after) > 1.98
    assert after[-1].position_m[0, 0] - moving.position_m[0, 0] == pytest.approx(2.0, abs=0.02)


# Slopes


@pytest.mark.parametrize("body", WHEELED)
def test_climbs_fifteen_percent_along_the_ground(body: str) -> None:
    """Pitch follows within 0.7°, wheels stay on the ground within 2 mm, the speed is held within 1.5 %."""
    world = slope(0.15)
    states = driven(alone(world, body, x=2.0), told(0.5), 6)
    last = states[-1]
    assert mean_of(states[30:], "speed_mps") == pytest.approx(0.5, rel=0.015)
    assert last.pitch_rad[0] == pytest.approx(-atan(0.15), abs=0.012)
    assert last.roll_rad[0] == pytest.approx(0.0, abs=2e-3)
    assert last.position_m[0, 2] == pytest.approx(0.15 * last.position_m[0, 0], abs=2e-3)


@pytest.mark.parametrize("body", WHEELED)
def test_across_a_slope_roll_follows_and_it_stays_where_it_is(body: str) -> None:
    """It looks north, so its left side is to the west, which is lower: roll is negative. It creeps by less than
    0.1 mm/s."""
    physics = alone(slope(0.15), body, x=20.0, yaw=pi / 2)
    first = driven(physics, told(0.0), 2)[-1]
    last = driven(physics, told(0.0), 5)[-1]
    assert last.roll_rad[0] == pytest.approx(-atan(0.15), abs=0.006)
    assert np.linalg.norm(last.position_m - first.position_m) < 5e-4


def test_too_steep_a_slope_is_not_climbed() -> None:
    """Friction is 0.8: 0.7 goes, 0.9 slides back with wheels turning."""
    assert driven(alone(slope(0.7), "summit_xl", x=3.0), told(0.5), 4)[-1].position_m[0, 0] > 4
    steep = driven(alone(slope(0.9), "summit_xl", x=3.0), told(0.5), 3)
    assert steep[-1].position_m[0, 0] < 2.5


@pytest.mark.parametrize("body", WHEELED)
def test_it_gets_onto_a_ramp_and_down_again(body: str) -> None:
    world = slope(0.12)
    up = driven(alone(world, body, x=-1.5, y=0.3), told(0.5), 8)[-1]
    assert up.position_m[0, 0] > 1.5
    down = driven(alone(world, body, x=1.5, y=0.3, yaw=pi), told(0.5), 8)[-1]
    assert down.position_m[0, 0] < -1.5


# What is in the way


@pytest.mark.parametrize("body", MACHINES)
@pytest.mark.parametrize("yaw", [0.0, 0.5])
def test_it_stops_at_a_wall_and_says_so(body: str, yaw: float) -> None:
    physics = alone(WALL, body, x=3.0, yaw=yaw)
    states = driven(physics, told(BODIES[body].max_speed_mps, 0.0, 1.0), 8)
    assert not states[0].blocked[0]
    assert states[-1].blocked[0]
    assert max(state.position_m[0, 0] for state in states) < 4.85 - AHEAD_M[body] + 0.02
    back = driven(physics, told(-0.5, 0.0, 1.0), 4)
    assert not back[-1].blocked[0]
    assert back[-1].position_m[0, 0] < states[-1].position_m[0, 0] - 0.5


def test_a_parked_car_stops_it() -> None:
    """The car's tail is at 6 - 4.4/2 = 3.8."""
    car = Block("car", 6.0, 0.0, 4.4, 1.8, 0.0, -0.5, 1.45, 1.45)
    world = World("parked", BOUNDS, flat(BOUNDS), furniture=(car,))
    states = driven(alone(world, "summit_xl"), told(2.0), 5)
    assert states[-1].blocked[0]
    assert max(state.position_m[0, 0] for state in states) < 3.8 - 0.36 + 0.02


def test_a_moving_car_pushes_it_along() -> None:
    """It comes at 2 m/s from 10 m behind and goes 20 m on; its front is 2.2 m ahead of its middle."""
    car = Mover("car", "car", drive([(-10.0, 0.0), (10.0, 0.0)], 2.0))
    world = World("traffic", BOUNDS, flat(BOUNDS), movers=(car,))
    states = driven(alone(world, "summit_xl", yaw=pi / 2), told(0.0), 9.9)
    assert not states[20].blocked[0]
    assert states[-1].blocked[0]
    # Half of its width is 0.305: 9.8 + 2.2 + 0.305, and it may be pressed in by a few centimetres.
    assert states[-1].position_m[0, 0] == pytest.approx(12.3, abs=0.08)


def test_what_is_not_there_pushes_nobody() -> None:
    """The car comes at 5 s and is gone 2 s later."""
    car = Mover("car", "car", drive([(-1.0, 0.0), (1.0, 0.0)], 1.0, start_s=5.0))
    world = World("traffic", BOUNDS, flat(BOUNDS), movers=(car,))
    physics = alone(world, "summit_xl")
    assert not any(state.blocked[0] for state in driven(physics, told(0.0), 4.8))
    assert any(state.blocked[0] for state in driven(physics, told(0.0), 1.0, start_s=4.8))
    driven(physics, told(0.0), 2.0, start_s=5.8)
    assert not any(state.blocked[0] for state in driven(physics, told(0.0), 1.0, start_s=7.8))


@pytest.mark.parametrize("bodies", [("summit_xl", "summit_xl"), ("summit_xl", "nomad"), ("soccer", "soccer")])
def test_robots_that_meet_do_not_pass_through_each_other(bodies: tuple[str, str]) -> None:
    """Face to face, a little aside. Their middles stay at least their half widths apart."""
    states = {"a": standing(LEVEL, bodies[0], -2.0), "b": standing(LEVEL, bodies[1], 2.0, 0.05, pi)}
    physics = Physics(LEVEL, dict(zip("ab", bodies, strict=True)), states)
    apart_m, both = [], 0
    for k in range(80):
        now = physics.step({"a": told(1.0), "b": told(1.0)}, 0.1, k * 0.1)
        apart_m.append(np.linalg.norm(now["a"].position_m - now["b"].position_m))
        both += int(now["a"].blocked[0] and now["b"].blocked[0])
    least = {"summit_xl": 0.305, "nomad": 0.267, "soccer": 0.2}
    assert min(apart_m) > sum(least[body] for body in bodies) - 0.02
    assert both > 5


def test_nobody_leaves_the_terrain() -> None:
    states = driven(alone(LEVEL, "summit_xl", x=47.0), told(3.0), 5)
    assert states[-1].blocked[0]
    assert max(state.position_m[0, 0] for state in states) < 50 - 0.36 + 0.02


@settings(max_examples=3, deadline=None)
@given(st.integers(0, 2**32))
def test_nobody_gets_into_a_house_or_off_the_ground(seed: int) -> None:
    """Eight robots commanded at random for 10 s on hills among houses and walls."""
    world, rng = hamlet(), np.random.default_rng(seed)
    places = [
        (-8.0, -8.0),
        (-8.0, 8.0),
        (8.0, -8.0),
        (8.0, 8.0),
        (-30.0, -5.0),
        (30.0, -5.0),
        (0.0, 25.0),
        (0.0, -30.0),
    ]
    state = placed(Ground(world.terrain.height), BODIES["summit_xl"], places, rng.uniform(-pi, pi, 8))
    physics = Physics(world, {"r": "summit_xl"}, {"r": state})
    for k in range(100):
        command = Command(rng.uniform(-3, 3, 8), rng.uniform(-2, 2, 8))
        now = physics.step({"r": command}, 0.1, k * 0.1)["r"]
        x, y, z = now.position_m.T
        assert (np.abs(z - world.terrain.height(x, y)) < 0.25).all()
        for block in world.blocks:
            assert not _deep_inside(block, x, y).any()


def _deep_inside(block: Block, x: Floats, y: Floats) -> Floats:
    """Nearer to its middle than where a robot's middle can be: 0.305 m before a wall."""
    c, s = np.cos(block.yaw_rad), np.sin(block.yaw_rad)
    u, v = c * (x - block.x_m) + s * (y - block.y_m), c * (y - block.y_m) - s * (x - block.x_m)
    return np.asarray((np.abs(u) < block.length_m / 2 + 0.25) & (np.abs(v) < block.width_m / 2 + 0.25))


# The drone


def test_the_drone_holds_its_height_and_speed() -> None:
    physics = alone(LEVEL, "drone")
    states = driven(physics, told(3.0, 0.0, 5.0), 8)
    assert states[-1].position_m[0, 2] == pytest.approx(5.0, abs=0.02)
    assert max(state.position_m[0, 2] for state in states) < 5.05
    assert mean_of(states[50:], "speed_mps") == pytest.approx(3.0, rel=5e-3)
    assert abs(states[-1].pitch_rad[0]) < 0.01


def test_the_drone_leans_where_it_speeds_up_to() -> None:
    """Up to 1.5 · 3 m/s²: atan(4.5/9.81) = 0.43. Nose down ahead."""
    states = driven(alone(LEVEL, "drone"), told(8.0, 0.0, 5.0), 2)
    assert 0.2 < max(state.pitch_rad[0] for state in states) < 0.5


def test_the_drone_follows_the_ground_and_turns() -> None:
    world = slope(0.3)
    states = driven(alone(world, "drone", x=-3.0), told(1.0, 0.0, 4.0), 12)
    x, _, z = states[-1].position_m[0]
    # Climbing at 0.3 m/s it lags by 0.3 m, as it aims at the missing height times 1/s.
    assert z - 0.3 * x == pytest.approx(4.0 - 0.3, abs=0.03)
    turning = driven(alone(LEVEL, "drone"), told(0.0, 1.0, 2.0), 4)
    assert mean_of(turning[20:], "yaw_rate_radps") == pytest.approx(1.0, rel=0.01)


def test_the_drone_keeps_its_height_above_what_it_is_told_to() -> None:
    state = standing(LEVEL, "drone")
    above = Physics(LEVEL, {"r": "drone"}, {"r": state}, below=lambda x, y: np.full(np.shape(x), 7.0))
    assert driven(above, told(0.0, 0.0, 2.0), 8)[-1].position_m[0, 2] == pytest.approx(9.0, abs=0.02)


# The same again


def run_of(steps: int = 40) -> bytes:
    world = hamlet()
    ground, rng = Ground(world.terrain.height), np.random.default_rng(3)
    states = {
        "cars": placed(ground, BODIES["summit_xl"], [(-8.0, -8.0), (8.0, 8.0)], [0.0, 1.0]),
        "drone": placed(ground, BODIES["drone"], [(0.0, 8.0)], [0.0]),
    }
    physics, out = Physics(world, {"cars": "summit_xl", "drone": "drone"}, states), []
    for k in range(steps):
        commands = {
            "cars": Command(rng.uniform(-3, 3, 2), rng.uniform(-2, 2, 2)),
            "drone": told(*rng.uniform(-3, 3, 2), 4.0),
        }
        now = physics.step(commands, 0.1, k * 0.1)
        out += [np.asarray(getattr(state, field.name)).tobytes() for state in now.values() for field in fields(State)]
    return b"".join(out)


def test_the_same_commands_give_the_same_bytes() -> None:
    assert run_of() == run_of()


@pytest.mark.parametrize("step_s", [0.002, 0.004])
def test_shorter_steps_change_little(step_s: float) -> None:
    states = standing(LEVEL, "summit_xl")
    usual = driven(Physics(LEVEL, {"r": "summit_xl"}, {"r": states}), told(1.0, 0.5), 4)[-1]
    short = PhysicsSettings(step_s)
    finer = driven(Physics(LEVEL, {"r": "summit_xl"}, {"r": states}, settings=short), told(1.0, 0.5), 4)[-1]
    assert usual.position_m[0] == pytest.approx(finer.position_m[0], abs=0.05)
    assert usual.yaw_rad[0] == pytest.approx(finer.yaw_rad[0], abs=0.02)


@pytest.mark.parametrize("rate_hz", [50, 20, 7])
def test_the_rate_of_commands_changes_little(rate_hz: int) -> None:
    """Two seconds of the same command, in steps of any length."""
    physics = alone(LEVEL, "summit_xl")
    for k in range(2 * rate_hz):
        state = physics.step({"r": told(1.0, 0.5)}, 1 / rate_hz, k / rate_hz)["r"]
    usual = driven(alone(LEVEL, "summit_xl"), told(1.0, 0.5), 2)[-1]
    assert state.position_m[0] == pytest.approx(usual.position_m[0], abs=0.01)


def test_the_python_of_the_page_runs(capsys: pytest.CaptureFixture[str]) -> None:
    """5 s at 1 m/s, of which the first 1/1.5 s went by in speeding up: 5 - 1/3 m."""
    page = (Path(__file__).parents[2] / "docs" / "simulator.md").read_text()
    (code,) = (block for block in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "Physics" in block)
    exec(compile(code, "simulator.md", "exec"), {})
    assert capsys.readouterr().out.split("]")[0] == "[4.7 0. "


# Mistakes


def test_a_robot_in_something_is_refused() -> None:
    with pytest.raises(InputError, match=r"robot 0 of r at \(4\.8, 1\.0\): something is in its place"):
        alone(WALL, "summit_xl", x=4.8, y=1.0)


def test_unknown_bodies_missing_commands_and_impossible_steps_are_refused() -> None:
    state = standing(LEVEL, "summit_xl")
    with pytest.raises(InputError, match="no body 'tank'; take one of summit_xl, nomad"):
        Physics(LEVEL, {"r": "tank"}, {"r": state})
    with pytest.raises(InputError, match="give one of each"):
        Physics(LEVEL, {"r": "summit_xl"}, {"s": state})
    physics = Physics(LEVEL, {"r": "summit_xl"}, {"r": state})
    with pytest.raises(InputError, match=r"commands for \[\]: give them for \['r'\]"):
        physics.step({}, 0.1, 0.0)
    for dt_s in (0.0, float("nan")):
        with pytest.raises(InputError, match="positive number of seconds"):
            physics.step({"r": told(1.0)}, dt_s, 0.0)
    with pytest.raises(InputError, match=r"at most 0\.01 s"):
        PhysicsSettings(0.05)


def test_without_mujoco_it_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(MissingExtra, match=r"needs the package 'mujoco-core': pip install 'terrafuse\[sim\]'"):
        alone(LEVEL, "summit_xl")


def test_mujoco_is_loaded_with_the_first_robots() -> None:
    program = "import sys, terrafuse.simulate.physics; print('mujoco' in sys.modules)"
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "False"
