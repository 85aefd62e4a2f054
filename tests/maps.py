"""Small rasters and ROS maps as files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from terrafuse.rosmap import Meaning, Placement, RosMap, write_map
from terrafuse.types import Array


def write_raster(
    path: Path, heights: Any, west: float = 0.0, north: float = 0.0, side_m: float = 1.0, **profile: Any
) -> Path:
    """A GeoTIFF of rows from the north; NaN is its nodata unless `profile` says otherwise."""
    import rasterio
    from rasterio import Affine

    values = np.atleast_2d(np.asarray(heights, profile.pop("dtype", "float64")))
    about: dict[str, Any] = {"nodata": np.nan, "transform": Affine(side_m, 0, west, 0, -side_m, north)} | profile
    rows, columns = values.shape
    with rasterio.open(path, "w", "GTiff", columns, rows, 1, dtype=values.dtype, **about) as raster:
        raster.write(values, 1)
    return path


def write_ros(path: Path, grey: Array, meaning: Meaning | None = None, placement: Placement | None = None) -> Path:
    """A ROS map of these greys, with a PGM beside it."""
    image = path.with_suffix(".pgm")
    ros_map = RosMap(placement or Placement(0.1), meaning or Meaning(), np.asarray(grey, np.uint8))
    write_map(ros_map, path, image, image.name)
    return path
