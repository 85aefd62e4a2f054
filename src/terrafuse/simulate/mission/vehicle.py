"""One simulated robot. It senses, believes where it is, maps, reports and decides; only sensing touches the truth.

The mapper, the contribution, the courier and the replica are those of a real robot.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from time import perf_counter, thread_time
from typing import Any

import numpy as np

from terrafuse.logs.recorder import McapRecorder
from terrafuse.mapper import Mapper
from terrafuse.simulate.mission.behaviours import Behaviour
from terrafuse.simulate.mission.exchange import Node
from terrafuse.simulate.mission.fleet import Drive, Fleet
from terrafuse.simulate.mission.localiser import Localiser
from terrafuse.simulate.mission.senses import Around, Sense
from terrafuse.simulate.mission.situation import Situation, echoes_of, obstacles_of
from terrafuse.simulate.sensors.crosstalk import Ping
from terrafuse.types import Floats, Pose, Scan, Stamp

OBSTACLE_REACH_M = 12.0


@dataclass(eq=False)
class Vehicle:
    """The parts of a robot; `number` is the fleet's."""

    name: str
    number: int
    senses: list[Sense]
    localiser: Localiser
    mapper: Mapper
    node: Node
    behaviour: Behaviour
    situation: Situation
    altitude_m: float = 0.0
    recorder: McapRecorder | None = None
    seconds: dict[str, float] = field(
        default_factory=lambda: dict.fromkeys(("simulate", "map", "exchange", "decide"), 0.0)
    )
    """Of processor time, by what it went for; of `simulate`, whose rays several threads cast, by the clock."""
    longest_pause_s: float = 0.0
    """By the clock on the wall, that a scan took to get into the map, what left the window out of memory, and what came
    into it back; but not the first scan, which loads the compiled loops."""
    points: int = 0
    way_m: float = 0.0
    on_scan: list[Callable[[Scan], object]] = field(default_factory=list)
    """Called with each scan once it is mapped."""
    _last_m: Floats | None = None

    def pings(self, T_world_base: Pose, stamp_ns: Stamp) -> list[Ping]:
        """What others may hear of it at this tick."""
        return [sense.ping(T_world_base) for sense in self.senses if sense.hears_others and stamp_ns >= sense.next_ns]

    def sense(self, fleet: Fleet, around: Around, stamp_ns: Stamp, own_ping: Ping | None) -> None:
        """Read every sensor that is due, and map what it saw."""
        started = perf_counter()
        position = fleet.position_m(self.number)
        self._count_way(position)
        believed = self.localiser.read(stamp_ns, position, fleet.angles_rad(self.number))
        self._believe(fleet, believed)
        if self.recorder is not None:
            self.recorder.pose(stamp_ns, believed)
        truth = fleet.pose(self.number)
        self.seconds["simulate"] += perf_counter() - started
        due = [sense for sense in self.senses if sense.due(around.stamp_ns)]
        found = [self._look(sense, truth, believed, around, stamp_ns, own_ping) for sense in due]
        if found:
            self.situation.obstacles_m = np.concatenate(found)

    def _look(
        self, sense: Sense, truth: Pose, believed: Pose, around: Around, stamp_ns: Stamp, own_ping: Ping | None
    ) -> Floats:
        t0 = perf_counter()
        ranges = sense.ranges(truth, around, own_ping if sense.hears_others else None)
        scan = sense.scan(ranges, stamp_ns, believed)
        if self.recorder is not None:
            self.recorder.scan(stamp_ns, sense.cloud(ranges))
        met = echoes_of if sense.part.kind == "sonar" else obstacles_of
        obstacles = met(scan.points, sense.sensor.mounting.T_base_sensor, OBSTACLE_REACH_M)
        t1, processor_s = perf_counter(), thread_time()
        self.mapper.integrate(scan)
        if self.mapper.revision > 1:
            self.longest_pause_s = max(self.longest_pause_s, perf_counter() - t1)
        self.points += len(scan.points)
        self.seconds["simulate"] += t1 - t0
        self.seconds["map"] += thread_time() - processor_s
        for listen in self.on_scan:
            listen(scan)
        return obstacles

    def _believe(self, fleet: Fleet, believed: Pose) -> None:
        me = self.situation
        me.T_world_base = believed
        me.yaw_rad = math.atan2(believed.matrix[1, 0], believed.matrix[0, 0])
        me.speed_mps, me.yaw_rate_radps = fleet.speed_mps(self.number)
        me.stopped = fleet.stopped_by_something(self.number)

    def _count_way(self, position_m: Floats) -> None:
        if self._last_m is not None:
            self.way_m += float(np.linalg.norm(position_m - self._last_m))
        self._last_m = position_m.copy()

    def exchange(self, now_ns: int) -> None:
        started = thread_time()
        self.node.say_where(now_ns, self.situation.place_m)
        self.node.tick(now_ns)
        self.seconds["exchange"] += thread_time() - started

    def decide(self, now_s: float) -> Drive:
        started = thread_time()
        self.situation.now_s = now_s
        self.situation.orders = self.node.orders
        drive = self.behaviour.drive(self.situation)
        self.seconds["decide"] += thread_time() - started
        return drive._replace(altitude_m=self.altitude_m)

    def facts(self) -> dict[str, Any]:
        """For the report; without times."""
        return {
            "scans": self.mapper.revision,
            "points": self.points,
            "way_m": round(self.way_m, 3),
            "pose": self.localiser.facts(),
            "behaviour": self.behaviour.facts(),
            "sensors": [{"name": sense.sensor.name, **sense.counts} for sense in self.senses],
            "allocation": self.mapper.allocation().as_json(),
            "paging": vars(self.mapper.paging),
            "exchange": self.node.facts(),
        }
