"""Patrol: from waypoint to waypoint of the route that the station allotted, by paths over the robot's own map.

It plans again when the map has closed its path, stops for what its scans show ahead, goes round what stays there, and
leaves out a waypoint that no way leads to.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from terrafuse.errors import NoPath
from terrafuse.navigate import Path, Robot
from terrafuse.navigate.path import still_good
from terrafuse.navigate.plan import path_between
from terrafuse.simulate.mission.fleet import Drive
from terrafuse.simulate.mission.situation import Situation
from terrafuse.simulate.motion import Body
from terrafuse.simulate.quantities import Delay, Flag, Length, Number, Period, Place, Speed
from terrafuse.simulate.routes import Progress, Routes, at_start, pursue, routes_of
from terrafuse.simulate.scenario.model import Part
from terrafuse.types import Bounds

ROUTE = "route"
"""The station's order: [[east, north], …]."""
AROUND_M = 25.0
"""A plan looks this far beyond the straight line to the goal."""
MORE_M = 40.0
"""And this much further when it finds no way."""
NEAR_M = 12.0
"""A waypoint in an obstacle is moved to free ground this near, or left out."""
CHECK_M = 15.0
"""Around the robot, its path is held against its map again."""
LOOK_AHEAD, TRIES = 3, 5
"""A waypoint is left out for one of the next two, or after so many tries to find a way to any of the three."""
BACK_S = 1.5
STOP_S = 0.6
BESIDE_M = 0.1


class PatrolSettings(Part):
    speed_mps: Speed = 3.0
    waypoints_m: tuple[Place, ...] = ()
    """Its route; without any, the one that the station allots."""
    arrive_m: Length = 2.0
    """A waypoint counts as reached this near."""
    check_s: Period = 1.0
    patience_s: Delay = 4.0
    """How long it waits for what stands in its way before it looks for another."""
    radius_m: Annotated[Number, Field(gt=0, le=5)] | None = None
    """What it plans with; None: its body's."""
    occupied_from: Annotated[Number, Field(gt=0, le=1)] = 0.65
    planned: Flag = True
    """Whether it looks for a way over its map from waypoint to waypoint, or goes straight, as a fleet of many may."""


