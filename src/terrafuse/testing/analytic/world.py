"""Rolling ground, houses and crates, a road with a car, two robots on their rounds."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from terrafuse.testing.analytic.boxes import Car
from terrafuse.testing.analytic.ground import Ground, Hill
from terrafuse.testing.analytic.scene import Lidar, Scene, box_on
from terrafuse.types import Pose, pose_of


@dataclass(frozen=True)
class Round:
    """A robot's way: an ellipse around (x, y), driven at an even rate of turning from `start_rad` on.

    `lap_s` is the time of a lap, negative for a clockwise one.
    """

    x_m: float
    y_m: float
    half_east_m: float
    half_north_m: float
    start_rad: float
    lap_s: float

    def place(self, time_s: float) -> tuple[float, float, float]:
        """(x, y, heading) at a time; the heading counts from east to north."""
        rate = 2 * math.pi / self.lap_s
        angle = self.start_rad + rate * time_s
        east, north = self.half_east_m * math.cos(angle), self.half_north_m * math.sin(angle)
        heading = math.atan2(rate * self.half_north_m * math.cos(angle), -rate * self.half_east_m * math.sin(angle))
        return self.x_m + east, self.y_m + north, heading


def pose_on(ground: Ground, x_m: float, y_m: float, heading_rad: float) -> Pose:
    """T_world_base of a vehicle that stands on the ground: x ahead along the slope, z along the ground's normal."""
    east, north = map(float, ground.gradient(x_m, y_m))
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    up = np.array([-east, -north, 1.0]) / math.hypot(east, north, 1.0)
    ahead = np.array([c, s, east * c + north * s])
    ahead /= np.linalg.norm(ahead)
    rotation = np.stack([ahead, np.cross(up, ahead), up], axis=1)
    return pose_of(rotation, np.array([x_m, y_m, float(ground.height(x_m, y_m))]))


GROUND = Ground(
    level_m=100.0,
    slope_east=0.02,
    slope_north=-0.01,
    wave_m=0.3,
    wave_length_m=45.0,
    hills=(Hill(0.0, 0.0, 3.0, 16.0), Hill(30.0, 25.0, -2.0, 14.0)),
)

SCENE = Scene(
    GROUND,
    boxes=(
        box_on(GROUND, -12.0, 0.0, 8.0, 5.0, 4.0, 0.4),
        box_on(GROUND, 13.0, 2.0, 6.0, 6.0, 5.0),
        box_on(GROUND, -2.0, 20.0, 12.0, 4.0, 3.0, -0.2),
        box_on(GROUND, 24.0, -4.0, 2.5, 1.2, 0.9, 0.7),
        box_on(GROUND, -24.0, 15.0, 3.0, 3.0, 1.0),
    ),
    cars=(Car((-34.0, -17.0), (34.0, -17.0), enters_s=4.0, speed_m_s=5.0),),
)

ROUNDS = {
    "r1": Round(-12.0, 0.0, 20.0, 14.0, start_rad=2.2, lap_s=30.0),
    "r2": Round(13.0, 2.0, 17.0, 15.0, start_rad=2.8, lap_s=-30.0),
}

LIDAR = Lidar(beams=48, columns=900, lowest_deg=-25.0, highest_deg=3.0, max_range_m=40.0)

T_BASE_SENSOR = pose_of(np.eye(3), np.array([0.0, 0.0, 1.8]))
