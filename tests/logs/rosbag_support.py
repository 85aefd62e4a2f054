"""Bags written by rosbags itself: ROS 1, ROS 2 sqlite3 and mcap, with the same messages."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from terrafuse.types import Array

KINDS = ("bag", "db3", "mcap")
CLOUD, LASER = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/LaserScan"
TF, ODOM = "tf2_msgs/msg/TFMessage", "nav_msgs/msg/Odometry"
POSE, POSE_COVARIANCE = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped"

Entry = tuple[str, str, int, Callable[["Maker"], Any]]
"""Topic, type, stamp in ns, and what makes the message."""


class Maker:
    def __init__(self, kind: str) -> None:
        self.ros1 = kind == "bag"
        self.store = get_typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_HUMBLE)
        if self.ros1:
            self.store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))

    def make(self, kind: str, /, **fields: Any) -> Any:
        return self.store.types[kind](**fields)

    def header(self, stamp_ns: int, frame: str) -> Any:
        stamp = self.make("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
        sequence = {"seq": 0} if self.ros1 else {}
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **sequence)

    def vector(self, kind: str, numbers: Iterable[float]) -> Any:
        return self.make(f"geometry_msgs/msg/{kind}", **dict(zip("xyzw", map(float, numbers), strict=False)))

    def pose(self, numbers: Any) -> Any:
        place, turn = self.vector("Point", numbers[:3]), self.vector("Quaternion", numbers[3:])
        return self.make("geometry_msgs/msg/Pose", position=place, orientation=turn)


def cloud(
    stamp_ns: int,
    records: Any,
    frame: str = "lidar",
    *,
    height: int = 1,
    row_padding: int = 0,
    big_endian: bool = False,
) -> Entry:
    """`records`: a structured array whose fields become the cloud's, or (N, 3) points."""
    if records.dtype.names is None:
        records = np.ascontiguousarray(records).view([(name, records.dtype) for name in "xyz"]).reshape(-1)
    codes = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
    step, width = records.dtype.itemsize, len(records) // height
    rows = records.reshape(height, width)
    data = b"".join(row.tobytes() + b"\xee" * row_padding for row in rows)

    def message(maker: Maker) -> Any:
        fields = [
            maker.make(
                "sensor_msgs/msg/PointField",
                name=name,
                offset=records.dtype.fields[name][1],
                datatype=codes[records.dtype.fields[name][0].str[1:]],
                count=1,
            )
            for name in records.dtype.names
        ]
        return maker.make(
            CLOUD,
            header=maker.header(stamp_ns, frame),
            height=height,
            width=width,
            fields=fields,
            is_bigendian=big_endian,
            point_step=step,
            row_step=step * width + row_padding,
            data=np.frombuffer(data, np.uint8),
            is_dense=True,
        )

    return ("/points", CLOUD, stamp_ns, message)


def laser(stamp_ns: int, ranges: list[float], frame: str = "laser", topic: str = "/scan") -> Entry:
    def message(maker: Maker) -> Any:
        return maker.make(
            LASER,
            header=maker.header(stamp_ns, frame),
            angle_min=0.0,
            angle_max=float(np.pi / 2 * (len(ranges) - 1)),
            angle_increment=float(np.pi / 2),
            time_increment=0.0,
            scan_time=0.1,
            range_min=0.5,
            range_max=10.0,
            ranges=np.array(ranges, np.float32),
            intensities=np.empty(0, np.float32),
        )

    return (topic, LASER, stamp_ns, message)


def tf(stamp_ns: int, parent: str, child: str, numbers: Any, topic: str = "/tf") -> Entry:
    """`numbers`: x y z qx qy qz qw."""

    def message(maker: Maker) -> Any:
        transform = maker.make(
            "geometry_msgs/msg/Transform",
            translation=maker.vector("Vector3", numbers[:3]),
            rotation=maker.vector("Quaternion", numbers[3:]),
        )
        stamped = maker.make(
            "geometry_msgs/msg/TransformStamped",
            header=maker.header(stamp_ns, parent),
            child_frame_id=child,
            transform=transform,
        )
        return maker.make(TF, transforms=[stamped])

    return (topic, TF, stamp_ns, message)


def odometry(stamp_ns: int, numbers: Any, world: str = "odom", child: str = "base_link", topic: str = "/odom") -> Entry:
    def message(maker: Maker) -> Any:
        zero = maker.vector("Vector3", (0, 0, 0))
        twist = maker.make("geometry_msgs/msg/Twist", linear=zero, angular=zero)
        return maker.make(
            ODOM,
            header=maker.header(stamp_ns, world),
            child_frame_id=child,
            pose=maker.make("geometry_msgs/msg/PoseWithCovariance", pose=maker.pose(numbers), covariance=np.zeros(36)),
            twist=maker.make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
        )

    return (topic, ODOM, stamp_ns, message)


def stamped_pose(stamp_ns: int, numbers: Any, world: str = "map", kind: str = POSE) -> Entry:
    def message(maker: Maker) -> Any:
        given = maker.pose(numbers)
        if kind == POSE_COVARIANCE:
            given = maker.make("geometry_msgs/msg/PoseWithCovariance", pose=given, covariance=np.zeros(36))
        return maker.make(kind, header=maker.header(stamp_ns, world), pose=given)

    return ("/pose", kind, stamp_ns, message)


def text(stamp_ns: int) -> Entry:
    return ("/rosout", "std_msgs/msg/String", stamp_ns, lambda m: m.make("std_msgs/msg/String", data="hello"))


def moving(entry: Entry, topic: str) -> Entry:
    """The same message on another topic."""
    return (topic, *entry[1:])


def write_bag(folder: Path, kind: str, entries: list[Entry]) -> Path:
    """A .bag, or a ROS 2 bag folder with one .db3 or .mcap file."""
    maker = Maker(kind)
    path = folder / ("drive.bag" if kind == "bag" else f"drive_{kind}")
    if kind == "bag":
        writer: Any = Writer1(path)
    else:
        writer = Writer2(
            path, version=9, storage_plugin=StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        )
    serialize = maker.store.serialize_ros1 if kind == "bag" else maker.store.serialize_cdr
    with writer:
        connections: dict[str, Any] = {}
        for topic, message_type, stamp_ns, make in entries:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, message_type, typestore=maker.store)
            writer.write(connections[topic], stamp_ns, serialize(make(maker), message_type))
    return path


def points_as(layout: list[tuple[str, str]], points: Array, order: str = "<") -> Any:
    """A structured array with these fields, x y z from the points, all else 7."""
    records = np.full(len(points), 7, dtype=[(name, order + kind) for name, kind in layout])
    for axis, name in enumerate("xyz"):
        records[name] = points[:, axis]
    return records
