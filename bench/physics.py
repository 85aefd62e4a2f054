"""python -m bench.physics [--json FILE] [--seconds S]: robots with real physics.

How fast: Summit XLs go to and fro on streets at 1.5 m/s among the village's 781 houses and all that moves, on one
thread. How many seconds of theirs pass in a second of the processor's, for 3 and 10 of them, for steps of 5 and 2 ms
and commands 10 and 50 times a second; and how long the village takes to be taken in. Times are the thread's own
(processor time), so that others on the machine count less.

How true: what speed and yaw rate each body keeps on level ground, against what it is told; and on the village's ground,
how far its height and tilt are from those of the plane under its wheels, on which `motion` puts it.
"""

from __future__ import annotations

import platform
from typing import Any

import numpy as np

from bench.report import parser, tell
from bench.simulate_rays import timed
from terrafuse.simulate.motion import BODIES, Command, Ground, State, placed, step
from terrafuse.simulate.physics import Physics, PhysicsSettings
from terrafuse.simulate.routes import Routes, at_start, pursue, routes_of
from terrafuse.simulate.terrain import flat
from terrafuse.simulate.world import World
from terrafuse.simulate.worlds.village import village
from terrafuse.types import Bounds

BODY = BODIES["summit_xl"]
LEVEL = Bounds(-50.0, -50.0, 50.0, 50.0)
ROBOTS, STEPS_S, RATES_HZ, SPEED_MPS = (3, 10), (0.005, 0.002), (10, 50), 1.5


def started(world: World, count: int) -> tuple[State, Routes]:
    """Each robot in the middle of a street of its own; it goes to one end, to the other, and so on."""
    streets = world.streets.segments_m.reshape(-1, 2, 2)
    ends = streets[np.linspace(0, len(streets) - 1, count).astype(int)]
    starts = ends.mean(axis=1)
    ahead = ends[:, 1] - starts
    ways = [[start, *[b, a] * 5] for start, (a, b) in zip(starts, ends, strict=True)]
    state = placed(Ground(world.terrain.height), BODY, starts, np.arctan2(ahead[:, 1], ahead[:, 0]))
    return state, routes_of(ways, BODY)


def run(world: World, count: int, settings: PhysicsSettings, rate_hz: int, seconds: float) -> dict[str, float]:
    state, routes = started(world, count)
    physics = Physics(world, {"r": "summit_xl"}, {"r": state}, settings=settings)
    progress, spent, touched, first = at_start(routes), 0.0, 0, state
    for k in range(round(seconds * rate_hz)):
        command, progress = pursue(state, routes, progress, BODY, SPEED_MPS)
        now = k / rate_hz
        states, took = timed(lambda c=command, t=now: physics.step({"r": c}, 1 / rate_hz, t))
        state, spent = states["r"], spent + took
        touched += int(state.blocked.sum())
    way_m = np.hypot(*(state.position_m - first.position_m)[:, :2].T)
    return {
        "times_real_time": seconds / spent,
        "way_m": float(way_m.mean()),
        "share_of_steps_in_contact": touched / (count * round(seconds * rate_hz)),
    }


def steady(body: str, speed_mps: float, yaw_rate_radps: float) -> tuple[float, float]:
    """Speed and yaw rate of one on level ground, over the last 2 of 5 s."""
    world = World("level", LEVEL, flat(LEVEL))
    state = placed(Ground(world.terrain.height), BODIES[body], [(0.0, 0.0)], [0.0])
    physics, command = Physics(world, {"r": body}, {"r": state}), told(speed_mps, yaw_rate_radps)
    states = [physics.step({"r": command}, 0.1, k * 0.1)["r"] for k in range(50)][30:]
    return tuple(float(np.mean([getattr(s, of)[0] for s in states])) for of in ("speed_mps", "yaw_rate_radps"))


def told(speed_mps: float, yaw_rate_radps: float) -> Command:
    return Command(np.array([speed_mps]), np.array([yaw_rate_radps]), 3.0)


