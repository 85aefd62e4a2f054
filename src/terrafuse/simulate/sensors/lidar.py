"""Lidars of any described beams: one range a beam, at one instant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from terrafuse.errors import InputError
from terrafuse.sense import Sensor, scan_of
from terrafuse.sense.sensor import axes
from terrafuse.simulate.movers import NO_BODIES
from terrafuse.simulate.rays import RayCaster
from terrafuse.types import Array, Floats, Pose, Scan, Stamp


@dataclass(frozen=True)
class Lidar:
    """A described sensor of rays, and what a description does not say. Raises InputError for what has no beams."""

    sensor: Sensor
    dropout: float = 0.0
    """Share of beams whose echo is lost, whatever they hit: to the sensor, as if nothing were there."""

    def __post_init__(self) -> None:
        check_beams(self.sensor)
        if not 0 <= self.dropout <= 1:
            raise InputError(f"dropout {self.dropout}: give a share from 0 to 1")


def lidar_scan(
    lidar: Lidar,
    caster: RayCaster,
    T_world_base: Pose,
    stamp_ns: Stamp,
    bodies: Array = NO_BODIES,
    rng: np.random.Generator | None = None,
) -> Scan:
    """What a lidar sees: points, and misses where its description lets silence count.

    `bodies` as of `World.bodies(time_s)`, with those of other robots. Each scan takes as many random numbers as any
    other; without a generator there is neither noise nor dropout.
    """
    return scan_of(lidar.sensor, lidar_ranges(lidar, caster, T_world_base, bodies, rng), stamp_ns, T_world_base)


def lidar_ranges(
    lidar: Lidar,
    caster: RayCaster,
    T_world_base: Pose,
    bodies: Array = NO_BODIES,
    rng: np.random.Generator | None = None,
) -> Floats:
    """(N,) one reading a beam, inf for no echo."""
    sensor = lidar.sensor
    starts, directions = beams_in_world(sensor, T_world_base)
    ranges = caster.cast(starts, directions, sensor.max_range_m, bodies).ranges_m
    if rng is None:
        return ranges
    noisy = ranges + sensor.noise_sigma_m * rng.standard_normal(len(ranges))
    return np.where(rng.random(len(ranges)) < lidar.dropout, np.inf, noisy)


def check_beams(sensor: Sensor) -> None:
    if sensor.beams is None:
        raise InputError(f"sensor {sensor.name} describes no beams; give it a 'ring' or 'beams' with their angles")
    if not np.isfinite(sensor.max_range_m):
        raise InputError(
            f"sensor {sensor.name}: max_range_m {sensor.max_range_m}; a simulated one needs a finite range"
        )


def beams_in_world(sensor: Sensor, T_world_base: Pose) -> tuple[Floats, Floats]:
    """Where its beams start, (N, 3) or (3,) where they have one start, and their unit directions (N, 3)."""
    assert sensor.beams is not None
    directions, outward = axes(sensor.beams)
    T = (T_world_base @ sensor.mounting.T_base_sensor).matrix
    origin = np.asarray(sensor.origin_m) + (sensor.radius_m * outward if sensor.radius_m else 0.0)
    return origin @ T[:3, :3].T + T[:3, 3], directions @ T[:3, :3].T
