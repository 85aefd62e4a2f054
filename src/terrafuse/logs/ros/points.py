"""PointCloud2 and LaserScan → scans, whatever their layout, without a loop over points."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from terrafuse.errors import LogError
from terrafuse.logs.options import listed
from terrafuse.types import Array, NoReturns, Pose, Readings, Scan, Stamp

POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
LASER_SCAN = "sensor_msgs/msg/LaserScan"

FLOATS = {7: "f4", 8: "f8"}
"""PointField datatypes that a coordinate can have."""


def cloud_points(message: Any, where: str) -> Array:
    """(N, 3) float32, or float64 where a coordinate has it: row-major, padding skipped, byte order as it says.

    `where` is for errors. Raises LogError.
    """
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


def cloud_scan(message: Any, where: str, stamp_ns: Stamp, T_world_sensor: Pose) -> Scan:
    return Scan(stamp_ns, cloud_points(message, where), T_world_sensor)


def laser_scan(message: Any, where: str, stamp_ns: Stamp, T_world_sensor: Pose) -> Scan:
    """Points at z = 0, float64: the beams within [range_min, range_max].

    REP 117: +inf says that there was likely nothing within range; NaN and -inf say nothing. Finite readings beyond the
    limits are older drivers' codes, and what they mean the message does not say. All beams count as of the header's
    stamp: motion during the hundredths of a second of a sweep is not undone.
    """
    ranges = np.asarray(message.ranges, np.float64)
    angles = message.angle_min + message.angle_increment * np.arange(len(ranges))
    directions = np.stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))], axis=1)
    seen = (ranges >= message.range_min) & (ranges <= message.range_max) & np.isfinite(ranges)
    has_limit = 0 < message.range_max < np.inf
    clear = np.isposinf(ranges) & has_limit
    silent = ~seen & ~clear
    return Scan(
        stamp_ns,
        ranges[seen, None] * directions[seen],
        T_world_sensor,
        misses=message.range_max * directions[clear],
        no_returns=NoReturns(directions[silent], ranges[silent]),
        readings=Readings(ranges, seen, directions, float(message.range_max) if has_limit else np.inf),
    )


READ: dict[str, Callable[[Any, str, Stamp, Pose], Scan]] = {POINT_CLOUD: cloud_scan, LASER_SCAN: laser_scan}
"""How a message of each type becomes a scan: message, where it is (for errors), stamp, pose."""
