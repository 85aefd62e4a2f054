"""How far occupancy maps of real logs agree with the readings themselves: python -m tests.accuracy_occupancy

Prints the table of docs/accuracy.md as Markdown. Needs TERRAFUSE_RECORDINGS.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from terrafuse.lattice import Lattice
from terrafuse.logs import open_log
from terrafuse.models import make_model
from terrafuse.models.occupancy import FREE, OCCUPIED
from terrafuse.replica import Replica
from terrafuse.testing.deltas import deltas_of
from terrafuse.types import Array, Floats, Scan
from terrafuse.views import chosen_layers, mosaic, window_of
from tests.accuracy import table

LOGS = {"intel": "intel-corrected.log.gz?backwards=drop", "freiburg-079": "freiburg-079-corrected.log.gz"}
"""The clock of intel steps back by 0.1 s, which takes 4 of its 910 scans out."""

STEP = 0.2
"""Beams are looked at every so many cells: no traversal of ours judges itself."""


def scans_of(recordings: Path, log: str) -> list[Scan]:
    source = f"{recordings / 'lidar2d/ple_corrected'}/{LOGS[log]}"
    return [record for record in open_log(source).scans() if isinstance(record, Scan)]


def map_of(robots: Sequence[Sequence[Scan]], resolution_m: float) -> Replica:
    """The global map of robots that made these scans, each reporting in a few deltas."""
    lattice, model = Lattice(resolution_m), make_model("occupancy")
    replica = Replica(lattice, model)
    for k, scans in enumerate(robots):
        for delta in deltas_of(f"r{k}", scans, lattice, model, every=500):
            replica.apply(delta)
    return replica


def in_thirds(scans: Sequence[Scan]) -> list[Sequence[Scan]]:
    """Cut by time into three robots."""
    cut = len(scans) // 3
    return [scans[:cut], scans[cut : 2 * cut], scans[2 * cut :]]


def along(scan: Scan, resolution_m: float) -> tuple[Array, Array]:
    """(cells (K, 2) that beams pass before the ones in which they end, cells (N, 2) of their ends), as (i, j)."""
    T = scan.T_world_sensor.matrix
    start, end = T[:2, 3], scan.points @ T[:2, :3].T + T[:2, 3]
    ends = np.floor(end / resolution_m).astype(np.int64)
    inner = []
    for there, last in zip(end, ends, strict=True):
        steps = int(np.hypot(*(there - start)) / (STEP * resolution_m)) + 1
        samples = start + np.linspace(0, 1, steps, endpoint=False)[:, None] * (there - start)
        cells = np.floor(samples / resolution_m).astype(np.int64)
        new = np.ones(len(cells), bool)
        new[1:] = (cells[1:] != cells[:-1]).any(axis=1)
        inner.append(cells[new & (cells != last).any(axis=1)])
    return np.concatenate([*inner, np.empty((0, 2), np.int64)]), ends


def or_beside(mask: Array) -> Array:
    """True also beside what is True, in all eight directions."""
    wide = np.pad(mask, 1)
    rows, columns = mask.shape
    return np.any([wide[j : j + rows, i : i + columns] for j in range(3) for i in range(3)], axis=0)


def agreement(replica: Replica, scans: Sequence[Scan], about_scans: int = 900) -> dict[str, float]:
    """Shares of the readings that the map agrees with, of about so many of these scans, evenly chosen."""
    i0, j0, _, _ = window = window_of(replica, None)
    layers = mosaic(replica, chosen_layers(replica, ["occupancy", "state"]), window)
    layers["near"] = or_beside(layers["state"] == OCCUPIED).astype(np.float64)
    some = scans[:: max(1, round(len(scans) / about_scans))]
    inner, ends = (
        np.concatenate(part) for part in zip(*(along(s, replica.lattice.resolution_m) for s in some), strict=True)
    )

    def of(cells: Array, name: str) -> Floats:
        """NaN also where the map ends."""
        (i, j), grid = (cells - (i0, j0)).T, layers[name]
        inside = (i >= 0) & (j >= 0) & (i < grid.shape[1]) & (j < grid.shape[0])
        out = np.full(len(cells), np.nan)
        out[inside] = grid[j[inside], i[inside]]
        return out

    return {
        "known cells": int((~np.isnan(layers["state"])).sum()),
        "scans looked at": len(some),
        "ends of beams": len(ends),
        "on occupied cells": float((of(ends, "state") == OCCUPIED).mean()),
        "on or beside them": float((of(ends, "near") == 1).mean()),
        "p > 0.5": float((of(ends, "occupancy") > 0.5).mean()),
        "cells that beams pass": len(inner),
        "free": float((of(inner, "state") == FREE).mean()),
        "p < 0.5": float((of(inner, "occupancy") < 0.5).mean()),
    }


def held_out(scans: Sequence[Scan], resolution_m: float, about_scans: int = 900) -> dict[str, float]:
    """The same of every fifth scan, over the map of the others."""
    kept = [scan for k, scan in enumerate(scans) if k % 5]
    return agreement(map_of([kept], resolution_m), scans[::5], about_scans)


def main() -> None:
    if "TERRAFUSE_RECORDINGS" not in os.environ:
        sys.exit("set TERRAFUSE_RECORDINGS to the folder of recordings")
    rows = {}
    for log in LOGS:
        scans = scans_of(Path(os.environ["TERRAFUSE_RECORDINGS"]), log)
        for resolution_m in (0.1, 0.05):
            rows[f"{log}, {resolution_m} m"] = agreement(map_of(in_thirds(scans), resolution_m), scans)
        rows[f"{log}, 0.1 m, held out"] = held_out(scans, 0.1)
    print("## Occupancy: against the readings themselves\n")
    print(table(rows))


if __name__ == "__main__":
    main()
