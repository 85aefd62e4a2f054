"""Small deltas to test with."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from terrafuse.exchange.delta import Delta
from terrafuse.lattice import Lattice
from terrafuse.mapper import Mapper
from terrafuse.models.base import Model
from terrafuse.types import Pose, Scan, Stamp

SECOND_NS = 1_000_000_000


def scan_of(points: ArrayLike, stamp_ns: Stamp = 0) -> Scan:
    """A scan of points that are in the world's frame already."""
    return Scan(stamp_ns, np.asarray(points, np.float64).reshape(-1, 3), Pose.identity())


def random_scans(seed: int, count: int, extent_m: float = 12.0, points: int = 60) -> list[Scan]:
    """Scans a second apart, of points scattered about a slope; the same for the same seed."""
    rng = np.random.default_rng(seed)
    scans = []
    for k in range(count):
        xy = rng.uniform(-extent_m / 2, extent_m / 2, (points, 2))
        z = 0.1 * xy[:, 0] + rng.choice([0.0, 0.0, 1.5], points) + rng.normal(0, 0.02, points)
        scans.append(scan_of(np.column_stack([xy, z]), k * SECOND_NS))
    return scans


def deltas_of(robot: str, scans: Sequence[Scan], lattice: Lattice, model: Model, every: int = 1) -> list[Delta]:
    """What a robot reports that makes these scans: a delta after every few of them."""
    mapper = Mapper(robot, lattice, model)
    out, since = [], 0
    for k, scan in enumerate(scans, start=1):
        mapper.integrate(scan)
        if k % every == 0 or k == len(scans):
            out.append(mapper.delta(since))
            since = mapper.revision
    return out
