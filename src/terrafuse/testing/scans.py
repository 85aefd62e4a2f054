"""Scans of every kind to test with: clouds, lidars whose beams also miss, sonars. Equal seeds give equal scans."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from terrafuse.testing.deltas import SECOND_NS, random_scans
from terrafuse.types import Beam, Floats, Pose, Scan, Stamp, pose_of

EXTENT_M = 8.0
"""Sensors stand, and clouds lie, within a square of this side around the origin."""

SONAR = Beam(half_angle_rad=0.2, range_error_m=0.15, min_range_m=0.15, max_range_m=3.0)


def cloud(rng: np.random.Generator, stamp_ns: Stamp) -> Scan:
    """Points in the world's frame, about a slope with steps on it."""
    (scan,) = random_scans(int(rng.integers(2**32)), 1, EXTENT_M, int(rng.integers(1, 80)))
    return Scan(stamp_ns, scan.points, Pose.identity())


def lidar(rng: np.random.Generator, stamp_ns: Stamp) -> Scan:
    """Beams from a tilted sensor 1 m up, in float32; some meet nothing. Half the scans state where beams start."""
    hits, misses = int(rng.integers(1, 30)), int(rng.integers(0, 10))
    ends = _ring(rng, hits + misses, 0.3, 4.0)
    ends[:, 2] = rng.normal(-1.0, 0.1, len(ends))
    origins = rng.normal(0, 0.05, (len(ends), 3)) if rng.random() < 0.5 else None
    T_world_sensor = _somewhere(rng, 1.0, tilt_rad=0.05)
    return Scan(stamp_ns, ends[:hits].astype(np.float32), T_world_sensor, ends[hits:], origins)


def sonar(rng: np.random.Generator, stamp_ns: Stamp) -> Scan:
    """A ring of 8 cones in the plane; those that hear nothing reach to the maximum range."""
    ends = _ring(rng, 8, SONAR.min_range_m, SONAR.max_range_m)
    heard = rng.random(8) < 0.7
    silent = ends[~heard] * (SONAR.max_range_m / np.linalg.norm(ends[~heard], axis=1, keepdims=True))
    return Scan(stamp_ns, ends[heard], _somewhere(rng, 0.0), silent, beam=SONAR)


Kind = Callable[[np.random.Generator, Stamp], Scan]
KINDS: dict[str, Kind] = {"cloud": cloud, "lidar": lidar, "sonar": sonar}


def mixed_scans(seed: int, count: int, kinds: tuple[Kind, ...] = (cloud, lidar, sonar)) -> list[Scan]:
    """Scans of these kinds in turn, from a random one on; their stamps rise, mostly by a second, at times by none."""
    rng = np.random.default_rng(seed)
    first = int(rng.integers(len(kinds)))
    stamps = SECOND_NS * (1 + np.cumsum(rng.integers(0, 3, count)))
    return [kinds[(first + k) % len(kinds)](rng, int(stamp)) for k, stamp in enumerate(stamps)]


def _ring(rng: np.random.Generator, count: int, near_m: float, far_m: float) -> Floats:
    """(count, 3) ends of beams all around, at z = 0."""
    bearing, range_m = rng.uniform(-np.pi, np.pi, count), rng.uniform(near_m, far_m, count)
    return np.column_stack([range_m * np.cos(bearing), range_m * np.sin(bearing), np.zeros(count)])


def _somewhere(rng: np.random.Generator, up_m: float, tilt_rad: float = 0.0) -> Pose:
    yaw, roll = rng.uniform(-np.pi, np.pi), rng.normal(0, tilt_rad)
    about_z = [[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]]
    about_x = [[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]]
    east_north = rng.uniform(-EXTENT_M / 2, EXTENT_M / 2, 2)
    return pose_of(np.array(about_z) @ np.array(about_x), np.array([*east_north, up_m]))
