"""What a robot knows when it decides: where it believes that it is, its own map, its last scans, its orders."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from terrafuse.kernels.ahead import in_the_way
from terrafuse.navigate import Robot
from terrafuse.navigate.costs import CostMap
from terrafuse.simulate.mission.ownmap import OwnMap
from terrafuse.simulate.motion import Body, State
from terrafuse.types import Bounds, Floats, Pose

LOW_M, HIGH_M = 0.25, 1.6
"""Above the ground: what a robot looks out for with its scans lies between these."""
RISING = 0.15
"""And above a slope of this much ahead."""


@dataclass(eq=False)
class Situation:
    """Of one robot; the engine keeps it up to date, its behaviour reads it. Where it is, is what the robot believes;
    its speed and yaw rate are the true ones, as wheels and a gyroscope tell them well enough to steer by."""

    name: str
    body: Body
    now_s: float = 0.0
    T_world_base: Pose = field(default_factory=Pose.identity)
    yaw_rad: float = 0.0
    speed_mps: float = 0.0
    yaw_rate_radps: float = 0.0
    stopped: bool = False
    """Its bumper: the last step was cut short."""
    obstacles_m: Floats = field(default_factory=lambda: np.empty((0, 2)))
    """(K, 2) in its own frame, x ahead, y left: what its last scans met at the height of its body."""
    orders: dict[str, Any] = field(default_factory=dict)
    """The station's newest word of each kind."""
    own_map: OwnMap | None = None

    @property
    def place_m(self) -> tuple[float, float]:
        east_m, north_m, _ = self.T_world_base.position.tolist()
        return east_m, north_m

    @property
    def state(self) -> State:
        """Itself as it believes to be: what pursuit of a route needs."""

        def one(value: float) -> Floats:
            return np.array([value], np.float64)

        position = self.T_world_base.position[None, :].copy()
        zero = one(0.0)
        return State(position, one(self.yaw_rad), zero, zero, one(self.speed_mps), one(self.yaw_rate_radps), zero,
                     np.array([self.stopped]))  # fmt: skip

    def costs(self, robot: Robot, bounds: Bounds) -> CostMap:
        """What its own map, and what it was told, makes of a part of the world."""
        assert self.own_map is not None
        return self.own_map.costs(robot, bounds)

    def known_share(self, bounds: Bounds) -> float:
        """How much of a part of the world is on the map that it shares with the others."""
        assert self.own_map is not None
        return self.own_map.known_share(bounds)

    def free_ahead_m(self, half_width_m: float, direction_rad: float = 0.0) -> float:
        """How far the way in a direction, from its own x, is free of what its scans met; inf if all the way."""
        if not len(self.obstacles_m):
            return math.inf
        c, s = math.cos(direction_rad), math.sin(direction_rad)
        along = c * self.obstacles_m[:, 0] + s * self.obstacles_m[:, 1]
        across = c * self.obstacles_m[:, 1] - s * self.obstacles_m[:, 0]
        ahead = along[(np.abs(across) <= half_width_m) & (along > 0)]
        return float(ahead.min(initial=math.inf))


def echoes_of(points_m: Floats, T_base_sensor: Pose, reach_m: float) -> Floats:
    """(K, 2): all of a sonar's readings within reach. How high an echo came from no sonar knows, and it hears no ground
    that it does not look down on."""
    matrix = T_base_sensor.matrix
    places = (points_m @ matrix[:3, :3].T + matrix[:3, 3])[:, :2]
    return np.asarray(places[np.hypot(*places.T) < reach_m])


def obstacles_of(points_m: Floats, T_base_sensor: Pose, reach_m: float) -> Floats:
    """(K, 2): of a scan's points, in the sensor's frame, those at the height of a robot's body within reach."""
    return np.asarray(in_the_way(points_m, T_base_sensor.matrix, reach_m, LOW_M, RISING, HIGH_M))
