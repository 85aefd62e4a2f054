"""Writes ROS 2 MCAP files that `ros2 bag play`, Foxglove and the `ros` reader take."""

from __future__ import annotations

import os
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from terrafuse.errors import LogError
from terrafuse.logs.libraries import library
from terrafuse.logs.options import NS
from terrafuse.logs.trajectory import quaternion_of
from terrafuse.types import Array, Pose, Stamp

TOPICS = {
    "/points": "sensor_msgs/msg/PointCloud2",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/odom": "nav_msgs/msg/Odometry",
}
LATCHED = (
    "- history: 1\n  depth: 1\n  reliability: 1\n  durability: 1\n"
    "  deadline: {sec: 9223372036, nsec: 854775807}\n  lifespan: {sec: 9223372036, nsec: 854775807}\n"
    "  liveliness: 1\n  liveliness_lease_duration: {sec: 9223372036, nsec: 854775807}\n"
    "  avoid_ros_namespace_conventions: false\n"
)
"""Players must offer /tf_static transient-local, or nodes that start later never see it."""

WORLD, BASE = "map", "base_link"
LAST_STAMP = 2**31 * NS  # ROS time has signed 32-bit seconds


class McapRecorder:
    """Context manager; the file appears under its name only when the block ends without an exception.

    `frame` is that of the clouds. It lies at base_link itself unless `static` says where.
    """

    def __init__(self, path: Path | str, frame: str = "lidar") -> None:
        self.path = Path(path)
        self.frame = frame
        self._part = self.path.with_name(f".{self.path.name}.part")
        self._has_static = frame == BASE
        self._first_stamp: Stamp = 0
        self._empty = True

    def __enter__(self) -> Self:
        writer = library("mcap.writer", "recording MCAP", "ros")
        typesys = library("rosbags.typesys", "recording MCAP", "ros")
        self._store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
        self._file = self._part.open("wb")
        self._writer = writer.Writer(self._file)
        self._writer.start(profile="ros2", library="terrafuse")
        self._channels = {topic: self._channel(topic, kind) for topic, kind in TOPICS.items()}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self._finish()
                self._file.close()
                os.replace(self._part, self.path)
        finally:
            self._file.close()
            self._part.unlink(missing_ok=True)

    def scan(self, stamp_ns: Stamp, points: Array) -> None:
        """A PointCloud2 on /points of (N, 3) points in `frame`, kept as float32."""
        xyz = np.ascontiguousarray(points, "<f4").reshape(-1, 3)
        message = self._message(
            "/points",
            header=self._header(stamp_ns, self.frame),
            height=1,
            width=len(xyz),
            fields=[self._field(name, 4 * axis) for axis, name in enumerate("xyz")],
            is_bigendian=False,
            point_step=12,
            row_step=12 * len(xyz),
            data=xyz.reshape(-1).view(np.uint8),
            is_dense=bool(np.isfinite(xyz).all()),
        )
        self._write("/points", stamp_ns, message)

    def pose(self, stamp_ns: Stamp, T_world_base: Pose) -> None:
        """The transform map → base_link on /tf, and the same as Odometry on /odom."""
        self._write("/tf", stamp_ns, self._transform(stamp_ns, WORLD, BASE, T_world_base))
        covariance = np.zeros(36)
        twist = self._type(
            "geometry_msgs/msg/Twist", linear=self._vector(np.zeros(3)), angular=self._vector(np.zeros(3))
        )
        place = self._type("geometry_msgs/msg/Point", **_xyz(T_world_base.position))
        pose = self._type("geometry_msgs/msg/Pose", position=place, orientation=self._quaternion(T_world_base))
        message = self._message(
            "/odom",
            header=self._header(stamp_ns, WORLD),
            child_frame_id=BASE,
            pose=self._type("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=covariance),
            twist=self._type("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=covariance),
        )
        self._write("/odom", stamp_ns, message)

    def static(self, T_base_sensor: Pose) -> None:
        """The mounting, base_link → `frame`, on /tf_static; the last one counts for the whole file."""
        if self.frame == BASE:
            raise LogError(
                f"{self.path}: the clouds are in {BASE} itself; give McapRecorder another frame to mount one"
            )
        self._has_static = True
        stamp_ns = self._first_stamp
        self._write("/tf_static", stamp_ns, self._transform(stamp_ns, BASE, self.frame, T_base_sensor))

    def _finish(self) -> None:
        if not self._has_static:
            self.static(Pose.identity())
        self._writer.finish()
        self._file.flush()
        os.fsync(self._file.fileno())

    def _channel(self, topic: str, kind: str) -> int:
        definition, _ = self._store.generate_msgdef(kind, ros_version=2)
        schema = self._writer.register_schema(name=kind, encoding="ros2msg", data=definition.encode())
        qos = {"offered_qos_profiles": LATCHED} if topic == "/tf_static" else {}
        channel: int = self._writer.register_channel(topic, "cdr", schema, metadata=qos)
        return channel

    def _write(self, topic: str, stamp_ns: Stamp, message: Any) -> None:
        if self._empty and topic != "/tf_static":
            self._first_stamp, self._empty = stamp_ns, False
        data = bytes(self._store.serialize_cdr(message, TOPICS[topic]))
        self._writer.add_message(self._channels[topic], log_time=stamp_ns, publish_time=stamp_ns, data=data)

    def _type(self, kind: str, /, **fields: Any) -> Any:
        return self._store.types[kind](**fields)

    def _message(self, topic: str, **fields: Any) -> Any:
        return self._type(TOPICS[topic], **fields)

    def _header(self, stamp_ns: Stamp, frame: str) -> Any:
        if not 0 <= stamp_ns < LAST_STAMP:
            raise LogError(
                f"{self.path}: stamp {stamp_ns} ns is outside ROS time; give nanoseconds since 1970, to 2038"
            )
        seconds, nanoseconds = divmod(int(stamp_ns), NS)
        stamp = self._type("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
        return self._type("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def _field(self, name: str, offset: int) -> Any:
        return self._type("sensor_msgs/msg/PointField", name=name, offset=offset, datatype=7, count=1)

    def _vector(self, xyz: Array) -> Any:
        return self._type("geometry_msgs/msg/Vector3", **_xyz(xyz))

    def _quaternion(self, pose: Pose) -> Any:
        x, y, z, w = map(float, quaternion_of(pose))
        return self._type("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)

    def _transform(self, stamp_ns: Stamp, parent: str, child: str, T_parent_child: Pose) -> Any:
        transform = self._type(
            "geometry_msgs/msg/Transform",
            translation=self._vector(T_parent_child.position),
            rotation=self._quaternion(T_parent_child),
        )
        stamped = self._type(
            "geometry_msgs/msg/TransformStamped",
            header=self._header(stamp_ns, parent),
            child_frame_id=child,
            transform=transform,
        )
        return self._message("/tf", transforms=[stamped])


def _xyz(vector: Array) -> dict[str, float]:
    return {"x": float(vector[0]), "y": float(vector[1]), "z": float(vector[2])}
