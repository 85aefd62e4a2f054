"""ROS recordings. The small pose messages are read when the log is opened, the clouds one at a time after."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

from terrafuse.errors import LogError
from terrafuse.logs.base import Log, Reader, Record, Source
from terrafuse.logs.options import MAX_GAP_HELP, listed
from terrafuse.logs.ros.bag import Topic, bag_file, frame_of, is_bag, messages, opened, stamp_of, topics_of
from terrafuse.logs.ros.motion import Motion, Recording, motion_of
from terrafuse.logs.ros.points import LASER_SCAN, POINT_CLOUD, READ
from terrafuse.logs.trajectory import PoseAt, placed_scan


def open_ros(source: Source) -> Log:
    path = bag_file(source.path)
    with opened(path) as bag:
        topics = topics_of(bag)
        topic = _cloud_topic(source, topics)
        _, first = next(messages(bag, topic, path))
        frame = frame_of(first.header.frame_id)
        motion = motion_of(Recording(source, path, bag, topics), frame)
    motion(frame)  # a frame that can't be placed is an error now, not at the first scan
    return Log(source.path, READER.name, scans=lambda: _read(path, topic, motion), count=topic.count)


def _read(path: Path, topic: Topic, motion: Motion) -> Iterator[Record]:
    """Header stamps count: the order of recording differs from them by the network's delay."""
    poses: dict[str, PoseAt] = {}
    with opened(path) as bag:
        for number, message in messages(bag, topics_of(bag)[topic.name], path):
            frame = frame_of(message.header.frame_id)
            if frame not in poses:
                poses[frame] = motion(frame)
            where = f"{path}: {topic.name}: message {number}"
            stamp_ns = stamp_of(message.header)
            yield placed_scan(stamp_ns, poses[frame], partial(READ[topic.type], message, where, stamp_ns))


def _cloud_topic(source: Source, topics: dict[str, Topic]) -> Topic:
    found = [topic for topic in topics.values() if topic.type in (POINT_CLOUD, LASER_SCAN)]
    clouds = [topic for topic in found if topic.type == POINT_CLOUD]
    if not found:
        raise LogError(
            f"{source.path}: no PointCloud2 or LaserScan messages; it has {listed(topics.values())}; "
            "convert other sensors' messages to one of these"
        )
    asked = source.options.get("topic")
    if asked is not None:
        if asked not in {topic.name for topic in found}:
            raise LogError(f"{source.path}: ?topic={asked} is no topic with clouds; there is {listed(found)}")
        return topics[asked]
    for candidates in (clouds, found):
        if len(candidates) == 1:
            return candidates[0]
    raise LogError(f"{source.path}: several topics with clouds ({listed(found)}); say which: ?topic={found[0].name}")


READER = Reader(
    name="ros",
    summary="ROS 1 .bag, ROS 2 bag folder, .mcap or .db3, with PointCloud2 or LaserScan",
    matches=is_bag,
    open=open_ros,
    options={
        "topic": "PointCloud2 or LaserScan topic (default: the only one)",
        "pose": "tf, Odometry or PoseStamped topic, or 'identity' (default: tf, else the only pose topic)",
        "fixed_frame": "frame that becomes the world's (default: the root of the clouds' tf tree)",
        "max_gap_s": MAX_GAP_HELP,
        "T_base_sensor": "'identity' or x,y,z,qx,qy,qz,qw: sensor on the body of ?pose (default: tf_static)",
    },
)
