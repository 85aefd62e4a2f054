"""What a robot knows of its own motion: odometry and GNSS, and how far each is to be believed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from terrafuse.errors import InputError
from terrafuse.types import Floats, Stamp

NO_FIX, SINGLE, DIFFERENTIAL = 0, 1, 2
"""Qualities of a GNSS fix, as in the layer `gps_quality`."""


@dataclass(frozen=True)
class Odometry:
    """How a robot moved since the reading before, as its wheels, gyro and inclinometer tell."""

    stamp_ns: Stamp
    forward_m: float
    """Length of its way, on the horizontal; negative backwards."""
    turn_rad: float
    """To the left."""
    up_m: float = 0.0


@dataclass(frozen=True, eq=False)
class Fix:
    """A GNSS position (3,), world metres. Of quality NO_FIX its position means nothing."""

    stamp_ns: Stamp
    position_m: Floats
    quality: int


def check_odometry(odometry: Odometry, newest_ns: Stamp) -> None:
    """Raise InputError for a reading that is not finite, or older than the newest one before it."""
    if not np.isfinite([odometry.forward_m, odometry.turn_rad, odometry.up_m]).all():
        raise InputError(f"{odometry}: holds NaN or infinity; a robot that knows nothing of its motion must stand")
    if odometry.stamp_ns < newest_ns:
        raise InputError(f"odometry of stamp {odometry.stamp_ns} after {newest_ns}: give readings in order")


def refusal(fix: Fix, newest_ns: Stamp) -> str:
    """Why a fix says nothing: no_fix, not_finite, or late, being older than the newest reading; else ''."""
    if fix.quality == NO_FIX:
        return "no_fix"
    if not np.isfinite(fix.position_m).all():
        return "not_finite"
    return "late" if fix.stamp_ns < newest_ns else ""


@dataclass(frozen=True)
class OdometryNoise:
    """Standard deviations of what odometry gets wrong.

    Random errors add up in variance: over d metres and a turn of t radians, `forward_m`²·d, `up_m`²·d, and
    `turn_rad`²·d + `turn_share`²·t. Scale and bias are one number each for a robot's whole life.
    """

    forward_m: float = 0.02
    """After 1 m."""
    up_m: float = 0.01
    """After 1 m."""
    turn_rad: float = 0.005
    """After 1 m."""
    turn_share: float = 0.02
    """After turning 1 rad, in rad."""
    scale: float = 0.01
    """Of the share by which true ways are longer than measured ones."""
    bias_rad_per_m: float = 0.0005
    """Of the turn on each metre that goes unnoticed."""


@dataclass(frozen=True)
class GnssNoise:
    """Standard deviations, east and north each, of the two parts of a fix's error."""

    white_m: float
    """New at each fix."""
    correlated_m: float
    """Wanders slowly (satellites, atmosphere, reflections)."""


QUALITIES: Mapping[int, GnssNoise] = MappingProxyType(
    # √(0.7² + 2.4²) = 2.5 m
    {SINGLE: GnssNoise(white_m=0.7, correlated_m=2.4), DIFFERENTIAL: GnssNoise(white_m=0.1, correlated_m=0.0)}
)


@dataclass(frozen=True)
class GnssModel:
    """How GNSS errs by the quality of the fix.

    The correlated error is a first-order Gauss–Markov process m of unit variance on each axis, times `correlated_m`.
    """

    qualities: Mapping[int, GnssNoise] = field(default_factory=lambda: QUALITIES)
    correlation_s: float = 100.0
    """After this time exp(-1) of m is left."""
    up_factor: float = 1.5
    """Heights err by this much more."""

    def deviations(self, quality: int) -> tuple[Floats, Floats]:
        """(white, correlated) standard deviations of east, north, up. Raises InputError for an unknown quality."""
        noise = self.qualities.get(quality)
        if noise is None:
            raise InputError(f"a fix of quality {quality}; known are {sorted(self.qualities)}, and {NO_FIX} for none")
        axes = np.array([1.0, 1.0, self.up_factor])
        return noise.white_m * axes, noise.correlated_m * axes

    def kept(self, seconds: float) -> float:
        """The share of the Gauss–Markov process that is left after a time: exp(-t/τ)."""
        return float(np.exp(-seconds / self.correlation_s))
