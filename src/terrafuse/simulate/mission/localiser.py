"""Where a robot believes that it is: what it maps with, and steers by."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from terrafuse.navigate.ekf import YAW, first_estimate
from terrafuse.navigate.pose_filter import PoseFilter, nees, rotation
from terrafuse.navigate.readings import GnssModel, OdometryNoise
from terrafuse.simulate.gnss import Gnss, QualityAt
from terrafuse.simulate.odometry import Odometer, drawn_flaws
from terrafuse.simulate.scenario.model import PosePart
from terrafuse.types import Floats, Pose, Stamp, pose_of

START_SIGMA_M, START_SIGMA_RAD = 0.05, 0.002
"""How well a robot knows its start."""


class Localiser(Protocol):
    """Told the truth at each tick, it gives what the robot makes of its readings of it."""

    def read(self, stamp_ns: Stamp, position_m: Floats, angles_rad: tuple[float, float, float]) -> Pose:
        """T_world_base as the robot believes it; `angles_rad` are roll, pitch, yaw."""

    def facts(self) -> dict[str, Any]:
        """How it went, for the report."""


class Truth:
    """Knows exactly where it is."""

    def read(self, stamp_ns: Stamp, position_m: Floats, angles_rad: tuple[float, float, float]) -> Pose:
        return pose_of(rotation(*angles_rad), position_m)

    def facts(self) -> dict[str, Any]:
        return {"kind": "true"}


class Filtered:
    """Odometry and, unless it is switched off, GNSS, fused by the pose filter; tilt from an inclinometer."""

    def __init__(
        self, part: PosePart, quality_at: QualityAt | None, position_m: Floats, yaw_rad: float, seed: list[int]
    ) -> None:
        self._part, self._noise, gnss = part, OdometryNoise(**part.odometry.model_dump()), GnssModel()
        draws = [np.random.default_rng([*seed, stream]) for stream in range(4)]
        self._odometer = Odometer(position_m, yaw_rad, self._noise, drawn_flaws(self._noise, draws[0]), draws[1])
        self._gnss = None if quality_at is None else Gnss(gnss, quality_at, draws[2])
        self._tilt = draws[3]
        self._filter = PoseFilter(
            first_estimate(0, position_m, yaw_rad, START_SIGMA_M, START_SIGMA_RAD, self._noise), self._noise, gnss
        )
        self._next_fix_ns = 0
        self._errors_m: list[float] = []
        self._nees: list[float] = []

    def read(self, stamp_ns: Stamp, position_m: Floats, angles_rad: tuple[float, float, float]) -> Pose:
        yaw = angles_rad[2]
        self._filter.move(self._odometer.read(stamp_ns, position_m, yaw))
        if self._gnss is not None and stamp_ns >= self._next_fix_ns:
            self._filter.take(self._gnss.read(stamp_ns, position_m))
            self._next_fix_ns = stamp_ns + round(1e9 / self._part.gnss_hz)
        estimate = self._filter.estimate
        self._errors_m.append(float(np.hypot(*(estimate.mean[:2] - position_m[:2]))))
        self._nees.append(nees(estimate, position_m, yaw))
        roll, pitch = np.asarray(angles_rad[:2]) + self._part.tilt_sigma_rad * self._tilt.standard_normal(2)
        return pose_of(rotation(float(roll), float(pitch), float(estimate.mean[YAW])), estimate.mean[:3])

    def facts(self) -> dict[str, Any]:
        errors = np.array(self._errors_m)
        return {
            "kind": self._part.kind,
            "rms_error_m": float(np.sqrt((errors**2).mean())),
            "largest_error_m": float(errors.max()),
            "last_error_m": float(errors[-1]),
            "mean_nees": float(np.mean(self._nees)),
            "fixes": dict(sorted(self._filter.counts.items())),
        }


Makes = Callable[[PosePart, QualityAt, Floats, float, list[int]], Localiser]

LOCALISERS: dict[str, Makes] = {
    "true": lambda part, quality_at, position_m, yaw_rad, seed: Truth(),
    "odometry": lambda part, quality_at, position_m, yaw_rad, seed: Filtered(part, None, position_m, yaw_rad, seed),
    "filtered": lambda part, quality_at, position_m, yaw_rad, seed: Filtered(
        part, quality_at, position_m, yaw_rad, seed
    ),
}
