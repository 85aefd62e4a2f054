"""Soccer motion, three against three as in the *grey* paper: robots keep the places of their roles around a ball.

The ball is no body in the world. It rolls from one place of the field to the next, drawn with `ball_seed`, so all
robots know where it is, as the paper's do by their cameras. What they avoid, each other and the boards, they avoid by
their readings.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from terrafuse.simulate.mission.behaviours.avoidance import Echoes, drive_towards, nearest_free_rad, wrapped
from terrafuse.simulate.mission.fleet import Drive
from terrafuse.simulate.mission.situation import Situation
from terrafuse.simulate.quantities import Delay, Number, Place, Seed, Speed
from terrafuse.simulate.scenario.model import Part

ROLES = ("keeper", "supporter", "striker")
"""Of the first robot of a team, the second, the third; then from the first again."""
NEAR_BOARD_M = 0.6
"""The ball keeps so far from the boards, and robots' places do."""
THERE_M = 0.15
BACK_MPS, BACK_S = -0.3, 0.5


Side = Annotated[Number, Field(ge=4 * NEAR_BOARD_M, le=1000)]


class SoccerSettings(Part):
    defends: Literal["south", "north"] = "south"
    """The goal that is the team's own."""
    speed_mps: Speed = 0.8
    field_m: tuple[Side, Side] = (6.0, 9.0)
    """East and north, from the origin."""
    ball_mps: Speed = 0.6
    ball_seed: Seed = 0
    """The same for all robots of a game."""
    memory_s: Delay = 0.5
    """How long a robot remembers what its readings met: others move."""


class Ball:
    """Rolls straight from place to place, always as fast."""

    def __init__(self, seed: int, field_m: tuple[float, float], speed_mps: float) -> None:
        self._rng, self._field_m, self._speed_mps = np.random.default_rng(seed), field_m, speed_mps
        self._places: list[Place] = [(field_m[0] / 2, field_m[1] / 2)]
        self._times_s = [0.0]

    def at(self, time_s: float) -> Place:
        """East and north at a time from 0 on."""
        while self._times_s[-1] <= time_s:
            self._roll_on()
        east, north = np.array(self._places).T
        return float(np.interp(time_s, self._times_s, east)), float(np.interp(time_s, self._times_s, north))

    def _roll_on(self) -> None:
        east, north = (float(self._rng.uniform(NEAR_BOARD_M, side - NEAR_BOARD_M)) for side in self._field_m)
        length_m = math.dist((east, north), self._places[-1])
        self._places.append((east, north))
        self._times_s.append(self._times_s[-1] + length_m / self._speed_mps)


def keeper(ball_m: Place, goal_m: Place) -> Place:
    """Half a metre before its goal, towards the ball."""
    return _between(goal_m, ball_m, 0.9 / max(math.dist(ball_m, goal_m), 0.9))


def supporter(ball_m: Place, goal_m: Place) -> Place:
    """Halfway between ball and goal, on the emptier side of the field."""
    east_m, north_m = _between(goal_m, ball_m, 0.5)
    return east_m + (1.2 if ball_m[0] < goal_m[0] else -1.2), north_m


def striker(ball_m: Place, goal_m: Place) -> Place:
    """Just behind the ball, seen from its own goal."""
    return _between(ball_m, goal_m, 0.4 / max(math.dist(ball_m, goal_m), 0.4))


PLACES: dict[str, Callable[[Place, Place], Place]] = {"keeper": keeper, "supporter": supporter, "striker": striker}
"""By role: where the robot should be, of the ball's place and its own goal's."""


def _between(start_m: Place, end_m: Place, share: float) -> Place:
    return start_m[0] + share * (end_m[0] - start_m[0]), start_m[1] + share * (end_m[1] - start_m[1])


class Soccer:
    """One player."""

    def __init__(self, settings: SoccerSettings, rng: np.random.Generator) -> None:
        self.settings = settings
        self.counts: Counter[str] = Counter(bumps=0)
        self._echoes = Echoes(settings.memory_s)
        self._first = 1 if rng.random() < 0.5 else -1
        self._ball = Ball(settings.ball_seed, settings.field_m, settings.ball_mps)
        self._back_until_s = -math.inf

    def facts(self) -> dict[str, Any]:
        return dict(self.counts)

    def drive(self, me: Situation) -> Drive:
        places = self._echoes.around(me)
        if me.stopped and me.now_s >= self._back_until_s + BACK_S:
            self.counts["bumps"] += 1
            self._back_until_s = me.now_s + BACK_S
        if me.now_s < self._back_until_s:
            return Drive(BACK_MPS, 0.0)
        east_m, north_m = np.subtract(self.goes_to(me), me.place_m).tolist()
        if math.hypot(east_m, north_m) < THERE_M:
            return Drive()
        wanted_rad = wrapped(math.atan2(north_m, east_m) - me.yaw_rad)
        way = nearest_free_rad(me, places, wanted_rad, self._first)
        if way is None:
            return Drive(0.0, self._first * me.body.max_yaw_rate_radps / 4)
        return drive_towards(me, places, way, min(self.settings.speed_mps, 2 * math.hypot(east_m, north_m)))

    def goes_to(self, me: Situation) -> Place:
        """The place of its role, within the field."""
        east, north = self.settings.field_m
        goal_m = east / 2, 0.0 if self.settings.defends == "south" else north
        place_m = PLACES[role_of(me.name)](self._ball.at(me.now_s), goal_m)
        return _inside(place_m[0], east), _inside(place_m[1], north)


def role_of(name: str) -> str:
    """By the number at the end of a robot's name, from 1 on."""
    number = re.search(r"\d+$", name)
    return ROLES[(int(number.group()) - 1) % len(ROLES)] if number else ROLES[-1]


def _inside(metres: float, side_m: float) -> float:
    return min(max(metres, NEAR_BOARD_M), side_m - NEAR_BOARD_M)
