"""Following a route: pure pursuit (Coulter 1992), for many robots at once.

Each robot steers for a point on its route a little ahead, along the arc that leads there. It slows down in time for
bends and for the end, and where it looks elsewhere.
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
AHEAD_S = 1.0
"""It steers for where it would be then, but for no point nearer or further than these:"""
MIN_AHEAD_M, MAX_AHEAD_M = 0.5, 2.0
TURNS = 8 / 3
"""But never nearer than it comes in so many times the time that it takes to turn at its fastest: it would swerve to and
fro."""
TURN_ON_THE_SPOT_RAD = pi / 3
"""It stands still to turn towards a point further aside."""
TURN_HZ = 2.0
"""Turning on the spot, it aims for this many times the missing angle a second."""
ARRIVED_M = 0.15
BEND_M = 0.5
"""A corner counts as a bend over this much of the route before and after it."""


@dataclass(frozen=True, eq=False)
class Routes:
    """A route for each of N robots: points (M, 2) STEP_M apart, of robot n those from starts[n] to starts[n + 1].

    `fastest_mps` (M,): at which bends can be taken, and from which what comes can be braked for.
    """

    points_m: Floats
    fastest_mps: Floats
    starts: Array

    @property
    def lengths(self) -> Array:
        return np.diff(self.starts)


def routes_of(ways_m: Sequence[ArrayLike], body: Body) -> Routes:
    """Routes along waypoints (K, 2), one list a robot. Raises InputError for one without a finite point."""
    ways = [_dense(np.asarray(way, np.float64).reshape(-1, 2), n) for n, way in enumerate(ways_m)]
    fastest = [_fastest_mps(way, body) for way in ways]
    starts = np.concatenate([[0], np.cumsum([len(way) for way in ways])])
    return Routes(np.concatenate(ways), np.concatenate(fastest), starts)


def _dense(way: Floats, robot: int) -> Floats:
    """The same way in points STEP_M apart or a little less, the last one included."""
    if not len(way) or not np.isfinite(way).all():
        raise InputError(f"route of robot {robot}: give at least one waypoint, and finite metres")
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way, axis=0).T))])
    at = np.linspace(0, along[-1], 1 + ceil(along[-1] / STEP_M))
    return np.column_stack([np.interp(at, along, axis) for axis in way.T])


def _fastest_mps(points: Floats, body: Body) -> Floats:
    """With half of the brakes: v² ≤ v'² + a·d for what comes, d metres ahead, at v'."""
    if len(points) < 2:
        return np.full(len(points), body.max_speed_mps)
    over = round(BEND_M / STEP_M)
    ways = np.diff(points, axis=0)[np.clip(np.arange(-over, len(points) + over), 0, len(points) - 2)]
    before, after = ways[: len(points)], ways[2 * over :]
    turn = np.abs(np.arctan2(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0], (before * after).sum(axis=1)))
    bend2 = (body.max_yaw_rate_radps * 2 * BEND_M / np.maximum(turn, 1e-9)) ** 2
    gained = body.max_mps2 * STEP_M * np.arange(len(points))
    return np.asarray(np.sqrt(np.minimum.accumulate((bend2 + gained)[::-1])[::-1] - gained))


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
    along_mps, turns_s = np.abs(state.speed_mps), body.max_yaw_rate_radps / body.max_yaw_radps2
    ahead_m = np.maximum(np.clip(along_mps * AHEAD_S, MIN_AHEAD_M, MAX_AHEAD_M), TURNS * turns_s * along_mps)
    aim = _of_points(routes.points_m, routes, at + np.ceil(ahead_m / STEP_M).astype(np.int64)) - here
    aside_rad = (np.arctan2(aim[:, 1], aim[:, 0]) - state.yaw_rad + pi) % (2 * pi) - pi
    distance_m = np.maximum(np.hypot(*aim.T), 1e-6)
    # The arc through here, along the heading, to the aim: its curvature is 2 sin(α)/L.
    curvature = 2 * np.sin(aside_rad) / distance_m
    arrived = left_m <= ARRIVED_M
    speed = np.minimum(
        _speed(body, speed_mps, left_m, curvature, aside_rad), _of_points(routes.fastest_mps, routes, at)
    )
    turning = np.abs(aside_rad) > TURN_ON_THE_SPOT_RAD
    speed = np.where(turning | arrived, 0.0, speed)
    yaw_rate = np.where(arrived, 0.0, np.where(turning, TURN_HZ * aside_rad, curvature * speed))
    return Command(speed, yaw_rate, altitude_m), Progress(at, arrived & (np.abs(state.speed_mps) < 1e-3))


def _speed(body: Body, wanted_mps: Floats | float, left_m: Floats, curvature: Floats, aside_rad: Floats) -> Floats:
    """As fast as it may be here: it stops at the end with half of the brakes, and it can turn as the arc does."""
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


def _of_points(values: Floats, routes: Routes, at: Array) -> Floats:
    """Of each route the value at its point `at`, or at its last one."""
    return np.asarray(values[routes.starts[:-1] + np.minimum(at, routes.lengths - 1)])
