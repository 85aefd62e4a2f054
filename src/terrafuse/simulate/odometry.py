"""What a robot's odometry reads of its true way: too long or short by a share, blind to a slow turn, and noisy."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, cos, hypot, sin

import numpy as np

from terrafuse.navigate.ekf import wrapped
from terrafuse.navigate.readings import Odometry, OdometryNoise
from terrafuse.types import Floats, Stamp


@dataclass(frozen=True)
class Flaws:
    """One robot's own: true ways are (1 + scale) times what it measures, and each measured metre turns it unnoticed."""

    scale: float
    bias_rad_per_m: float


def drawn_flaws(noise: OdometryNoise, rng: np.random.Generator) -> Flaws:
    scale, bias = rng.normal(size=2).tolist()
    return Flaws(noise.scale * scale, noise.bias_rad_per_m * bias)


class Odometer:
    """Reads the way between one true place and the next. Draws three random numbers a reading."""

    def __init__(
        self, position_m: Floats, yaw_rad: float, noise: OdometryNoise, flaws: Flaws, rng: np.random.Generator
    ) -> None:
        self._position_m, self._yaw_rad = np.array(position_m, np.float64), yaw_rad
        self._noise, self._flaws, self._rng = noise, flaws, rng

    def read(self, stamp_ns: Stamp, position_m: Floats, yaw_rad: float) -> Odometry:
        """The robot is now at (3,) and looks along yaw, by less than half a turn otherwise than before."""
        forward_m, turn_rad, up_m = way(self._position_m, self._yaw_rad, position_m, yaw_rad)
        self._position_m, self._yaw_rad = np.array(position_m, np.float64), yaw_rad
        noise, flaws = self._noise, self._flaws
        by_forward, by_turn, by_up = self._rng.normal(size=3).tolist()
        exact_m = forward_m / (1 + flaws.scale)
        far = abs(exact_m) ** 0.5
        turn_sigma = hypot(noise.turn_rad * far, noise.turn_share * abs(turn_rad) ** 0.5)
        return Odometry(
            stamp_ns,
            exact_m + noise.forward_m * far * by_forward,
            turn_rad - flaws.bias_rad_per_m * exact_m + turn_sigma * by_turn,
            up_m + noise.up_m * far * by_up,
        )


def way(from_m: Floats, from_yaw_rad: float, to_m: Floats, to_yaw_rad: float) -> tuple[float, float, float]:
    """(forward, turn, up) of the arc from one place (3,) to another; what leads aside of it is not noticed."""
    east_m, north_m, up_m = (np.asarray(to_m) - from_m).tolist()
    turn_rad = wrapped(to_yaw_rad - from_yaw_rad)
    h = turn_rad / 2
    chord_m = hypot(east_m, north_m) * cos(atan2(north_m, east_m) - from_yaw_rad - h)
    return chord_m * (h / sin(h) if h else 1.0), turn_rad, up_m
