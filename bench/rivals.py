"""What others would do with the same scans: n, mean, variance, min and max of every 0.1 m cell, merged over scans.

They get what the mapper gets: float32 points in the sensor's frame and a pose. None has cell states, changed cells or
a map without bounds.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from terrafuse.types import Array, Floats, Scan

CELLS_PER_M = 10.0
SIDE = 4096
"""Cells along their fixed grid's side: it holds the whole stream, as ours need not."""


class Rival(Protocol):
    def take(self, scan: Scan) -> None: ...


def in_world(scan: Scan) -> Floats:
    T = scan.T_world_sensor.matrix
    return np.asarray(scan.points.astype(np.float64) @ T[:3, :3].T + T[:3, 3])


def flat_cells(world: Floats) -> Array:
    """Row-major index of each point's cell in the fixed grid."""
    i, j = (np.floor(world[:, axis] * CELLS_PER_M).astype(np.int64) + SIDE // 3 for axis in (0, 1))
    return np.asarray(j * SIDE + i)


class AddAt:
    """numpy.add.at, minimum.at and maximum.at on one float32 array a statistic."""

    def __init__(self) -> None:
        self.n = np.zeros(SIDE * SIDE, np.int32)
        self.z, self.zz = np.zeros(SIDE * SIDE, np.float32), np.zeros(SIDE * SIDE, np.float32)
        self.low = np.full(SIDE * SIDE, np.inf, np.float32)
        self.high = np.full(SIDE * SIDE, -np.inf, np.float32)

    def take(self, scan: Scan) -> None:
        world = in_world(scan)
        at, z = flat_cells(world), world[:, 2].astype(np.float32)
        np.add.at(self.n, at, 1)
        np.add.at(self.z, at, z)
        np.add.at(self.zz, at, z * z)
        np.minimum.at(self.low, at, z)
        np.maximum.at(self.high, at, z)


class _GroupBy:
    """A group-by of the scan, whose groups are then merged into the grids."""

    def __init__(self) -> None:
        self.grids = AddAt()

    def _merge(self, at: Array, n: Array, z: Array, zz: Array, low: Array, high: Array) -> None:
        g = self.grids
        g.n[at] += n
        g.z[at] += z
        g.zz[at] += zz
        g.low[at] = np.minimum(g.low[at], low)
        g.high[at] = np.maximum(g.high[at], high)


class Pandas(_GroupBy):
    def take(self, scan: Scan) -> None:
        world = in_world(scan)
        import pandas

        z = world[:, 2].astype(np.float32)
        groups = pandas.DataFrame({"at": flat_cells(world), "z": z, "zz": z * z}).groupby("at", sort=False)
        sums = groups.agg({"z": ["size", "sum", "min", "max"], "zz": "sum"})
        columns = [sums[column].to_numpy() for column in (("z", "size"), ("z", "sum"), ("zz", "sum"))]
        self._merge(sums.index.to_numpy(), *columns, sums["z", "min"].to_numpy(), sums["z", "max"].to_numpy())


class Polars(_GroupBy):
    def take(self, scan: Scan) -> None:
        world = in_world(scan)
        import polars as pl

        z = pl.col("z")
        sums = (
            pl.DataFrame({"at": flat_cells(world), "z": world[:, 2].astype(np.float32)})
            .group_by("at")
            .agg(
                pl.len().alias("n"),
                z.sum().alias("s"),
                (z * z).sum().alias("q"),
                z.min().alias("l"),
                z.max().alias("h"),
            )
        )
        self._merge(*(sums[name].to_numpy() for name in ("at", "n", "s", "q", "l", "h")))


RIVALS = {"numpy.add.at": AddAt, "pandas group-by": Pandas, "polars group-by": Polars}