class Patrol:
    """One robot on its route."""

    def __init__(self, settings: PatrolSettings, rng: np.random.Generator) -> None:
        self.settings = settings
        self.counts: Counter[str] = Counter(plans=0, replans=0, left_out=0, reached=0)
        self._goals: list[Place] = list(settings.waypoints_m)
        self._ordered: Any = None
        self._path: Path | None = None
        self._routes: Routes | None = None
        self._progress: Progress | None = None
        self._next_check_s = 0.0
        self._waits_since_s: float | None = None
        self._back_until_s = self._again_s = 0.0
        self._tries = 0
        # Of two that wait for each other, one gives way first.
        self._patience_s = settings.patience_s * float(rng.uniform(0.75, 1.5))

    def facts(self) -> dict[str, Any]:
        return dict(self.counts) | {"goals_left": len(self._goals)}

    def drive(self, me: Situation) -> Drive:
        self._take_orders(me)
        self._reach(me)
        if me.now_s < self._back_until_s:
            return Drive(-0.5, 0.0)
        if not self._goals:
            return Drive()
        if self._routes is None and not self.settings.planned:
            self._straight(me)
        elif me.now_s >= self._again_s and (self._routes is None or self._closed(me)):
            self._plan(me)
        return self._follow(me)

    def _take_orders(self, me: Situation) -> None:
        order = me.orders.get(ROUTE)
        if order is not None and order != self._ordered:
            self._ordered = order
            self._goals = [(float(east), float(north)) for east, north in order]
            self._forget()

    def _reach(self, me: Situation) -> None:
        """Tick off waypoints that are near; a straight route is followed to its end, wherever it passes."""
        while (
            self.settings.planned
            and self._goals
            and np.hypot(*np.subtract(self._goals[0], me.place_m)) < self.settings.arrive_m
        ):
            self._goals.pop(0)
            self.counts["reached"] += 1
            self._forget()

    def _forget(self) -> None:
        self._path = self._routes = self._progress = None

    def _closed(self, me: Situation) -> bool:
        """Whether the map, as it is now, closes the path near the robot."""
        if self._path is None or me.now_s < self._next_check_s:
            return False
        self._next_check_s = me.now_s + self.settings.check_s
        east, north = me.place_m
        near = Bounds(east - CHECK_M, north - CHECK_M, east + CHECK_M, north + CHECK_M)
        costs = me.costs(self._robot(me.body), near)
        here = np.add(costs.cell_at(east, north), [costs.i0, costs.j0])
        since = int(np.abs(self._path.cells - here).sum(axis=1).argmin())
        if still_good(self._path, costs, min(since + 2, len(self._path.cells) - 1)):
            return False
        self.counts["replans"] += 1
        return True

    def _plan(self, me: Situation) -> None:
        """The way to the next waypoint that there is one to; where there is none to several, it is hemmed in itself,
        by what will move on or by what its map believes, and tries again from a little further back."""
        self._forget()
        for skipped, goal in enumerate(self._goals[:LOOK_AHEAD]):
            self._path = self._way(me, goal)
            if self._path is not None:
                self._leave_out(skipped)
                self._set_out(me, self._path)
                return
        self._tries += 1
        self._back_until_s, self._again_s = me.now_s + BACK_S, me.now_s + self._patience_s
        if self._tries >= TRIES:
            self._leave_out(1)

    def _leave_out(self, goals: int) -> None:
        del self._goals[:goals]
        self.counts["left_out"] += goals
        self._tries = 0

    def _set_out(self, me: Situation, path: Path) -> None:
        self.counts["plans"] += 1
        self._routes = routes_of([np.vstack([me.place_m, path.waypoints_m[1:]])], me.body)
        self._progress = at_start(self._routes)
        self._next_check_s = me.now_s + self.settings.check_s

    def _straight(self, me: Situation) -> None:
        """All of the route at once."""
        self._routes = routes_of([np.vstack([me.place_m, *self._goals])], me.body)
        self._progress = at_start(self._routes)

    def _way(self, me: Situation, goal: Place) -> Path | None:
        robot = self._robot(me.body)
        for margin_m in (AROUND_M, AROUND_M + MORE_M):
            costs = me.costs(robot, _box([me.place_m, goal], margin_m))
            start, end = me.place_m, goal
            for _ in range(3):
                try:
                    return path_between(costs, start, end, any_angle=True)
                except NoPath as error:
                    nearest = error.facts.get("nearest")
                    if nearest is None:
                        break
                    if error.facts.get("end") == "start":
                        start = tuple(nearest)
                    elif np.hypot(*np.subtract(nearest, goal)) < NEAR_M:
                        end = tuple(nearest)
                    else:
                        break
        return None

    def _robot(self, body: Body) -> Robot:
        radius = self.settings.radius_m or body.radius_m
        return Robot(radius_m=radius, keep_away_m=1.0, occupied_from=self.settings.occupied_from)

    def _follow(self, me: Situation) -> Drive:
        if self._routes is None or self._progress is None:
            return Drive()
        command, self._progress = pursue(me.state, self._routes, self._progress, me.body, self.settings.speed_mps)
        if bool(self._progress.arrived[0]):
            done = 1 if self.settings.planned else len(self._goals)
            del self._goals[:done]
            self.counts["reached"] += done
            self._forget()
            return Drive()
        speed, yaw_rate = float(np.asarray(command.speed_mps)[0]), float(np.asarray(command.yaw_rate_radps)[0])
        return self._carefully(me, speed, yaw_rate)

    def _carefully(self, me: Situation, speed_mps: float, yaw_rate_radps: float) -> Drive:
        """No faster than it can stop before what its scans show ahead; after a while in vain, another way."""
        gap_m = me.free_ahead_m(me.body.radius_m + BESIDE_M) - me.body.radius_m - me.speed_mps * STOP_S
        most = float(np.sqrt(max(gap_m, 0.0) * me.body.max_mps2)) if np.isfinite(gap_m) else speed_mps
        waits = (speed_mps > 0.2 and most < 0.1) or me.stopped
        if not waits:
            self._waits_since_s = None
            return Drive(min(speed_mps, most), yaw_rate_radps)
        if self._waits_since_s is None:
            self._waits_since_s = me.now_s
        elif me.now_s - self._waits_since_s > self._patience_s:
            self._waits_since_s = None
            self._back_until_s = me.now_s + BACK_S
            self.counts["detours"] += 1
            if self.settings.planned:
                self._forget()
        return Drive(0.0, yaw_rate_radps)


def _box(places: Sequence[Place], margin_m: float) -> Bounds:
    east, north = zip(*places, strict=True)
    return Bounds(min(east) - margin_m, min(north) - margin_m, max(east) + margin_m, max(north) + margin_m)
