"""How robots move, without forces: within their limits, on the ground or above it, and never into anything.

Pure functions over frozen values, for N robots of one body at a time; each field of a state is an array with a robot a
row. `step` moves them as commanded, `routes.pursue` commands them along routes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import ceil, pi
from types import MappingProxyType
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from terrafuse.errors import InputError
from terrafuse.navigate.pose_filter import rotation
from terrafuse.types import Array, Floats, Pose, pose_of

PROBE_M = 0.1
"""Collisions are looked for at places this far apart, on the way and on the rim."""


@dataclass(frozen=True)
class Ground:
    """What robots move on. Both take arrays (N, K) of x and y, the rows being the robots, and give such arrays."""

    height: Callable[[Floats, Floats], Floats]
    """z in metres, NaN where there is no ground; nobody goes there."""
    blocked: Callable[[Floats, Floats], Array] = lambda x_m, y_m: np.zeros(np.shape(x_m), bool)
    """Where no robot may be. It may differ by row: a robot does not block itself, a drone passes over a car."""


@dataclass(frozen=True, eq=False)
class State:
    """N robots: `position_m` (N, 3) and (N,) of all else. Roll and pitch as in ROS: right side down, nose down."""

    position_m: Floats
    yaw_rad: Floats
    roll_rad: Floats
    pitch_rad: Floats
    speed_mps: Floats
    """Along the ground."""
    yaw_rate_radps: Floats
    climb_mps: Floats
    """Of what flies."""
    blocked: Array
    """Whether the last step was cut short by something in the way."""

    def __len__(self) -> int:
        return len(self.yaw_rad)

    def pose(self, robot: int) -> Pose:
        """T_world_base of one of them."""
        turn = rotation(float(self.roll_rad[robot]), float(self.pitch_rad[robot]), float(self.yaw_rad[robot]))
        return pose_of(turn, self.position_m[robot])


@dataclass(frozen=True, eq=False)
class Command:
    """What each of N robots shall do; limits are the body's. `altitude_m`, above ground, is for what flies."""

    speed_mps: Floats
    yaw_rate_radps: Floats
    altitude_m: Floats | float = 0.0


class Carriage(Protocol):
    """What keeps a robot where it is in height."""

    def passable(self, heights_m: Floats, z_m: Floats) -> Array:
        """Whether a robot at height z (N, 1) gets over ground of these heights (N, K)."""

    def settle(
        self, ground: Ground, xy_m: Floats, before: State, yaw_rad: Floats, altitude_m: Floats, dt_s: float
    ) -> tuple[Floats, Floats, Floats, Floats]:
        """z, roll, pitch and climb, (N,) each, of robots that are now at xy (N, 2)."""


@dataclass(frozen=True)
class Wheels:
    """Stands on the ground, as its wheels do."""

    wheelbase_m: float
    track_m: float

    def passable(self, heights_m: Floats, z_m: Floats) -> Array:
        return np.isfinite(heights_m)

    def settle(
        self, ground: Ground, xy_m: Floats, before: State, yaw_rad: Floats, altitude_m: Floats, dt_s: float
    ) -> tuple[Floats, Floats, Floats, Floats]:
        forward, left = self._slopes(ground, xy_m, yaw_rad)
        # Rz·Ry·Rx takes x to the slope ahead, and z to the normal (-forward, -left, 1) of the plane of the wheels.
        return _heights(ground, xy_m), np.arctan2(left, np.hypot(1, forward)), -np.arctan(forward), np.zeros(len(xy_m))

    def _slopes(self, ground: Ground, xy_m: Floats, yaw_rad: Floats) -> tuple[Floats, Floats]:
        """Rise per metre ahead and to the left, from the ground under the middles of the four sides."""
        ahead = np.column_stack([np.cos(yaw_rad), np.sin(yaw_rad)])
        left = np.column_stack([-ahead[:, 1], ahead[:, 0]])
        ways = [(ahead, self.wheelbase_m), (left, self.track_m)]
        rise = [
            (_heights(ground, xy_m + way * side / 2) - _heights(ground, xy_m - way * side / 2)) / side
            for way, side in ways
        ]
        return rise[0], rise[1]


