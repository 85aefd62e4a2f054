"""Where a robot is that knows nothing yet: GNSS says where, and its way says which way it looks.

Two fixes differ by the way between them, which odometry knows but for its direction. As soon as the way is long enough
against the fixes' errors, its direction gives the heading. All readings since the first fix are then replayed from
there with the heading all but unknown: what the robot is believed to know is what they said, and no more.
"""

from __future__ import annotations

from math import atan2, hypot, inf, pi

import numpy as np

from terrafuse.navigate.ekf import PLACE, WANDER, Estimate, arc, corrected, first_estimate, innovation, moved, waited
from terrafuse.navigate.readings import Fix, GnssModel, Odometry, OdometryNoise, check_odometry, refusal
from terrafuse.types import Floats

MAX_YAW_SIGMA_RAD = 0.1
"""The heading counts as known from here on."""
ANY_YAW_SIGMA_RAD = pi / 3**0.5
"""Of a heading that may be any."""
MAX_READINGS = 20_000


class Alignment:
    """Collects readings, in their order, until they say where the robot is and which way it looks."""

    def __init__(self, noise: OdometryNoise, gnss: GnssModel) -> None:
        self._noise, self._gnss = noise, gnss
        self._readings: list[Odometry | Fix] = []
        self._way: Floats = np.zeros(2)
        self._turned_rad = 0.0

    def move(self, odometry: Odometry) -> None:
        """The way since the first fix, in the frame of the robot at that fix. Raises InputError as the filter does."""
        if not self._readings:
            return
        check_odometry(odometry, self._readings[-1].stamp_ns)
        self._way = self._way + arc(odometry.forward_m, odometry.turn_rad, self._turned_rad)[0]
        self._turned_rad += odometry.turn_rad
        self._readings.append(odometry)

    def take(self, fix: Fix) -> Estimate | None:
        """The estimate at this fix, if it can be known by now. Fixes that say nothing are left out."""
        if refusal(fix, self._readings[-1].stamp_ns if self._readings else fix.stamp_ns):
            return None
        if len(self._readings) > MAX_READINGS or not self._way.any():
            self._begin(fix)
            return None
        first = self._readings[0]
        assert isinstance(first, Fix)
        self._readings.append(fix)
        east_m, north_m, _ = (fix.position_m - first.position_m).tolist()
        if self._yaw_sigma_rad(first, fix, hypot(east_m, north_m)) > MAX_YAW_SIGMA_RAD:
            return None
        return self._replayed(first, atan2(north_m, east_m) - atan2(self._way[1], self._way[0]))

    def _begin(self, fix: Fix) -> None:
        self._readings, self._way, self._turned_rad = [fix], np.zeros(2), 0.0

    def _yaw_sigma_rad(self, first: Fix, last: Fix, distance_m: float) -> float:
        """Of the direction from fix to fix; what wanders slowly is common to both (eq. 10)."""
        (white_1, slow_1), (white_2, slow_2) = (self._gnss.deviations(fix.quality) for fix in (first, last))
        kept = self._gnss.kept((last.stamp_ns - first.stamp_ns) * 1e-9)
        variance = white_1**2 + white_2**2 + slow_1**2 + slow_2**2 - 2 * kept * slow_1 * slow_2
        shorter_m = min(distance_m, hypot(*self._way))
        return float(variance[0]) ** 0.5 / shorter_m if shorter_m > 0 else inf

    def _replayed(self, first: Fix, yaw_rad: float) -> Estimate:
        """All readings from the first fix on; the heading is only what the equations are linearised at."""
        estimate = at_fix(first, yaw_rad, ANY_YAW_SIGMA_RAD, self._noise, self._gnss)
        for reading in self._readings[1:]:
            estimate = waited(estimate, reading.stamp_ns, self._gnss)
            if isinstance(reading, Odometry):
                estimate = moved(estimate, reading, self._noise)
            else:
                estimate = corrected(estimate, innovation(estimate, reading, self._gnss))
        return estimate


def at_fix(fix: Fix, yaw_rad: float, yaw_sigma_rad: float, noise: OdometryNoise, gnss: GnssModel) -> Estimate:
    """A start at a fix: the place errs by what the fix errs (eq. 11), so it and GNSS's slow error hang together."""
    white, slow = gnss.deviations(fix.quality)
    sigma_m = np.sqrt(white**2 + slow**2)
    start = first_estimate(fix.stamp_ns, fix.position_m, yaw_rad, sigma_m, yaw_sigma_rad, noise)
    start.covariance[PLACE, WANDER] = start.covariance[WANDER, PLACE] = -np.diag(slow)
    return start