def errors() -> dict[str, Any]:
    """Of each body, in percent of what it is told: speed straight ahead, yaw rate on the spot, both on a curve."""
    out = {}
    for name, body in BODIES.items():
        speed, turn = min(body.max_speed_mps, 1.0), min(body.max_yaw_rate_radps, 1.0)
        half = steady(name, speed / 2, turn / 2)
        out[name] = {
            "speed_percent": percent(steady(name, speed, 0.0)[0], speed),
            "slow_turn_percent": percent(steady(name, 0.0, 0.1)[1], 0.1),
            "turn_percent": percent(steady(name, 0.0, turn)[1], turn),
            "curve_speed_percent": percent(half[0], speed / 2),
            "curve_turn_percent": percent(half[1], turn / 2),
        }
    fast = steady("summit_xl", 2.0, 1.2)
    out["summit_xl"] |= {"fast_curve_percent": [percent(fast[0], 2.0), percent(fast[1], 1.2)]}
    return out


def percent(is_: float, wanted: float) -> float:
    return round(100 * (is_ / wanted - 1), 2)


def on_the_ground(world: World, seconds: float) -> dict[str, float]:
    """Over ten robots on streets: their height above the ground under their middle, and their tilt against the plane of
    their wheels; and how far off they would have ended by the same commands without forces."""
    ground = Ground(world.terrain.height)
    state, routes = started(world, 10)
    physics, progress, off, other = Physics(world, {"r": "summit_xl"}, {"r": state}), at_start(routes), [], state
    for k in range(round(seconds * 10)):
        command, progress = pursue(state, routes, progress, BODY, SPEED_MPS)
        state, other = physics.step({"r": command}, 0.1, k * 0.1)["r"], step(other, command, 0.1, ground, BODY)
        plane = placed(ground, BODY, state.position_m[:, :2], state.yaw_rad)
        z_m = state.position_m[:, 2] - plane.position_m[:, 2]
        off.append(np.column_stack([z_m, state.roll_rad - plane.roll_rad, state.pitch_rad - plane.pitch_rad]))
    all_ = np.concatenate(off) * [1e3, np.degrees(1), np.degrees(1)]
    names = "height_mm", "roll_deg", "pitch_deg"
    return {
        **{f"{name}_rms": float(v) for name, v in zip(names, np.sqrt((all_**2).mean(axis=0)), strict=True)},
        **{f"{name}_most": float(v) for name, v in zip(names, np.abs(all_).max(axis=0), strict=True)},
        "without_forces_apart_m": float(np.hypot(*(state.position_m - other.position_m)[:, :2].T).mean()),
    }


def measure(seconds: float) -> dict[str, Any]:
    world, made_s = timed(lambda: village(0))
    state, _ = started(world, 1)
    _, taken_s = timed(lambda: Physics(world, {"r": "summit_xl"}, {"r": state}))
    runs = {
        f"{count} robots, {step_s * 1000:g} ms, {rate_hz} Hz": run(
            world, count, PhysicsSettings(step_s), rate_hz, seconds
        )
        for count in ROBOTS
        for step_s in STEPS_S
        for rate_hz in RATES_HZ
    }
    return {
        "machine": f"{platform.machine()}, Python {platform.python_version()}, NumPy {np.__version__}",
        "village": {"houses": len(world.houses), "blocks": len(world.blocks), "movers": len(world.movers)},
        "seconds_to_make": made_s,
        "seconds_to_take_in": taken_s,
        "runs": runs,
        "errors": errors(),
        "off_the_plane_of_wheels": on_the_ground(world, seconds),
    }


def main() -> None:
    arguments_of = parser(__doc__)
    arguments_of.add_argument("--seconds", type=float, default=20.0)
    arguments = arguments_of.parse_args()
    tell(measure(arguments.seconds), arguments.json)


if __name__ == "__main__":
    main()