@dataclass(frozen=True)
class Rotors:
    """Flies level at a height above the ground below, which it approaches as fast as it can climb.

    Ground that comes nearer from below than `clearance_m` is in its way.
    """

    max_climb_mps: float
    max_climb_mps2: float
    clearance_m: float
    gain_hz: float = 1.0
    """It climbs this many times the missing height a second."""

    def passable(self, heights_m: Floats, z_m: Floats) -> Array:
        return np.asarray(heights_m <= z_m - self.clearance_m)

    def settle(
        self, ground: Ground, xy_m: Floats, before: State, yaw_rad: Floats, altitude_m: Floats, dt_s: float
    ) -> tuple[Floats, Floats, Floats, Floats]:
        below_m, z_m = _heights(ground, xy_m), before.position_m[:, 2]
        wanted = np.clip(self.gain_hz * (below_m + altitude_m - z_m), -self.max_climb_mps, self.max_climb_mps)
        climb = _approached(before.climb_mps, wanted, self.max_climb_mps2 * dt_s)
        risen_m = z_m + (before.climb_mps + climb) / 2 * dt_s
        level = np.zeros(len(xy_m))
        return np.maximum(risen_m, below_m), level, level, np.where(risen_m > below_m, climb, 0.0)


@dataclass(frozen=True)
class Body:
    """A kind of robot and its limits."""

    radius_m: float
    """Of the disc that must be free."""
    max_speed_mps: float
    """Of each wheel, so in turns the robot as a whole is slower."""
    max_mps2: float
    max_yaw_rate_radps: float
    max_yaw_radps2: float
    carriage: Carriage
    axle_m: float = 0.0
    """Between its left and right wheels."""


BODIES: Mapping[str, Body] = MappingProxyType(
    {
        # Robotnik Summit XL: 0.72 m × 0.61 m, four wheels, steers by skidding, 3 m/s.
        "summit_xl": Body(0.47, 3.0, 1.5, 1.5, 6.0, Wheels(0.45, 0.47), axle_m=0.47),
        # Nomad: round, 21 inches wide, 24 inches a second.
        "nomad": Body(0.267, 0.61, 0.5, 1.05, 2.0, Wheels(0.4, 0.4), axle_m=0.4),
        "soccer": Body(0.2, 2.0, 2.0, 4.0, 12.0, Wheels(0.3, 0.3), axle_m=0.3),
        "drone": Body(0.4, 8.0, 3.0, 1.5, 3.0, Rotors(3.0, 3.0, clearance_m=0.4)),
    }
)


def placed(ground: Ground, body: Body, xy_m: ArrayLike, yaw_rad: ArrayLike) -> State:
    """Robots that stand at xy (N, 2), looking along yaw (N,). Raises InputError where something is in the place."""
    xy, yaw = np.asarray(xy_m, np.float64).reshape(-1, 2), np.asarray(yaw_rad, np.float64).reshape(-1)
    still = np.zeros(len(yaw))
    on_ground = np.column_stack([xy, _heights(ground, xy)])
    state = State(on_ground, yaw, still, still, still, still, still, still.astype(bool))
    for robot in np.flatnonzero(in_the_way(ground, body, xy)):
        raise InputError(f"robot {robot} at {tuple(xy[robot].tolist())}: something is in its place; choose a free one")
    _, roll, pitch, _ = body.carriage.settle(ground, xy, state, yaw, still, 0.0)
    return State(on_ground, yaw, roll, pitch, still, still, still, still.astype(bool))


def in_the_way(ground: Ground, body: Body, xy_m: ArrayLike) -> Array:
    """(N,) how many of the points on the rim of robots at xy (N, 2), and their centre, are in something."""
    heights_m, blocked = _around(ground, body, np.asarray(xy_m, np.float64).reshape(-1, 1, 2))
    return np.asarray((blocked | ~np.isfinite(heights_m)).sum(axis=(1, 2)))


