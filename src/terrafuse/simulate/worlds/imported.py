"""Worlds from files: a DEM as ground; a ROS map or an image as the walls of an indoor place."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from terrafuse.errors import InputError
from terrafuse.rosmap import RosMap, read_map
from terrafuse.rosmap.files import read_image
from terrafuse.rosmap.meaning import Meaning
from terrafuse.rosmap.types import Placement
from terrafuse.simulate.blocks import Block
from terrafuse.simulate.quantities import File, Number, Resolution
from terrafuse.simulate.terrain import flat, terrain_of
from terrafuse.simulate.world import World
from terrafuse.types import Array, Bounds

WallHeight = Annotated[Number, Field(gt=0, le=1000)]
BELOW_M = 0.5
MARGIN_M = 1.0


def dem_world(file: File, bounds: Bounds | None = None, band: str | None = None) -> World:
    """Bare ground of a DEM, in its CRS; add houses and the rest with `dataclasses.replace`. Raises InputError."""
    terrain, crs = terrain_of(file, bounds, band)
    return World(Path(file).stem, bounds or terrain.bounds, terrain, crs=crs)


def ros_map_world(file: File, height_m: WallHeight = 2.5) -> World:
    """Walls of this height where a ROS map says occupied; unknown is as free. Raises InputError."""
    return _indoor(Path(file).stem, read_map(file), height_m)


def image_world(file: File, resolution_m: Resolution, height_m: WallHeight = 2.5) -> World:
    """The same from an image, black walls on white; its lower-left corner is the origin. Raises InputError."""
    if not Path(file).is_file():
        raise InputError(f"{file}: no such file; give an image")
    grey, opaque = read_image(Path(file))
    return _indoor(Path(file).stem, RosMap(Placement(resolution_m), Meaning(), grey, opaque), height_m)


def _indoor(name: str, plan: RosMap, height_m: float) -> World:
    if not (math.isfinite(height_m) and height_m > 0):
        raise InputError(f"walls {height_m} m high: give a positive number of metres")
    rectangles = merged(plan.probability[::-1] >= plan.meaning.occupied_thresh)
    blocks = tuple(_wall(plan.placement, rectangle, height_m) for rectangle in rectangles.tolist())
    west, south, east, north = plan.grid.bounds
    bounds = Bounds(west - MARGIN_M, south - MARGIN_M, east + MARGIN_M, north + MARGIN_M)
    return World(name, bounds, flat(bounds), furniture=blocks)


def _wall(place: Placement, rectangle: list[int], height_m: float) -> Block:
    """A rectangle i0, j0, i1, j1 of pixels, counted from the lower-left corner."""
    i0, j0, i1, j1 = rectangle
    r, c, s = place.resolution_m, math.cos(place.yaw_rad), math.sin(place.yaw_rad)
    u, v = r * (i0 + i1) / 2, r * (j0 + j1) / 2
    x, y = place.east_m + c * u - s * v, place.north_m + s * u + c * v
    return Block("wall", x, y, r * (i1 - i0), r * (j1 - j0), place.yaw_rad, -BELOW_M, height_m, height_m)


def merged(mask: Array) -> Array:
    """(K, 4) rectangles i0, j0, i1, j1, half open, that tile what is True in (H, W) [j, i].

    Runs along rows; a run that the row above repeats grows upward.
    """
    out: list[tuple[int, int, int, int]] = []
    grown: dict[tuple[int, int], int] = {}
    for j in range(len(mask) + 1):
        runs = _runs(mask[j]) if j < len(mask) else []
        same = set(runs)
        out += [(a, first, b, j) for (a, b), first in grown.items() if (a, b) not in same]
        grown = {run: grown.get(run, j) for run in runs}
    return np.array(out, np.int64).reshape(-1, 4)


def _runs(row: Array) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], row, [False]]).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
