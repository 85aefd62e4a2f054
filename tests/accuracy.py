"""Measures the map against truth that others surveyed or computed: python -m tests.accuracy

Prints the tables of docs/accuracy.md as Markdown. Needs TERRAFUSE_RECORDINGS.
"""

from __future__ import annotations

import json
import os
import platform
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from terrafuse.lattice import Lattice, default_tile_m
from terrafuse.logs import open_log
from terrafuse.mapper import Mapper
from terrafuse.models import make_model
from terrafuse.replica import Replica
from terrafuse.testing.deltas import scan_of
from terrafuse.types import Array, Scan
from terrafuse.views import chosen_layers, known_window, mosaic

STATIC = {"static": True}
AV2_LOG = "lidar3d/av2/7fab2350-7eaf-3b7e-a39d-6937a4c1bede"
STATISTICS = ("n", "z_mean", "z_var", "z_min", "z_max")


def scans_of(source: str) -> list[Scan]:
    return [record for record in open_log(source).scans() if isinstance(record, Scan)]


def map_of(scans: list[Scan], lattice: Lattice, settings: Mapping[str, object]) -> Replica:
    model = make_model("elevation", settings)
    mapper = Mapper("r1", lattice, model)
    for scan in scans:
        mapper.integrate(scan)
    replica = Replica(lattice, model)
    replica.apply(mapper.delta(0))
    return replica


def known_cells(replica: Replica, *layers: str) -> tuple[Array, Array, dict[str, Array]]:
    """(i, j, layers) of the known cells, each (K,), in rising (j, i) order."""
    window = known_window(replica)
    assert window is not None
    arrays = mosaic(replica, chosen_layers(replica, layers), window)
    j, i = np.nonzero(~np.isnan(arrays[layers[0]]))
    return i + window[0], j + window[1], {name: array[j, i] for name, array in arrays.items()}


# --- Argoverse 2: a surveyed ground raster ---------------------------------------------------------------------------


def av2_truth(folder: Path, x: Array, y: Array) -> Array:
    """The surveyed ground height at city coordinates, NaN off the raster."""
    (sim2,) = (folder / "map").glob("*img_Sim2_city.json")
    transform = json.loads(sim2.read_text())
    rotation, shift, scale = np.array(transform["R"]).reshape(2, 2), np.array(transform["t"]), transform["s"]
    (raster_file,) = (folder / "map").glob("*ground_height_surface*.npy")
    raster = np.load(raster_file).astype(np.float64)
    column, row = np.floor((rotation @ np.stack([x, y]) + shift[:, None]) * scale).astype(int)
    inside = (column >= 0) & (row >= 0) & (column < raster.shape[1]) & (row < raster.shape[0])
    heights = np.full(x.shape, np.nan)
    heights[inside] = raster[row[inside], column[inside]]
    return heights


def av2_errors(recordings: Path, resolution_m: float, settings: Mapping[str, object]) -> dict[str, float]:
    """How z_min of the cells compares with the surveyed ground."""
    lattice = Lattice(resolution_m, default_tile_m(resolution_m))
    replica = map_of(scans_of(str(recordings / AV2_LOG)), lattice, settings)
    i, j, layers = known_cells(replica, "z_min", "height")
    truth = av2_truth(recordings / AV2_LOG, lattice.cell_centre(i), lattice.cell_centre(j))
    on = ~np.isnan(truth)
    difference = layers["z_min"][on] - truth[on]
    near = np.abs(difference) <= 0.3
    return {
        "cells": len(i),
        "cells on the raster": int(on.sum()),
        "within 0.3 m": float(near.mean()),
        "0.3 m or more above": float((difference >= 0.3).mean()),
        "0.3 m or more below": float((difference <= -0.3).mean()),
        "median distance of z_min (m)": float(np.median(np.abs(difference[near]))),
        "median of z_min − raster (m)": float(np.median(difference[near])),
        "95 % of the distances (m)": float(np.quantile(np.abs(difference[near]), 0.95)),
    }


def av2_points(recordings: Path) -> dict[str, float]:
    """The same without any map: every point against the raster."""
    folder = recordings / AV2_LOG
    differences = []
    for scan in scans_of(str(folder)):
        T = scan.T_world_sensor.matrix
        world = scan.points.astype(np.float64) @ T[:3, :3].T + T[:3, 3]
        differences.append(world[:, 2] - av2_truth(folder, world[:, 0], world[:, 1]))
    difference = np.concatenate(differences)
    difference = difference[~np.isnan(difference)]
    near = np.abs(difference) <= 0.3
    return {"points": len(difference), "median distance (m)": float(np.median(np.abs(difference[near])))}


# --- PDAL: cell statistics that its own tests state ------------------------------------------------------------------


def pdal_grids(recordings: Path) -> tuple[dict[str, Array], dict[str, Array]]:
    """(ours, PDAL's) 5×5 grids of count, min, max, mean and stdev, north row first; NaN for no data.

    PDAL gives a point to every cell whose circle covers it; such a point is put once into the middle of each.
    """
    expected = json.loads((recordings / "expected/pdal_grid/expected.json").read_text())
    text = (recordings / "expected/pdal_grid/grid.txt").read_text().splitlines()[1:]
    points = np.array([[float(v) for v in line.split(",")] for line in text if line.strip()])
    centres = np.stack(np.meshgrid(np.arange(5) + 0.5, np.arange(5) + 0.5), axis=-1).reshape(-1, 2)
    covered = np.hypot(*(points[:, None, :2] - centres[None]).transpose(2, 0, 1)) < expected["radius"]
    point, cell = np.nonzero(covered)
    scan = scan_of(np.column_stack([centres[cell], points[point, 2]]))
    replica = map_of([scan], Lattice(1.0), STATIC)
    grids = mosaic(replica, chosen_layers(replica, STATISTICS), (0, 0, 5, 5))
    ours = {
        "count": np.nan_to_num(grids["n"]),
        "min": grids["z_min"],
        "max": grids["z_max"],
        "mean": grids["z_mean"],
        "stdev": np.sqrt(grids["z_var"]),
    }
    theirs = {name: np.array(expected[name], float) for name in ours}
    return (
        {name: grid[::-1] for name, grid in ours.items()},
        {name: np.where(grid == -9999, np.nan, grid) for name, grid in theirs.items()},
    )


