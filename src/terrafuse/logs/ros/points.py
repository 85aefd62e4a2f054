"""PointCloud2 and LaserScan → points, whatever their layout, without a loop over points."""

from __future__ import annotations

from typing import Any

import numpy as np

from terrafuse.errors import LogError
from terrafuse.logs.options import listed
from terrafuse.types import Array

POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
LASER_SCAN = "sensor_msgs/msg/LaserScan"

FLOATS = {7: "f4", 8: "f8"}
"""PointField datatypes that a coordinate can have."""


def points_of(message: Any, kind: str, where: str) -> Array:
    """(N, 3) float32, or float64 where a coordinate has it, in the sensor's frame. `where` is for errors."""
    return laser_points(message) if kind == LASER_SCAN else cloud_points(message, where)


def cloud_points(message: Any, where: str) -> Array:
    """Row-major, padding skipped, byte order as the message says. Raises LogError."""
    layout = _layout(message, where)
    shape = (int(message.height), int(message.width))
    needed = shape[0] * int(message.row_step)
    if len(message.data) < needed or int(message.row_step) < shape[1] * layout.itemsize:
        raise LogError(
            f"{where}: {len(message.data)} bytes of data do not hold {shape[0]} rows × {shape[1]} points of "
            f"{layout.itemsize} bytes (row_step {message.row_step}); the recording is damaged"
        )
    if 0 in shape:
        return np.empty((0, 3), np.float32)
    data = np.ascontiguousarray(message.data)
    grid: Array = np.ndarray(shape, layout, data, strides=(int(message.row_step), layout.itemsize))
    double = any(layout[axis].itemsize == 8 for axis in range(3))
    points = np.empty((*shape, 3), np.float64 if double else np.float32)
    for axis, name in enumerate("xyz"):
        points[..., axis] = grid[name]
    return points.reshape(-1, 3)


def _layout(message: Any, where: str) -> np.dtype[np.void]:
    fields = {field.name: field for field in message.fields}
    if not {"x", "y", "z"} <= fields.keys():
        raise LogError(f"{where}: the cloud has no fields x, y, z but {listed(fields)}")
    for name in "xyz":
        if fields[name].datatype not in FLOATS:
            raise LogError(
                f"{where}: field {name} has datatype {fields[name].datatype}, not float32 (7) or float64 (8)"
            )
    order = ">" if message.is_bigendian else "<"
    return np.dtype(
        {
            "names": ["x", "y", "z"],
            "formats": [order + FLOATS[fields[name].datatype] for name in "xyz"],
            "offsets": [int(fields[name].offset) for name in "xyz"],
            "itemsize": int(message.point_step),
        }
    )


def laser_points(message: Any) -> Array:
    """(N, 3) float64 at z = 0, without the NaN, infinite and out of [range_min, range_max] beams.

    All beams count as of the header's stamp: motion during the hundredths of a second of a sweep is not undone.
    """
    ranges = np.asarray(message.ranges, np.float64)
    seen = (ranges >= message.range_min) & (ranges <= message.range_max) & np.isfinite(ranges)
    angles = message.angle_min + message.angle_increment * np.flatnonzero(seen)
    return np.stack([ranges[seen] * np.cos(angles), ranges[seen] * np.sin(angles), np.zeros(len(angles))], axis=1)
