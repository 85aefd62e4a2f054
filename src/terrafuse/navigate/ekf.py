"""The equations of the pose filter: an extended Kalman filter over nine numbers. docs/navigation.md derives them.

| index | state | unit |
|---|---|---|
| 0, 1, 2 | x, y, z of the robot in the world | m |
| 3 | yaw ψ, from east to north | rad |
| 4 | scale s: true ways are (1 + s) times the measured ones | 1 |
| 5 | turn bias b: turn on each metre that odometry does not see | rad/m |
| 6, 7, 8 | m: the correlated error of GNSS, east, north, up, in units of its standard deviation | 1 |
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, pi, sin

import numpy as np

from terrafuse.navigate.readings import Fix, GnssModel, Odometry, OdometryNoise
from terrafuse.types import Floats, Stamp

STATES = 9
PLACE, YAW, SCALE, BIAS, WANDER = slice(0, 3), 3, 4, 5, slice(6, 9)
SMALL = 1e-4
"""Half turns below this, rad, take the series of sin(h)/h: its next term is under 1e-17."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """`mean` (9,) and `covariance` (9, 9) of the state at a stamp."""

    stamp_ns: Stamp
    mean: Floats
    covariance: Floats


def wrapped(angle_rad: float) -> float:
    """The same direction within -π to π."""
    return (angle_rad + pi) % (2 * pi) - pi


def first_estimate(
    stamp_ns: Stamp,
    position_m: Floats,
    yaw_rad: float,
    position_sigma_m: Floats | float,
    yaw_sigma_rad: float,
    noise: OdometryNoise,
) -> Estimate:
    """A start whose place and heading are known from elsewhere, with their standard deviations."""
    sigmas = np.ones(STATES)
    sigmas[PLACE] = position_sigma_m
    sigmas[YAW : WANDER.start] = yaw_sigma_rad, noise.scale, noise.bias_rad_per_m
    mean = np.zeros(STATES)
    mean[PLACE], mean[YAW] = position_m, wrapped(yaw_rad)
    return Estimate(stamp_ns, mean, np.diag(sigmas**2))


def arc(forward_m: float, turn_rad: float, yaw_rad: float) -> tuple[Floats, Floats]:
    """Along an arc (eqs. 2, 3): (2,) how far east and north, and (2,) its derivative by the turn."""
    h = turn_rad / 2
    k = sin(h) / h if abs(h) > SMALL else 1 - h * h / 6
    dk = (cos(h) - k) / h if abs(h) > SMALL else -h / 3
    along = np.array([cos(yaw_rad + h), sin(yaw_rad + h)])
    across = np.array([-along[1], along[0]])
    return forward_m * k * along, forward_m / 2 * (dk * along + k * across)


def waited(estimate: Estimate, stamp_ns: Stamp, gnss: GnssModel) -> Estimate:
    """Time passes (eq. 1): the error of GNSS wanders."""
    kept = gnss.kept((stamp_ns - estimate.stamp_ns) * 1e-9)
    F = np.ones(STATES)
    F[WANDER] = kept
    covariance = F[:, None] * estimate.covariance * F
    covariance[WANDER, WANDER] += (1 - kept**2) * np.eye(3)
    return Estimate(stamp_ns, F * estimate.mean, covariance)


def moved(estimate: Estimate, odometry: Odometry, noise: OdometryNoise) -> Estimate:
    """The robot moved (eqs. 2 to 5)."""
    mean = estimate.mean.copy()
    yaw, scale, bias = mean[YAW : WANDER.start].tolist()
    measured = odometry.forward_m
    forward, turn = (1 + scale) * measured, odometry.turn_rad + bias * measured
    step, by_turn = arc(forward, turn, yaw)
    mean[:2] += step
    mean[2] += odometry.up_m
    mean[YAW] = wrapped(yaw + turn)
    # Of the arc's end: its length adds along the chord, and turning the start turns all of it.
    by_forward = arc(1.0, turn, yaw)[0]
    F = np.eye(STATES)
    F[:2, YAW] = -step[1], step[0]
    F[:2, SCALE] = by_forward * measured
    F[:2, BIAS] = by_turn * measured
    F[YAW, BIAS] = measured
    # Columns: the random errors of the way, of the turn, of the climb.
    V = np.zeros((4, 3))
    V[:2, 0] = by_forward
    V[:2, 1] = by_turn
    V[YAW, 1] = V[2, 2] = 1
    variances = _variances(odometry, noise)
    covariance = F @ estimate.covariance @ F.T
    covariance[:4, :4] += (V * variances) @ V.T
    return Estimate(estimate.stamp_ns, mean, _symmetric(covariance))


def _variances(odometry: Odometry, noise: OdometryNoise) -> Floats:
    """Of the random errors of way, turn and climb (eq. 4)."""
    way, turn = abs(odometry.forward_m), abs(odometry.turn_rad)
    return np.array(
        [
            noise.forward_m**2 * way,
            noise.turn_rad**2 * way + noise.turn_share**2 * turn,
            noise.up_m**2 * way,
        ]
    )


@dataclass(frozen=True, eq=False)
class Innovation:
    """What a fix says that the estimate does not (eq. 6): H (3, 9), noise variances R (3,), residual (3,), S (3, 3)."""

    H: Floats
    R: Floats
    residual_m: Floats
    S: Floats

    @property
    def distance2(self) -> float:
        """Squared Mahalanobis distance: χ² of 3 degrees of freedom if the filter is right (eq. 7)."""
        return float(self.residual_m @ np.linalg.solve(self.S, self.residual_m))


def innovation(estimate: Estimate, fix: Fix, gnss: GnssModel) -> Innovation:
    white, correlated = gnss.deviations(fix.quality)
    H = np.zeros((3, STATES))
    H[:, PLACE] = np.eye(3)
    H[:, WANDER] = np.diag(correlated)
    S = H @ estimate.covariance @ H.T + np.diag(white**2)
    return Innovation(H, white**2, fix.position_m - H @ estimate.mean, S)


def corrected(estimate: Estimate, found: Innovation) -> Estimate:
    """The estimate with a fix taken in (eqs. 8, 9; Joseph's form, which stays symmetric and positive)."""
    P, H = estimate.covariance, found.H
    K = np.linalg.solve(found.S, H @ P).T
    mean = estimate.mean + K @ found.residual_m
    mean[YAW] = wrapped(mean[YAW])
    keep = np.eye(STATES) - K @ H
    covariance = keep @ P @ keep.T + (K * found.R) @ K.T
    return Estimate(estimate.stamp_ns, mean, _symmetric(covariance))


def _symmetric(covariance: Floats) -> Floats:
    """Without what rounding made of it: that would grow from step to step."""
    return (covariance + covariance.T) / 2
