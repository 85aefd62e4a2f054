"""Measures the terrain model against truth: python -m tests.accuracy_terrain

Prints the tables of docs/accuracy.md as Markdown. The part on surveyed ground needs TERRAFUSE_RECORDINGS.
"""

from __future__ import annotations

import math
import os
import platform
import zipfile
from pathlib import Path

import numpy as np

from terrafuse.kernels.terrain import GRADIENTS
from terrafuse.lattice import Lattice
from terrafuse.mapper import Mapper
from terrafuse.models.terrain import Terrain
from terrafuse.replica import Replica
from terrafuse.testing.analytic.scene import Scene, covered, scan, truth
from terrafuse.testing.analytic.world import LIDAR, ROUNDS, SCENE, T_BASE_SENSOR, pose_on
from terrafuse.testing.deltas import SECOND_NS, scan_of
from terrafuse.types import Array, Floats, Pose, Scan
from terrafuse.views import chosen_layers, mosaic, window_of
from tests.accuracy import AV2_LOG, table

STILL = Scene(SCENE.ground, SCENE.boxes)
ANY_RANGE = Terrain(max_range_m=1e8)
BESIDE_WALLS_M = 0.06
"""Three sigma of the range: so far beside a wall do points of it lie."""


# --- planes of known slope -------------------------------------------------------------------------------------------


def plane_errors(
    points: int, noise_m: float, seed: int = 0, side: int = 40, model: Terrain = ANY_RANGE
) -> tuple[Floats, Floats]:
    """(errors (K, 3), their standard errors (K, 3)) of height at the centre and both gradients, of K random planes.

    Cells of 0.5 m without neighbours, with so many points each, uniform within. The standard errors are least squares'
    own, σ √diag((XᵀX)⁻¹), X = [1 x y] from the cell's centre. Where the model takes no plane, errors are NaN.
    """
    rng, lattice = np.random.default_rng(seed), Lattice(0.5, float(side))
    truths = rng.uniform((-5, -0.5, -0.5), (5, 0.5, 0.5), (side * side, 3))
    X = np.ones((side * side, points, 3))
    X[..., 1:] = rng.uniform(-0.25, 0.25, (side * side, points, 2))
    z = np.einsum("kni,ki->kn", X, truths) + rng.normal(0, noise_m, X.shape[:2])
    j, i = np.divmod(np.arange(side * side), side)
    centre = 0.5 * (2 * np.stack([i, j], axis=-1) + 0.5)[:, None]
    cloud = np.concatenate([X[..., 1:] + centre, z[..., None]], axis=2).reshape(-1, 3)
    patch = model.observer(lattice)(scan_of(cloud))
    records = patch.records[np.argsort(patch.at)]
    found = np.stack([records[name] for name in ("height", "gradient_x", "gradient_y")], axis=-1)
    found[records["flags"] & GRADIENTS == 0] = np.nan
    standard = noise_m * np.sqrt(np.diagonal(np.linalg.inv(X.swapaxes(1, 2) @ X), axis1=1, axis2=2))
    return found - truths, standard


def plane_table() -> dict[str, dict[str, float]]:
    rows = {}
    for points in (3, 5, 20, 200, 10_000):
        error, standard = plane_errors(points, 0.01, side=40 if points <= 200 else 10)
        made = np.isfinite(error[:, 0])
        error, standard = error[made], standard[made]
        rows[f"{points} points"] = {
            "planes": int(made.sum()),
            "on a line, for all that is known": int((~made).sum()),
            "RMS error of gradient_x": float(np.sqrt(np.mean(error[:, 1] ** 2))),
            "its standard error (RMS)": float(np.sqrt(np.mean(standard[:, 1] ** 2))),
            "RMS of error / standard error": float(np.sqrt(np.mean((error / standard) ** 2))),
            "within one standard error": float(np.mean(np.abs(error) <= standard)),
            "within two": float(np.mean(np.abs(error) <= 2 * standard)),
        }
    return rows


# --- digital elevation models ----------------------------------------------------------------------------------------


def surveyed_ground(recordings: Path) -> tuple[Floats, float]:
    """(heights (H, W), metres a cell) of the ground raster of an Argoverse 2 log, NaN where there is none."""
    (raster,) = (recordings / AV2_LOG / "map").glob("*ground_height_surface*.npy")
    return np.load(raster).astype(np.float64), 0.3


