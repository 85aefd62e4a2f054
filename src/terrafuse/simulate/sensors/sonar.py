"""Rings of sonars: a cone hears the nearest surface that it meets squarely enough.

A cone is sampled by rays. Of a ray that meets a surface more obliquely than the specular limit, nothing comes back: the
sound is reflected away, as by a smooth wall. Where no ray of a cone has an echo, the reading is the maximum range.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from terrafuse.errors import InputError
from terrafuse.sense import Beams, Sensor, scan_of
from terrafuse.simulate.movers import NO_BODIES
from terrafuse.simulate.rays import Hits, RayCaster
from terrafuse.simulate.sensors.lidar import beams_in_world, check_beams
from terrafuse.types import Array, Floats, Pose, Scan, Stamp


@dataclass(frozen=True)
class Sonar:
    """A described sensor of cones, and what a description does not say. Raises InputError."""

    sensor: Sensor
    circles: int = 4
    """Circles of rays around a cone's axis, the last on its rim: 1 + 3·n·(n + 1) rays a cone."""
    specular_limit_rad: float = math.radians(20.0)
    """The largest angle of incidence that still gives an echo; π/2 takes all surfaces as rough."""

    def __post_init__(self) -> None:
        check_beams(self.sensor)
        if not 0 < self.specular_limit_rad <= math.pi / 2:
            raise InputError(f"specular limit {self.specular_limit_rad} rad: give an angle over 0, up to π/2")
        if not (1 <= self.circles <= 20 and 0 < self.sensor.cone_half_angle_rad < math.pi / 2):
            raise InputError(
                f"sonar {self.sensor.name}: {self.circles} circles of rays in a cone of half angle "
                f"{self.sensor.cone_half_angle_rad} rad; give 1 to 20, and a cone_half_angle between 0 and 90°"
            )

    @property
    def turns_s(self) -> Floats:
        """(N,): when each sonar fires, after the first of a round."""
        assert self.sensor.beams is not None
        return np.asarray(self.sensor.firing_period_s * np.arange(len(self.sensor.beams.angles()[0])), np.float64)


def sonar_scan(
    sonar: Sonar,
    caster: RayCaster,
    T_world_base: Pose,
    stamp_ns: Stamp,
    bodies: Array = NO_BODIES,
    rng: np.random.Generator | None = None,
) -> Scan:
    """What a ring hears when all fire at once, or what the sonars of `fired` hear; arguments as of `lidar_scan`."""
    return scan_of(sonar.sensor, sonar_ranges(sonar, caster, T_world_base, bodies, rng), stamp_ns, T_world_base)


def sonar_ranges(
    sonar: Sonar,
    caster: RayCaster,
    T_world_base: Pose,
    bodies: Array = NO_BODIES,
    rng: np.random.Generator | None = None,
) -> Floats:
    """(N,) one reading a sonar; max_range_m where it hears nothing."""
    sensor = sonar.sensor
    _, directions, hits = cone_hits(sonar, caster, T_world_base, bodies)
    echoes = np.where(square_on(directions, hits.normals, sonar.specular_limit_rad), hits.ranges_m, np.inf)
    nearest = echoes.reshape(-1, len(cone(sensor.cone_half_angle_rad, sonar.circles))).min(axis=1)
    noise = 0.0 if rng is None else sensor.noise_sigma_m * rng.standard_normal(len(nearest))
    return np.where(np.isfinite(nearest), nearest + noise, sensor.max_range_m)


def fired(sonar: Sonar, number: int) -> Sonar:
    """A ring of which only one sonar fires. Raises InputError for a number that it does not have."""
    return replace(sonar, sensor=_one_beam(sonar.sensor, number))


def firings(sonar: Sonar, start_ns: Stamp, until_ns: Stamp) -> list[tuple[Stamp, int]]:
    """When which sonar fires, from a stamp up to before another: in turn, without a pause, the first at stamp 0.

    Raises InputError for a sensor whose description gives no firing period.
    """
    period_ns = round(sonar.sensor.firing_period_s * 1e9)
    if period_ns <= 0:
        raise InputError(f"sonar {sonar.sensor.name} fires all at once; give it a firing_period_s")
    assert sonar.sensor.beams is not None
    count = len(sonar.sensor.beams.angles()[0])
    return [(turn * period_ns, turn % count) for turn in range(-(-start_ns // period_ns), -(-until_ns // period_ns))]


@lru_cache(maxsize=256)
def _one_beam(sensor: Sensor, number: int) -> Sensor:
    assert sensor.beams is not None
    azimuths, elevations = sensor.beams.angles()
    if not 0 <= number < len(azimuths):
        raise InputError(f"sonar {number} of {sensor.name}: it has 0 to {len(azimuths) - 1}")
    return replace(sensor, beams=Beams((float(azimuths[number]),), (float(elevations[number]),), sensor.radius_m))


def cone_hits(sonar: Sonar, caster: RayCaster, T_world_base: Pose, bodies: Array) -> tuple[Floats, Floats, Hits]:
    """Where each ray of each cone starts, its direction, and what it meets; cone by cone, in the world."""
    starts, axes = beams_in_world(sonar.sensor, T_world_base)
    spread = cone(sonar.sensor.cone_half_angle_rad, sonar.circles)
    directions = (spread @ _frames(axes).swapaxes(1, 2)).reshape(-1, 3)
    origins = np.repeat(np.broadcast_to(starts, axes.shape), len(spread), axis=0)
    return origins, directions, caster.cast(origins, directions, sonar.sensor.max_range_m, bodies)


def square_on(directions: Floats, normals: Floats, limit_rad: float) -> Array:
    """Which rays meet their surface within an angle of its normal; False of those that meet none."""
    return np.asarray(-np.einsum("ij,ij->i", directions, normals) >= math.cos(limit_rad))


@lru_cache(maxsize=16)
def cone(half_angle_rad: float, circles: int) -> Floats:
    """(K, 3) unit vectors around x: the axis, then circles at even steps up to the rim, of 6, 12, 18, … rays each."""
    rays = [(0.0, 0.0)]
    for circle in range(1, circles + 1):
        rays += [(half_angle_rad * circle / circles, 2 * math.pi * k / (6 * circle)) for k in range(6 * circle)]
    off, around = np.array(rays).T
    out = np.stack([np.cos(off), np.sin(off) * np.cos(around), np.sin(off) * np.sin(around)], axis=1)
    out.flags.writeable = False
    return out


def _frames(axes: Floats) -> Floats:
    """(N, 3, 3): rotations that take x to each axis, and y to the level."""
    level = np.stack([-axes[:, 1], axes[:, 0], np.zeros(len(axes))], axis=1)
    length = np.linalg.norm(level, axis=1, keepdims=True)
    level = np.where(length > 1e-9, level / np.maximum(length, 1e-9), np.array([0.0, 1.0, 0.0]))
    return np.stack([axes, level, np.cross(axes, level)], axis=2)
