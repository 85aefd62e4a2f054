"""python -m bench.physics [--json FILE] [--seconds S]: robots with real physics in the village, on one thread.

Summit XLs go to and fro on streets at 1.5 m/s among 781 houses and all that moves. How many seconds of theirs pass in a
second of the processor's, for 3 and 10 of them, for steps of 5 and 2 ms and commands 10 and 50 times a second; and how
long the village takes to be taken in.

Times are the thread's own (processor time), so that others on the machine count less.
"""

from __future__ import annotations

import platform
from typing import Any

import numpy as np

from bench.report import parser, tell
from bench.simulate_rays import timed
from terrafuse.simulate.motion import BODIES, Ground, State, placed
from terrafuse.simulate.physics import Physics, PhysicsSettings
from terrafuse.simulate.routes import Routes, at_start, pursue, routes_of
from terrafuse.simulate.world import World
from terrafuse.simulate.worlds.village import village

BODY = BODIES["summit_xl"]
ROBOTS, STEPS_S, RATES_HZ, SPEED_MPS = (3, 10), (0.004, 0.002), (10, 50), 1.5


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
    }


def main() -> None:
    arguments_of = parser(__doc__)
    arguments_of.add_argument("--seconds", type=float, default=20.0)
    arguments = arguments_of.parse_args()
    tell(measure(arguments.seconds), arguments.json)


if __name__ == "__main__":
    main()