def island(recordings: Path) -> tuple[Floats, float]:
    """The same of an SRTM tile: Clipperton, some 30 m a cell; the sea around is level."""
    with zipfile.ZipFile(recordings / "rasters/rasterio/N10W110.hgt.zip") as archive:
        raw = np.frombuffer(archive.read("N10W110.hgt"), ">i2").reshape(1201, 1201)
    (j,), (i,) = (np.flatnonzero(raw.any(axis=axis)).reshape(1, -1) for axis in (1, 0))
    return raw[j.min() - 2 : j.max() + 3, i.min() - 2 : i.max() + 3].astype(np.float64), 30.0


def gradients_of(heights: Floats, cell_m: float) -> dict[str, Floats]:
    """The model's layers of a raster, (H, W), of one point at the centre of each cell: the four-neighbour method."""
    side = 1 << max(heights.shape).bit_length()
    lattice, model = Lattice(cell_m, side * cell_m), Terrain(max_range_m=1e8)
    j, i = np.nonzero(~np.isnan(heights))
    points = np.column_stack([(i + 0.5) * cell_m, (j + 0.5) * cell_m, heights[j, i]])
    mapper = Mapper("r", lattice, model)
    mapper.integrate(scan_of(points))
    replica = Replica(lattice, model)
    replica.apply(mapper.delta())
    return mosaic(replica, chosen_layers(replica, None), (0, 0, heights.shape[1], heights.shape[0]))


def dem_differences(heights: Floats, cell_m: float) -> dict[str, float]:
    """How the gradients differ from np.gradient's, which is central inside and one-sided at the raster's edges."""
    layers = gradients_of(heights, cell_m)
    north, east = np.gradient(heights, cell_m)
    both = ~np.isnan(north) & ~np.isnan(east) & ~np.isnan(heights)
    slope = np.hypot(east, north)[both]
    return {
        "cells": int((~np.isnan(heights)).sum()),
        "cells with both gradients of NumPy": int(both.sum()),
        "steepest slope": float(slope.max()),
        "largest difference of gradient_x": float(np.abs(layers["gradient_x"] - east)[both].max()),
        "largest difference of gradient_y": float(np.abs(layers["gradient_y"] - north)[both].max()),
        "largest difference of occupation": float(
            np.abs(layers["occupation"][both] - np.clip(slope / 0.3, 0, 1)).max()
        ),
    }


# --- is it right to be sure? -----------------------------------------------------------------------------------------


