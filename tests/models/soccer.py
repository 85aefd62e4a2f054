"""The grey paper's field: 6 m × 9 m in 24×36 cells of 25 cm, with robots that carry rings of 16 sonars."""

from __future__ import annotations

import math

import numpy as np

from terrafuse.lattice import Lattice
from terrafuse.testing.deltas import SECOND_NS
from terrafuse.types import Array, Beam, Floats, Pose, Scan

LATTICE = Lattice(0.25, 40.0)
WIDTH, HEIGHT = 24, 36
FIELD_M = (6.0, 9.0)
ROBOT_RADIUS_M = 0.25
RING_RADIUS_M = 0.2
BEAM = Beam(half_angle_rad=math.radians(11.25), range_error_m=0.15, min_range_m=0.05, max_range_m=3.0)
TEAM = {"r1": (1.5, 2.0, 0.3), "r2": (4.4, 3.1, 1.2), "r3": (2.8, 6.6, -0.7)}
"""East, north and heading at the start."""
OPPONENTS = ((3.2, 4.2), (1.2, 5.0), (4.8, 7.2))


def echo_m(apex: Floats, heading: float, obstacles: list[tuple[float, float]]) -> float:
    """Distance to the nearest wall or robot in the cone, inf if there is none in reach."""
    angle = heading + np.linspace(-BEAM.half_angle_rad, BEAM.half_angle_rad, 25)
    direction = np.stack([np.cos(angle), np.sin(angle)])
    with np.errstate(divide="ignore"):
        walls = [(np.where(d > 0, side, 0.0) - p) / d for p, d, side in zip(apex, direction, FIELD_M, strict=True)]
    nearest = min(float(wall.min()) for wall in walls)
    for obstacle in obstacles:
        along = (np.array(obstacle) - apex) @ direction
        across2 = float(np.sum((np.array(obstacle) - apex) ** 2)) - along**2
        meets = (along > 0) & (across2 < ROBOT_RADIUS_M**2)
        if meets.any():
            nearest = min(nearest, float((along[meets] - np.sqrt(ROBOT_RADIUS_M**2 - across2[meets])).min()))
    return nearest if nearest < BEAM.max_range_m else math.inf


def ring_scan(stamp_ns: int, x: float, y: float, psi: float, obstacles: list[tuple[float, float]]) -> Scan:
    """All 16 sonars of a robot at (x, y) that looks along psi; a sonar without an echo is a miss."""
    bearing = np.arange(16) * math.radians(22.5)
    direction = np.stack([np.cos(bearing), np.sin(bearing), np.zeros(16)], axis=1)
    turned = np.stack([np.cos(bearing + psi), np.sin(bearing + psi)], axis=1)
    apices = np.array([x, y]) + RING_RADIUS_M * turned
    echoes = np.array([echo_m(apex, b + psi, obstacles) for apex, b in zip(apices, bearing, strict=True)])
    heard = np.isfinite(echoes)
    origins = RING_RADIUS_M * direction
    ends = origins + direction * np.where(heard, echoes, BEAM.max_range_m)[:, None]
    T_world_sensor = Pose.from_quaternion((x, y, 0), (0, 0, math.sin(psi / 2), math.cos(psi / 2)))
    in_order = np.concatenate([origins[heard], origins[~heard]])
    return Scan(stamp_ns, ends[heard], T_world_sensor, ends[~heard], in_order, BEAM)


def team_scans(name: str, count: int = 12) -> list[Scan]:
    """What one robot of the team hears while it drives a small arc among the others, who stand still."""
    x, y, psi = TEAM[name]
    others = [place[:2] for other, place in TEAM.items() if other != name] + list(OPPONENTS)
    scans = []
    for k in range(count):
        scans.append(ring_scan((k + 1) * SECOND_NS, x, y, psi, others))
        psi += 0.11
        x, y = x + 0.05 * math.cos(psi), y + 0.05 * math.sin(psi)
    return scans


def field(cells: Array) -> Array:
    """The field (36, 24) of the cells of tile (0, 0)."""
    side = LATTICE.tile_cells
    return np.ascontiguousarray(cells.reshape(side, side)[:HEIGHT, :WIDTH])