# --- plain statistics over all points --------------------------------------------------------------------------------


def plain_statistics(scans: list[Scan], resolution_m: float) -> tuple[Array, Array, dict[str, Array]]:
    """(i, j, statistics) of every cell by NumPy in float64, in rising (j, i) order: what a static map must say."""
    world = []
    for scan in scans:
        p, T = scan.points.astype(np.float64), scan.T_world_sensor.matrix
        world.append(np.stack([T[a, 0] * p[:, 0] + T[a, 1] * p[:, 1] + T[a, 2] * p[:, 2] + T[a, 3] for a in range(3)]))
    x, y, z = np.concatenate(world, axis=1)
    ji = np.floor(np.stack([y, x]) * (1 / resolution_m)).astype(np.int64)
    cells, inverse, n = np.unique(ji, axis=1, return_inverse=True, return_counts=True)
    mean = np.bincount(inverse, z) / n
    variance = np.bincount(inverse, (z - mean[inverse]) ** 2) / n
    low, high = np.full(len(n), np.inf), np.full(len(n), -np.inf)
    np.minimum.at(low, inverse, z)
    np.maximum.at(high, inverse, z)
    return cells[1], cells[0], {"n": n, "z_mean": mean, "z_var": variance, "z_min": low, "z_max": high}


def worst_differences(scans: list[Scan], resolution_m: float) -> dict[str, float]:
    """The largest difference of each statistic over all cells; raises AssertionError if the cells differ."""
    lattice = Lattice(resolution_m, default_tile_m(resolution_m))
    i, j, ours = known_cells(map_of(scans, lattice, STATIC), *STATISTICS)
    plain_i, plain_j, plain = plain_statistics(scans, resolution_m)
    np.testing.assert_array_equal(i, plain_i)
    np.testing.assert_array_equal(j, plain_j)
    return {"cells": len(i), **{name: float(np.abs(ours[name] - plain[name]).max()) for name in STATISTICS}}


def shifted(scans: list[Scan], east_m: float, north_m: float, up_m: float) -> list[Scan]:
    return [Scan(s.stamp_ns, s.points, s.T_world_sensor.shifted(east_m, north_m, up_m)) for s in scans]


def statistics_cases(recordings: Path) -> Iterator[tuple[str, list[Scan], float]]:
    """(name, scans, resolution) of what is compared with plain statistics."""
    kitti = scans_of(f"{recordings / 'lidar3d/patchworkpp_kitti'}?poses=poses_velo_first6.txt&calib=identity")
    yield "KITTI 00, 0.1 m", kitti, 0.1
    yield "KITTI 00, 0.1 m, at 500,000 E 4,000,000 N 1000 m", shifted(kitti, 500_000, 4_000_000, 1000), 0.1
    autzen = scans_of(str(recordings / "airborne/pdal/autzen_trim.laz"))
    yield "autzen_trim, 0.5 m", autzen, 0.5
    yield "autzen_trim, 0.5 m, 4,000,000 m further north, 1000 m up", shifted(autzen, 0, 4_000_000, 1000), 0.5


# --- the tables ------------------------------------------------------------------------------------------------------


def table(rows: Mapping[str, Mapping[str, float]]) -> str:
    """A Markdown table with a column for each entry of `rows`."""
    names = list(next(iter(rows.values())))
    lines = ["| | " + " | ".join(rows) + " |", "|---|" + "---|" * len(rows)]
    for name in names:
        values = [row.get(name, float("nan")) for row in rows.values()]
        texts = [f"{v:,}" if isinstance(v, int) else f"{v:.2e}" if 0 < abs(v) < 1e-3 else f"{v:.4f}" for v in values]
        lines.append(f"| {name} | " + " | ".join(texts) + " |")
    return "\n".join(lines)


def main() -> None:
    if "TERRAFUSE_RECORDINGS" not in os.environ:
        sys.exit("set TERRAFUSE_RECORDINGS to the folder of recordings")
    recordings = Path(os.environ["TERRAFUSE_RECORDINGS"])
    print(f"Measured with `make accuracy`, Python {platform.python_version()}, NumPy {np.__version__}.\n")
    print("## Argoverse 2, log 7fab2350: against the surveyed ground raster\n")
    rows = {
        f"{resolution} m{', static' if settings else ''}": av2_errors(recordings, resolution, settings)
        for resolution in (0.1, 0.2, 0.5)
        for settings in ({}, STATIC)
    }
    print(table(rows) + "\n")
    points = av2_points(recordings)
    print(f"All {points['points']:,} points on the raster, no map: median {points['median distance (m)']:.4f} m.\n")
    print("## PDAL's grid: largest difference in any cell\n")
    ours, theirs = pdal_grids(recordings)
    print(table({name: {"difference": float(np.nanmax(np.abs(ours[name] - theirs[name])))} for name in ours}) + "\n")
    print("## Statistics against plain NumPy in float64 over all points: largest difference in any cell\n")
    print(table({name: worst_differences(scans, r) for name, scans, r in statistics_cases(recordings)}))


if __name__ == "__main__":
    main()