def lap(robot: str, scans: int, tilt_rad: float, shift_m: float) -> list[Scan]:
    """So many scans of a robot's round in the analytic world, poses in error by so much (standard deviations)."""
    rng = np.random.default_rng([1, list(ROUNDS).index(robot)])
    out = []
    for k in range(scans):
        T = pose_on(STILL.ground, *ROUNDS[robot].place(30.0 * k / scans)) @ T_BASE_SENSOR
        points = scan(STILL, LIDAR, T, 0.0, rng)
        error = Pose.from_quaternion(rng.normal(0, shift_m, 3), [*rng.normal(0, tilt_rad / 2, 3), 1.0])
        out.append(Scan(k * 30 * SECOND_NS // scans, points, T @ error))
    return out


def map_of(laps: list[list[Scan]], resolution_m: float) -> Replica:
    model, lattice = Terrain(max_range_m=LIDAR.max_range_m), Lattice(resolution_m)
    replica = Replica(lattice, model)
    for k, scans in enumerate(laps):
        mapper = Mapper(f"r{k}", lattice, model)
        for one in scans:
            mapper.integrate(one)
        replica.apply(mapper.delta())
    return replica


def errors(replica: Replica) -> dict[str, Floats]:
    """Of the cells away from walls: confidence, error of height in m, error of the gradient and the standard error that
    the map states of it, and occupation; NaN where unknown."""
    window, lattice = window_of(replica, None), replica.lattice
    layers = mosaic(replica, chosen_layers(replica, None), window)
    i0, j0, i1, j1 = window
    x, y = np.meshgrid(lattice.cell_centre(np.arange(i0, i1)), lattice.cell_centre(np.arange(j0, j1)))
    margin_m = lattice.resolution_m * math.sqrt(0.5) + BESIDE_WALLS_M
    on_roof = covered(STILL, lattice, window, -margin_m)
    clear = ~np.isnan(layers["height"]) & (on_roof | ~covered(STILL, lattice, window, margin_m))
    east, north = (np.where(on_roof, 0.0, gradient) for gradient in STILL.ground.gradient(x, y))
    out = {
        "height": np.abs(layers["height"] - truth(STILL, lattice, window)),
        "gradient": np.hypot(layers["gradient_x"] - east, layers["gradient_y"] - north),
        **{name: layers[name] for name in ("confidence", "gradient_error", "occupation")},
    }
    return {name: values[clear] for name, values in out.items()}


def thirds(replica: Replica) -> dict[str, dict[str, float]]:
    """Errors of the cells by thirds of their confidence."""
    found = errors(replica)
    rank = np.argsort(np.argsort(found["confidence"], kind="stable"))
    third: Array = 3 * rank // len(rank)
    names = ("bottom third", "middle third", "top third")
    return {name: figures({what: some[third == k] for what, some in found.items()}) for k, name in enumerate(names)}


def figures(found: dict[str, Floats]) -> dict[str, float]:
    height, gradient, stated = (found[name] for name in ("height", "gradient", "gradient_error"))
    told = ~np.isnan(found["occupation"])
    return {
        "cells": len(height),
        "median confidence": float(np.median(found["confidence"])),
        "RMSE of height (m)": float(np.sqrt(np.mean(height**2))),
        "95 % of height errors (m)": float(np.quantile(height, 0.95)),
        "95 % of gradient errors": float(np.nanquantile(gradient, 0.95)),
        "gradients within three stated errors": float((gradient <= 3 * stated)[~np.isnan(gradient)].mean()),
        "gradient unknown": float(np.isnan(gradient).mean()),
        "95 % of gradient errors where there is an occupation": float(np.nanquantile(gradient[told], 0.95)),
        "occupation unknown": float((~told).mean()),
    }


def calibration(
    scans: int, tilt_deg: float, shift_m: float, resolution_m: float, robots: int
) -> dict[str, dict[str, float]]:
    laps = [lap(robot, scans, math.radians(tilt_deg), shift_m) for robot in list(ROUNDS)[:robots]]
    return thirds(map_of(laps, resolution_m))


CASES = {
    "0.5 m, one robot's lap": (60, 0.0, 0.0, 0.5, 1),
    "the same, poses off by 0.2° and 2 cm": (60, 0.2, 0.02, 0.5, 1),
    "0.2 m, two robots' laps": (60, 0.0, 0.0, 0.2, 2),
    "the same, poses off": (60, 0.2, 0.02, 0.2, 2),
    "0.2 m, a single scan": (1, 0.0, 0.0, 0.2, 1),
    "the same, pose off": (1, 0.2, 0.02, 0.2, 1),
}
"""What `calibration` is asked for."""


FIGURES = (
    "RMSE of height (m)",
    "95 % of gradient errors",
    "gradients within three stated errors",
    "gradient unknown",
    "95 % of gradient errors where there is an occupation",
    "occupation unknown",
)


def main() -> None:
    print(f"Measured with `make accuracy`, Python {platform.python_version()}, NumPy {np.__version__}.\n")
    print("### Planes of known slope, 0.5 m cells, 1 cm of noise\n")
    print(table(plane_table()) + "\n")
    cases = {name: calibration(*case) for name, case in CASES.items()}
    for figure in FIGURES:
        print(f"### Thirds of confidence: {figure}\n")
        names = cases[next(iter(cases))]
        print(table({third: {name: case[third][figure] for name, case in cases.items()} for third in names}) + "\n")
    if "TERRAFUSE_RECORDINGS" in os.environ:
        recordings = Path(os.environ["TERRAFUSE_RECORDINGS"])
        print("### Gradients of rasters against np.gradient\n")
        dems = {"surveyed ground, 0.3 m": surveyed_ground(recordings), "SRTM island, 30 m": island(recordings)}
        print(table({name: dem_differences(*dem) for name, dem in dems.items()}))


if __name__ == "__main__":
    main()
