"""Following a route: pure pursuit (Coulter 1992), for many robots at once.

Each robot steers for a point on its route a little ahead, along the arc that leads there, and is slower where the route
bends, towards its end, and where it looks elsewhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, pi

import numpy as np
from numpy.typing import ArrayLike

from terrafuse.errors import InputError
from terrafuse.simulate.motion import Body, Command, State
from terrafuse.types import Array, Floats

STEP_M = 0.1
"""Between neighbouring points of a route."""
SEARCH_M = 2.0
"""The nearest point is looked for this far ahead of the last one: routes may cross themselves."""
AHEAD_S = 0.5
"""It steers for where it would be then, but for no point nearer or further than these:"""
MIN_AHEAD_M, MAX_AHEAD_M = 0.4, 2.0
TURN_ON_THE_SPOT_RAD = pi / 3
"""It stands still to turn towards a point further aside."""
TURN_HZ = 2.0
"""Turning on the spot, it aims for this many times the missing angle a second."""
ARRIVED_M = 0.15


@dataclass(frozen=True, eq=False)
class Routes:
    """A route for each of N robots: points (M, 2) STEP_M apart, of robot n those from starts[n] to starts[n + 1]."""

    points_m: Floats
    starts: Array

    @property
    def lengths(self) -> Array:
        return np.diff(self.starts)


def routes_of(ways_m: Sequence[ArrayLike]) -> Routes:
    """Routes along waypoints (K, 2), one list a robot. Raises InputError for one without a finite point."""
    ways = [_dense(np.asarray(way, np.float64).reshape(-1, 2), n) for n, way in enumerate(ways_m)]
    return Routes(np.concatenate(ways), np.concatenate([[0], np.cumsum([len(way) for way in ways])]))


def _dense(way: Floats, robot: int) -> Floats:
    """The same way in points STEP_M apart or a little less, the last one included."""
    if not len(way) or not np.isfinite(way).all():
        raise InputError(f"route of robot {robot}: give at least one waypoint, and finite metres")
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way, axis=0).T))])
    at = np.linspace(0, along[-1], 1 + ceil(along[-1] / STEP_M))
    return np.column_stack([np.interp(at, along, axis) for axis in way.T])


@dataclass(frozen=True, eq=False)
class Progress:
    """How far along its route each robot is: `at` (N,) counts points. `arrived` (N,): at the end, and standing."""

    at: Array
    arrived: Array


def at_start(routes: Routes) -> Progress:
    return Progress(np.zeros(len(routes.lengths), np.int64), np.zeros(len(routes.lengths), bool))


def pursue(
    state: State,
    routes: Routes,
    progress: Progress,
    body: Body,
    speed_mps: Floats | float,
    altitude_m: Floats | float = 0.0,
) -> tuple[Command, Progress]:
    """What to do to follow the routes at no more than `speed_mps`."""
    at = _nearest(state, routes, progress.at)
    here = state.position_m[:, :2]
    end = routes.points_m[routes.starts[1:] - 1]
    left_m = np.maximum((routes.lengths - 1 - at) * STEP_M, np.hypot(*(end - here).T))
    ahead_m = np.clip(np.abs(state.speed_mps) * AHEAD_S, MIN_AHEAD_M, MAX_AHEAD_M)
    aim = _points(routes, at + np.ceil(ahead_m / STEP_M).astype(np.int64)) - here
    aside_rad = (np.arctan2(aim[:, 1], aim[:, 0]) - state.yaw_rad + pi) % (2 * pi) - pi
    distance_m = np.maximum(np.hypot(*aim.T), 1e-6)
    # The arc through here, along the heading, to the aim: its curvature is 2 sin(α)/L.
    curvature = 2 * np.sin(aside_rad) / distance_m
    arrived = left_m <= ARRIVED_M
    speed = _speed(body, speed_mps, left_m, curvature, aside_rad)
    turning = np.abs(aside_rad) > TURN_ON_THE_SPOT_RAD
    speed = np.where(turning | arrived, 0.0, speed)
    yaw_rate = np.where(arrived, 0.0, np.where(turning, TURN_HZ * aside_rad, curvature * speed))
    return Command(speed, yaw_rate, altitude_m), Progress(at, arrived & (np.abs(state.speed_mps) < 1e-3))


def _speed(body: Body, wanted_mps: Floats | float, left_m: Floats, curvature: Floats, aside_rad: Floats) -> Floats:
    """As fast as it may be here: with half of the brakes it still stops at the end, and it can turn as the arc does."""
    bend = body.max_yaw_rate_radps / np.maximum(np.abs(curvature), 1e-9)
    brake = np.sqrt(body.max_mps2 * left_m)
    most: Floats = np.minimum.reduce([np.broadcast_to(wanted_mps, left_m.shape), bend, brake])
    return np.asarray(most * np.cos(aside_rad).clip(0.2))


def _nearest(state: State, routes: Routes, at: Array) -> Array:
    """(N,) the point of each route next to its robot, among those not far ahead of the last one."""
    window = at[:, None] + np.arange(1 + ceil(SEARCH_M / STEP_M))
    window = np.minimum(window, routes.lengths[:, None] - 1)
    apart = routes.points_m[routes.starts[:-1, None] + window] - state.position_m[:, None, :2]
    nearest = (apart**2).sum(axis=-1).argmin(axis=1)
    return np.asarray(window[np.arange(len(at)), nearest])


def _points(routes: Routes, at: Array) -> Floats:
    found: Floats = routes.points_m[routes.starts[:-1] + np.minimum(at, routes.lengths - 1)]
    return found
