"""What a sensor is: a frozen value of plain numbers, and where its beams go.

The sensor's frame has x ahead, y left, z up. Azimuths are anticlockwise from x as seen from above, elevations up from
the x-y plane. `load_sensor` reads and checks descriptions that people write; the classes here trust their arguments.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from terrafuse.types import Beam, Floats, Pose, pose_of

CLEAR, IGNORE = "clear", "ignore"
"""What a reading without echo says: the beam's way was empty up to the maximum range; or nothing."""


@dataclass(frozen=True)
class Ring:
    """Beams at even steps around a circle, each looking outward from it.

    Readings are in the order of counting; where there are several elevations, each azimuth has all of them in turn.
    A circle of radius 0 is a spinning head.
    """

    count: int
    first_rad: float
    step_rad: float
    """Over 0: what turns the other way is `clockwise`."""
    clockwise: bool = False
    radius_m: float = 0.0
    elevations_rad: tuple[float, ...] = (0.0,)

    def angles(self) -> tuple[Floats, Floats]:
        """Azimuth and elevation of each beam, (N,) each."""
        sign = -1.0 if self.clockwise else 1.0
        azimuths = self.first_rad + sign * self.step_rad * np.arange(self.count)
        return np.repeat(azimuths, len(self.elevations_rad)), np.tile(self.elevations_rad, self.count)


@dataclass(frozen=True)
class Beams:
    """Beams listed one by one, each looking outward from a circle of `radius_m` at its azimuth."""

    azimuths_rad: tuple[float, ...]
    elevations_rad: tuple[float, ...]
    radius_m: float = 0.0

    def angles(self) -> tuple[Floats, Floats]:
        """Azimuth and elevation of each beam, (N,) each."""
        return np.array(self.azimuths_rad), np.array(self.elevations_rad)


@dataclass(frozen=True)
class Mounting:
    """Where the sensor sits on the robot's base: first rolled about x, then pitched about y, then turned about z."""

    x_m: float = 0.0
    y_m: float = 0.0
    z_m: float = 0.0
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    yaw_rad: float = 0.0

    @property
    def T_base_sensor(self) -> Pose:  # noqa: N802, a frame's name
        """Rz(yaw) · Ry(pitch) · Rx(roll), as URDF and ROS have it."""
        cr, sr = math.cos(self.roll_rad), math.sin(self.roll_rad)
        cp, sp = math.cos(self.pitch_rad), math.sin(self.pitch_rad)
        cy, sy = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        rotation = np.array(
            [
                [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
                [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
                [-sp, cp * sr, cp * cr],
            ]
        )
        return pose_of(rotation, np.array([self.x_m, self.y_m, self.z_m]))


@dataclass(frozen=True)
class Sensor:
    """One sensor: its beams, its limits, its noise, what its silence means, where it sits.

    A reading r is a return where min_range_m ≤ r < max_range_m and r > 0. From max_range_m on it is no return.
    """

    name: str
    max_range_m: float
    min_range_m: float = 0.0
    no_return: str = IGNORE
    """`clear` or `ignore`: what a reading at or beyond max_range_m says."""
    sentinels_m: tuple[tuple[float, str], ...] = ()
    """Readings that are codes and no distances, each with what it says, whatever the limits."""
    beams: Ring | Beams | None = None
    """None: known only by the points that it gives."""
    origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Where the beams start, in the frame of the points, where that is not the sensor's own."""
    cone_half_angle_rad: float = 0.0
    """0: rays."""
    range_error_m: float = 0.0
    """The echo lies within ± this of the reading: the width of a sonar's band."""
    noise_sigma_m: float = 0.0
    """Standard deviation of a reading."""
    reliability: float = 1.0
    firing_period_s: float = 0.0
    """From one beam to the next where they fire in turn; 0: all at once."""
    mounting: Mounting = Mounting()

    @property
    def beam(self) -> Beam:
        """What models need to know of each beam."""
        return Beam(self.cone_half_angle_rad, self.range_error_m, self.min_range_m, self.max_range_m, self.reliability)

    @property
    def radius_m(self) -> float:
        return self.beams.radius_m if self.beams else 0.0

    @property
    def has_origins(self) -> bool:
        """Whether beams start elsewhere than at the origin of the points' frame."""
        return self.radius_m != 0 or any(self.origin_m)


@lru_cache(maxsize=16)
def axes(beams: Ring | Beams) -> tuple[Floats, Floats]:
    """Unit directions (N, 3), and outward unit vectors in the plane of the ring (N, 3); not to be written to."""
    azimuths, elevations = beams.angles()
    outward = np.stack([np.cos(azimuths), np.sin(azimuths), np.zeros(len(azimuths))], axis=1)
    directions = outward * np.cos(elevations)[:, None]
    directions[:, 2] = np.sin(elevations)
    for array in (directions, outward):
        array.flags.writeable = False
    return directions, outward
