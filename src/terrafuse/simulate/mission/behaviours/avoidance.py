"""Finding a free way by the last readings: what robots without a map go by.

Sonars hear a wall only square on, so a robot that slides along one no longer hears what it passed a moment ago. It
therefore remembers its readings for some seconds, by its own idea of its motion.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from terrafuse.simulate.mission.fleet import Drive
from terrafuse.simulate.mission.situation import Situation
from terrafuse.types import Floats

WIDE_M, LOOK_M = 0.14, 0.7
"""A way counts as free that leaves so much on either side of the body, for so far beyond it: sonars hear nothing that
is nearer than some 0.15 m, and a robot that slides along a wall shall go on hearing it,"""
NARROW_M, THROUGH_M = 0.05, 1.0
"""or so little for so much further: a door."""
REACH_M = 2.0
"""What is further away does not matter yet."""
STEP_RAD = math.radians(10)
TURN_ON_THE_SPOT_RAD = math.radians(50)
"""What lies further aside is turned to before it drives on."""
TURN_HZ = 2.0
"""It turns at this many times the missing angle a second."""
STOP_M = 0.08


class Echoes:
    """What a robot's readings met in the last seconds."""

    def __init__(self, memory_s: float = 3.0) -> None:
        self._memory_s = memory_s
        self._kept: deque[tuple[float, Floats]] = deque()
        self._newest: Floats | None = None

    def around(self, me: Situation) -> Floats:
        """(K, 2): the places, in its own frame as it is now."""
        if me.obstacles_m is not self._newest:
            self._newest = me.obstacles_m
            self._keep(me, me.obstacles_m)
        while self._kept and self._kept[0][0] < me.now_s - self._memory_s:
            self._kept.popleft()
        places = np.concatenate([np.empty((0, 2)), *(there for _, there in self._kept)]) - me.place_m
        return np.asarray((places @ _turn(me.yaw_rad))[np.hypot(*places.T) < REACH_M])

    def bumped(self, me: Situation) -> None:
        """Its bumper touched something that no reading told of: it counts as one."""
        self._keep(me, np.array([[me.body.radius_m + NARROW_M, 0.0]]))

    def _keep(self, me: Situation, places_m: Floats) -> None:
        self._kept.append((me.now_s, places_m @ _turn(me.yaw_rad).T + me.place_m))


def _turn(yaw_rad: float) -> Floats:
    """(2, 2): what turns a robot's own frame into the world's."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array([[c, -s], [s, c]])


def free_ways_m(places_m: Floats, half_width_m: float, directions_rad: Floats) -> Floats:
    """(D,): how far strips of this half width are free of places (K, 2), from the origin in each direction."""
    c, s = np.cos(directions_rad)[:, None], np.sin(directions_rad)[:, None]
    along = c * places_m[:, 0] + s * places_m[:, 1]
    across = c * places_m[:, 1] - s * places_m[:, 0]
    met = (np.abs(across) <= half_width_m) & (along > 0)
    return np.asarray(np.where(met, along, math.inf).min(axis=1, initial=math.inf))


def nearest_free_rad(me: Situation, places_m: Floats, wanted_rad: float, first: int) -> float | None:
    """Of the directions that are free, in its own frame, that which is nearest to the wanted one; of two that are as
    near, that on the side `first` (1 left, -1 right). None if there is no way out."""
    steps = np.arange(1, round(math.pi / STEP_RAD) + 1)
    offsets = STEP_RAD * np.concatenate([[0], np.stack([first * steps, -first * steps], axis=1).ravel()])
    radius_m = me.body.radius_m
    wide_m, narrow_m = (free_ways_m(places_m, radius_m + m, wanted_rad + offsets) for m in (WIDE_M, NARROW_M))
    free = np.flatnonzero((wide_m > radius_m + LOOK_M) | (narrow_m > radius_m + THROUGH_M))
    return float(wanted_rad + offsets[free[0]]) if len(free) else None


def drive_towards(me: Situation, places_m: Floats, direction_rad: float, speed_mps: float) -> Drive:
    """Turn to a direction of its own frame, and go as fast as it can still stop before what is ahead."""
    error = wrapped(direction_rad)
    yaw_rate = float(np.clip(TURN_HZ * error, -me.body.max_yaw_rate_radps, me.body.max_yaw_rate_radps))
    if abs(error) > TURN_ON_THE_SPOT_RAD:
        return Drive(0.0, yaw_rate)
    ahead_m = float(free_ways_m(places_m, me.body.radius_m + NARROW_M, np.zeros(1))[0])
    gap_m = max(ahead_m - me.body.radius_m - STOP_M, 0.0)
    return Drive(min(speed_mps * math.cos(error), math.sqrt(me.body.max_mps2 * gap_m)), yaw_rate)


def wrapped(angle_rad: float) -> float:
    """The same within ±π."""
    return math.remainder(angle_rad, math.tau)