def step(state: State, command: Command, dt_s: float, ground: Ground, body: Body) -> State:
    """The robots `dt_s` later: along an arc of the speed and yaw rate that limits allow, as far as it is free.

    A robot that meets something stops in the last free place, within PROBE_M of it, and says so.
    """
    speed, yaw_rate = within_limits(state.speed_mps, state.yaw_rate_radps, command, dt_s, body)
    forward_m = (state.speed_mps + speed) / 2 * dt_s * np.cos(state.pitch_rad)
    turn_rad = (state.yaw_rate_radps + yaw_rate) / 2 * dt_s
    # As many places for all, whatever their speed: a robot's way does not depend on who moves beside it.
    shares = np.linspace(0, 1, 1 + ceil(body.max_speed_mps * dt_s / PROBE_M))
    places = _arc(state, forward_m[:, None] * shares, turn_rad[:, None] * shares)
    last = _last_free(ground, body, state, places)
    robots, stopped = np.arange(len(state)), last < len(shares) - 1
    xy, yaw = places[robots, last], (state.yaw_rad + turn_rad * shares[last] + pi) % (2 * pi) - pi
    z, roll, pitch, climb = body.carriage.settle(ground, xy, state, yaw, np.asarray(command.altitude_m), dt_s)
    moving = ~stopped
    return State(np.column_stack([xy, z]), yaw, roll, pitch, speed * moving, yaw_rate * moving, climb, stopped)


def within_limits(
    speed_mps: Floats, yaw_rate_radps: Floats, command: Command, dt_s: float, body: Body
) -> tuple[Floats, Floats]:
    """Speed and yaw rate at the end of the step; where a wheel would be too fast, both shrink and the curve stays."""
    speed = np.clip(command.speed_mps, -body.max_speed_mps, body.max_speed_mps)
    yaw_rate = np.clip(command.yaw_rate_radps, -body.max_yaw_rate_radps, body.max_yaw_rate_radps)
    fastest = np.abs(speed) + np.abs(yaw_rate) * body.axle_m / 2
    shrink = np.minimum(1, body.max_speed_mps / np.maximum(fastest, 1e-9))
    return (
        _approached(speed_mps, speed * shrink, body.max_mps2 * dt_s),
        _approached(yaw_rate_radps, yaw_rate * shrink, body.max_yaw_radps2 * dt_s),
    )


def _approached(value: Floats, wanted: Floats, most: float) -> Floats:
    return value + np.clip(wanted - value, -most, most)


def _arc(state: State, forward_m: Floats, turn_rad: Floats) -> Floats:
    """(N, S, 2): where robots come by going this far (N, S) while turning this much, evenly."""
    h = turn_rad / 2
    chord = forward_m * np.sinc(h / pi)
    heading = state.yaw_rad[:, None] + h
    return state.position_m[:, None, :2] + np.stack([chord * np.cos(heading), chord * np.sin(heading)], axis=-1)


def _last_free(ground: Ground, body: Body, state: State, places: Floats) -> Array:
    """(N,) the last of each robot's places (N, S, 2) before one that is less free than the first, where it is."""
    z_m = state.position_m[:, 2][:, None, None]
    heights_m, blocked = _around(ground, body, places)
    touching = blocked.sum(axis=2)
    # What came into its place, it may leave: no more of it than now may be in something.
    stands = touching[:, 1:] > touching[:, :1]
    # A robot that only turns is as free as it was.
    moves = (places[:, 1:] != places[:, :1]).any(axis=2)
    stands |= moves & ~body.carriage.passable(heights_m[:, 1:], z_m).all(axis=2)
    return np.asarray(np.where(stands.any(axis=1), stands.argmax(axis=1), stands.shape[1]))


def _around(ground: Ground, body: Body, places: Floats) -> tuple[Floats, Array]:
    """Height, and whether it is blocked, (N, S, K), at the centre and on the rim of robots at places (N, S, 2)."""
    rim = np.linspace(0, 2 * pi, max(8, ceil(2 * pi * body.radius_m / PROBE_M)), endpoint=False)
    disc = body.radius_m * np.vstack([[0.0, 0.0], np.column_stack([np.cos(rim), np.sin(rim)])])
    probes = places[:, :, None] + disc
    x, y = probes.reshape(len(places), -1, 2).transpose(2, 0, 1)
    shape = probes.shape[:3]
    return ground.height(x, y).reshape(shape), np.asarray(ground.blocked(x, y), bool).reshape(shape)


def _heights(ground: Ground, xy_m: Floats) -> Floats:
    return np.asarray(ground.height(xy_m[:, :1], xy_m[:, 1:]))[:, 0]
