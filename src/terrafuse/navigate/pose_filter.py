"""Odometry and GNSS fused into a pose with its covariance.

filter = PoseFilter(first_estimate(stamp_ns, position_m, yaw_rad, 0.1, 0.02, noise), noise)
filter.move(odometry); filter.take(fix)                     # in the order of their stamps
filter.pose(roll_rad, pitch_rad).T_world_base
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from terrafuse.navigate.alignment import Alignment
from terrafuse.navigate.ekf import YAW, Estimate, corrected, innovation, moved, waited, wrapped
from terrafuse.navigate.readings import Fix, GnssModel, Odometry, OdometryNoise, check_odometry, refusal
from terrafuse.types import Floats, Pose, Stamp, pose_of

GATE = 16.27
"""χ² of 3 degrees of freedom stays below this in 999 of 1000 cases."""
LOST_AFTER = 10
"""So many fixes in a row that fail the gate are no outliers: the estimate is wrong."""
TILT_SIGMA_RAD = 0.01
"""Of roll and pitch, which an inclinometer measures directly."""


@dataclass(frozen=True, eq=False)
class PoseEstimate:
    """T_world_base, and the covariance (6, 6) of x, y, z (m), roll, pitch, yaw (rad), as ROS orders them."""

    stamp_ns: Stamp
    T_world_base: Pose
    covariance: Floats


class PoseFilter:
    """Follows one robot from a first estimate (`first_estimate`, or what an `Alignment` finds).

    `counts` has what became of fixes: used, no_fix, not_finite, late (older than a reading before it), gated. When
    `lost_after` in a row are gated, the robot counts as lost: it goes on by odometry alone until an alignment has found
    it again (`realigned`).
    """

    def __init__(
        self,
        first: Estimate,
        noise: OdometryNoise | None = None,
        gnss: GnssModel | None = None,
        gate: float = GATE,
        lost_after: int = LOST_AFTER,
    ) -> None:
        self.estimate = first
        self.counts: Counter[str] = Counter()
        self._noise, self._gnss = noise or OdometryNoise(), gnss or GnssModel()
        self._gate, self._lost_after = gate, lost_after
        self._gated_in_a_row = 0
        self._alignment: Alignment | None = None

    @property
    def lost(self) -> bool:
        return self._alignment is not None

    def move(self, odometry: Odometry) -> None:
        """Take an odometry reading in. Raises InputError for one that is not finite or older than the one before."""
        check_odometry(odometry, self.estimate.stamp_ns)
        self.estimate = moved(waited(self.estimate, odometry.stamp_ns, self._gnss), odometry, self._noise)
        if self._alignment is not None:
            self._alignment.move(odometry)

    def take(self, fix: Fix) -> str:
        """Take a fix in, or not; returns what became of it, as `counts` counts. Raises InputError for bad qualities."""
        outcome = refusal(fix, self.estimate.stamp_ns) or self._weigh(fix)
        self.counts[outcome] += 1
        return outcome

    def _weigh(self, fix: Fix) -> str:
        self.estimate = waited(self.estimate, fix.stamp_ns, self._gnss)
        if self._alignment is not None:
            return self._realign(self._alignment, fix)
        found = innovation(self.estimate, fix, self._gnss)
        if found.distance2 <= self._gate:
            self.estimate = corrected(self.estimate, found)
            self._gated_in_a_row = 0
            return "used"
        self._gated_in_a_row += 1
        if self._gated_in_a_row >= self._lost_after:
            self._alignment = Alignment(self._noise, self._gnss)
        return "gated"

    def _realign(self, alignment: Alignment, fix: Fix) -> str:
        aligned = alignment.take(fix)
        if aligned is None:
            return "gated"
        self.estimate, self._alignment, self._gated_in_a_row = aligned, None, 0
        return "realigned"

    def pose(
        self, roll_rad: float = 0.0, pitch_rad: float = 0.0, tilt_sigma_rad: float = TILT_SIGMA_RAD
    ) -> PoseEstimate:
        """The estimate as a pose, with roll (right side down) and pitch (nose down) as an inclinometer says."""
        mean = self.estimate.mean
        covariance = np.zeros((6, 6))
        known = [0, 1, 2, 5]
        covariance[np.ix_(known, known)] = self.estimate.covariance[:4, :4]
        covariance[3, 3] = covariance[4, 4] = tilt_sigma_rad**2
        T_world_base = pose_of(rotation(roll_rad, pitch_rad, float(mean[YAW])), mean[:3])
        return PoseEstimate(self.estimate.stamp_ns, T_world_base, covariance)


def rotation(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Floats:
    """Rz(yaw) · Ry(pitch) · Rx(roll), (3, 3)."""
    (sr, sp, sy), (cr, cp, cy) = np.sin([roll_rad, pitch_rad, yaw_rad]), np.cos([roll_rad, pitch_rad, yaw_rad])
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def nees(estimate: Estimate, position_m: Floats, yaw_rad: float) -> float:
    """Normalised estimation error squared of x, y, z, yaw against the truth: χ² of 4 degrees of freedom (eq. 12)."""
    error = np.append(estimate.mean[:3] - position_m, wrapped(estimate.mean[YAW] - yaw_rad))
    return float(error @ np.linalg.solve(estimate.covariance[:4, :4], error))
