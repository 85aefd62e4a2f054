"""Wander, as the robots of the *database* paper do: no goal and no plan, obstacles are avoided by the last readings.

A robot follows a whim, a compass heading that it keeps for a while: it goes in the free direction nearest to that. So
it crosses rooms and slides along walls. Where a wall beside it ends, it is curious what is behind: that takes it
through doors, less often through those behind which all is on the shared map already. Where a whim ends in a corner, it
mostly goes on along the next wall. Other whims are drawn at random, so it does not circle for ever.
"""

from __future__ import annotations

import math
from collections import Counter
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from terrafuse.simulate.mission.behaviours.avoidance import (
    NARROW_M,
    THROUGH_M,
    Echoes,
    drive_towards,
    free_ways_m,
    nearest_free_rad,
    wrapped,
)
from terrafuse.simulate.mission.fleet import Drive
from terrafuse.simulate.mission.situation import Situation
from terrafuse.simulate.quantities import Delay, Number, Period, Place, Share, Speed
from terrafuse.simulate.scenario.model import Part
from terrafuse.types import Bounds, Floats

BACK_MPS, BACK_S = -0.2, 0.8
LEAST_WHIM_S = 4.0
BESIDE_M = 0.8
"""A wall beside the robot is no further from its body than this."""
BEHIND_M = 1.3
"""It goes so far into an opening, at least,"""
THERE_M = 0.3
"""give or take this,"""
OPENING_S = 8.0
"""unless that takes longer."""
AHEAD_M, PATCH_M, KNOWN = 2.5, 0.75, 0.5
"""What the shared map knows of a square of twice `PATCH_M`, so far away, decides; from `KNOWN` on it is nothing new."""
PUSH_RAD = math.radians(30)
"""Who goes along a wall heads so much towards it."""
SIDES_RAD = np.array([math.pi / 2, -math.pi / 2])


Turn = Annotated[Number, Field(gt=0, le=360)]


class WanderSettings(Part):
    speed_mps: Speed = 0.4
    whim_s: Period = 20.0
    """How long it keeps a heading, on average."""
    most_turn_deg: Turn = 150.0
    """A new heading is at most this far from where it looks."""
    give_up_deg: Turn = 100.0
    """It drops a whim that would take it further off than this: a corner, a dead end."""
    curiosity: Share = 0.9
    """The chance that it goes into an opening beside it, if the shared map is mostly blank there,"""
    boredom: Share = 0.4
    """and if it is not."""
    follow: Share = 0.75
    """The chance that it goes on along the next wall, where it drops a whim in a corner."""
    memory_s: Delay = 3.0
    """How long it remembers what its readings met."""


class Wander:
    """One robot on its ways."""

    def __init__(self, settings: WanderSettings, rng: np.random.Generator) -> None:
        self.settings = settings
        self.counts: Counter[str] = Counter(whims=0, given_up=0, openings=0, bumps=0)
        self._rng = rng
        self._echoes = Echoes(settings.memory_s)
        self._heading_rad, self._first, self._until_s = 0.0, 1, -math.inf
        self._back_until_s = -math.inf
        self._opening_m: Place | None = None
        self._walled = np.zeros(2, bool)

    def facts(self) -> dict[str, Any]:
        return dict(self.counts)

    def drive(self, me: Situation) -> Drive:
        places = self._echoes.around(me)
        if me.stopped and me.now_s >= self._back_until_s + BACK_S:
            self._bump(me)
        if me.now_s < self._back_until_s:
            return Drive(BACK_MPS, 0.0)
        if me.now_s >= self._until_s:
            self._draw(me)
        self._look_aside(me, places)
        self._enter(me)
        return self._go(me, places)

    def _go(self, me: Situation, places: Floats) -> Drive:
        way = nearest_free_rad(me, places, wrapped(self._heading_rad - me.yaw_rad), self._first)
        if way is None:
            return Drive(0.0, self._first * me.body.max_yaw_rate_radps / 2)
        if abs(wrapped(me.yaw_rad + way - self._heading_rad)) > math.radians(self.settings.give_up_deg):
            self._give_up(me, me.yaw_rad + way)
        return drive_towards(me, places, way, self.settings.speed_mps)

    def _give_up(self, me: Situation, way_rad: float) -> None:
        self.counts["given_up"] += 1
        if self._rng.random() >= self.settings.follow:
            self._draw(me)
            return
        wall_side = 1 if wrapped(self._heading_rad - way_rad) > 0 else -1
        self._whim(me, way_rad + wall_side * PUSH_RAD)
        self._first = -wall_side

    def _bump(self, me: Situation) -> None:
        self.counts["bumps"] += 1
        self._echoes.bumped(me)
        self._back_until_s = me.now_s + BACK_S

    def _draw(self, me: Situation) -> None:
        """A new whim."""
        self.counts["whims"] += 1
        most = math.radians(self.settings.most_turn_deg)
        self._whim(me, me.yaw_rad + self._rng.uniform(-most, most))

    def _whim(self, me: Situation, heading_rad: float) -> None:
        self._opening_m = None
        self._heading_rad = wrapped(heading_rad)
        self._first = 1 if self._rng.random() < 0.5 else -1
        self._until_s = me.now_s + LEAST_WHIM_S + float(self._rng.exponential(self.settings.whim_s))

    def _look_aside(self, me: Situation, places: Floats) -> None:
        """Where a wall beside it has just ended, an opening may be worth a visit."""
        free_m = free_ways_m(places, me.body.radius_m + NARROW_M, SIDES_RAD) - me.body.radius_m
        opened = np.flatnonzero(self._walled & (free_m > THROUGH_M))
        self._walled = free_m < BESIDE_M
        if len(opened) and self._opening_m is None and me.now_s > self._back_until_s + BACK_S:
            direction = me.yaw_rad + float(SIDES_RAD[opened[0]])
            news = me.known_share(_patch(me, direction, AHEAD_M)) < KNOWN
            if self._rng.random() < (self.settings.curiosity if news else self.settings.boredom):
                self.counts["openings"] += 1
                self._whim(me, direction)
                self._opening_m = _ahead(me, direction, BEHIND_M)
                self._until_s = max(self._until_s, me.now_s + OPENING_S)

    def _enter(self, me: Situation) -> None:
        """Steer for the place behind an opening until it is there."""
        if self._opening_m is None:
            return
        east_m, north_m = np.subtract(self._opening_m, me.place_m).tolist()
        if math.hypot(east_m, north_m) < THERE_M:
            self._opening_m = None
        else:
            self._heading_rad = math.atan2(north_m, east_m)


def _ahead(me: Situation, direction_rad: float, metres: float) -> Place:
    east_m, north_m = me.place_m
    return east_m + metres * math.cos(direction_rad), north_m + metres * math.sin(direction_rad)


def _patch(me: Situation, direction_rad: float, metres: float) -> Bounds:
    """The ground around a place in a direction of the world."""
    east_m, north_m = _ahead(me, direction_rad, metres)
    return Bounds(east_m - PATCH_M, north_m - PATCH_M, east_m + PATCH_M, north_m + PATCH_M)
