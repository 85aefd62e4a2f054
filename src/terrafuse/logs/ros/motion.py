"""Where the poses of a bag come from: tf, or one topic of odometry or poses. Ambiguity is an error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from terrafuse.errors import LogError
from terrafuse.logs.base import Source
from terrafuse.logs.options import listed, max_gap_ns
from terrafuse.logs.ros.bag import Topic, frame_of, messages, stamp_of
from terrafuse.logs.ros.frames import TF_TYPES, Tree, pose_along, pose_from_numbers, read_tree
from terrafuse.logs.trajectory import PoseAt, Trajectory, in_world, trajectory
from terrafuse.types import Pose, Stamp

ODOMETRY = "nav_msgs/msg/Odometry"
POSE_TYPES = (ODOMETRY, "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped")

Motion = Callable[[str], PoseAt]
"""Frame of a cloud → its poses. Raises LogError where that frame can't be placed."""

RECORD_POSES = "record /tf and /tf_static, or an Odometry or PoseStamped topic"
IDENTITY = "if the clouds are already in the world's frame, say ?pose=identity"
T_BASE_SENSOR = "?T_base_sensor=identity if they are the same, else ?T_base_sensor=x,y,z,qx,qy,qz,qw"


def motion_of(source: Source, path: Path, bag: Any, topics: dict[str, Topic], frame: str) -> Motion:
    """The motion that the options name, else the only one there is; `frame` is that of the first cloud."""
    asked = source.options.get("pose")
    if asked == "identity":
        return lambda _: in_world
    if asked is not None:
        return _asked(source, path, bag, topics, asked)
    if "T_base_sensor" in source.options and "fixed_frame" not in source.options:
        return _from_topic(source, path, bag, topics, _only_pose_topic(path, topics))
    moving = {space: tree for space, tree in _trees(path, bag, topics).items() if _places(source, tree, frame)}
    if len(moving) > 1:
        raise LogError(f"{path}: several tf trees ({_choices(topics)}); say which: ?pose=TOPIC")
    if moving:
        return _from_tf(source, path, *moving.values())
    return _from_topic(source, path, bag, topics, _only_pose_topic(path, topics))


def _asked(source: Source, path: Path, bag: Any, topics: dict[str, Topic], asked: str) -> Motion:
    if asked in topics and topics[asked].type in POSE_TYPES:
        return _from_topic(source, path, bag, topics, topics[asked])
    if asked in topics and topics[asked].type in TF_TYPES:
        return _from_tf(source, path, _trees(path, bag, topics)[_namespace(topics[asked])])
    raise LogError(f"{path}: ?pose={asked} is no topic with poses; there is {_choices(topics)}, or say ?pose=identity")


def _places(source: Source, tree: Tree, frame: str) -> bool:
    """Whether tf alone says how the sensor moved. A tree of fixed mountings or wheel joints does not."""
    fixed_frame = source.options.get("fixed_frame")
    return bool(tree.chain(frame, frame_of(fixed_frame))) if fixed_frame else tree.moves(frame)


def _from_tf(source: Source, path: Path, tree: Tree) -> Motion:
    if "T_base_sensor" in source.options:
        raise LogError(
            f"{path}: ?T_base_sensor does not count with tf, which has its own; drop it, or give ?pose=TOPIC"
        )
    gap_ns, fixed_frame = max_gap_ns(source), source.options.get("fixed_frame")

    def poses_of(frame: str) -> PoseAt:
        edges = tree.chain(frame, frame_of(fixed_frame) if fixed_frame else None)
        if not edges and frame not in {edge.parent for edge in tree.edges.values()}:
            raise LogError(
                f"{path}: tf does not have the cloud's frame '{frame}', only {listed(tree.edges)}; {RECORD_POSES}"
            )
        return pose_along(edges, gap_ns)

    return poses_of


@dataclass(frozen=True)
class _Track:
    """A pose topic: poses of `child` ('' where the type does not say) in `world`."""

    topic: Topic
    world: str
    child: str
    poses: Trajectory


def _from_topic(source: Source, path: Path, bag: Any, topics: dict[str, Topic], topic: Topic) -> Motion:
    if "fixed_frame" in source.options:
        raise LogError(f"{path}: ?fixed_frame only counts with tf; {topic.name} has its own: leave out one of them")
    track = _read_track(path, bag, topic)
    trees = _trees(path, bag, topics)
    gap_ns = max_gap_ns(source)

    def poses_of(frame: str) -> PoseAt:
        if frame == track.world != "" and "T_base_sensor" not in source.options:
            return in_world
        T_base_sensor = _mounting(source, path, trees, track, frame)
        return lambda stamp_ns: track.poses.at(stamp_ns, gap_ns) @ T_base_sensor

    return poses_of


def _mounting(source: Source, path: Path, trees: dict[str, Tree], track: _Track, frame: str) -> Pose:
    text = source.options.get("T_base_sensor")
    if text is not None:
        given = pose_from_numbers(text)
        if given is None:
            raise LogError(f"{path}: ?T_base_sensor={text} is neither 'identity' nor x,y,z,qx,qy,qz,qw")
        return given
    if frame == track.child != "":
        return Pose.identity()
    found = [T for tree in trees.values() if track.child and (T := tree.fixed_between(track.child, frame)) is not None]
    if len(found) == 1:
        return found[0]
    base = f"'{track.child}'" if track.child else "a frame that its type does not name"
    raise LogError(
        f"{path}: the clouds are in frame '{frame}', {track.topic.name} has the pose of {base}, "
        f"and no /tf_static links them; say {T_BASE_SENSOR}"
    )


def _read_track(path: Path, bag: Any, topic: Topic) -> _Track:
    frames: set[tuple[str, str]] = set()
    samples: dict[Stamp, tuple[int, tuple[float, ...]]] = {}
    for number, message in messages(bag, topic, path):
        frames.add((frame_of(message.header.frame_id), frame_of(getattr(message, "child_frame_id", ""))))
        samples.setdefault(
            stamp_of(message.header), (number, _seven(message.pose))
        )  # repeats: the first counts, as in tf
    if len(frames) > 1:
        raise LogError(f"{path}: {topic.name} changes its frames ({listed(sorted(frames))}); give another ?pose=TOPIC")
    values = np.array([numbers for _, numbers in samples.values()])
    order = [number for number, _ in samples.values()]
    poses = trajectory(
        list(samples), values[:, :3], values[:, 3:], lambda i: f"{path}: {topic.name}: message {order[i]}"
    )
    return _Track(topic, *frames.pop(), poses)


def _seven(pose: Any) -> tuple[float, ...]:
    """x y z qx qy qz qw of a Pose, or of the Pose in a PoseWithCovariance."""
    plain = getattr(pose, "pose", pose)
    move, turn = plain.position, plain.orientation
    return move.x, move.y, move.z, turn.x, turn.y, turn.z, turn.w


def _only_pose_topic(path: Path, topics: dict[str, Topic]) -> Topic:
    found = [topic for topic in topics.values() if topic.type in POSE_TYPES]
    if len(found) > 1:
        raise LogError(f"{path}: several topics have poses ({listed(found)}); say which: ?pose={found[0].name}")
    if found:
        return found[0]
    tf = [topic for topic in topics.values() if topic.type in TF_TYPES]
    if tf:
        raise LogError(
            f"{path}: {listed(tf)} has no moving frame above the clouds'; {RECORD_POSES}; "
            f"if the sensor stood still, say ?pose={tf[-1].name}; {IDENTITY}"
        )
    raise LogError(f"{path}: no poses; {RECORD_POSES}; {IDENTITY}")


def _trees(path: Path, bag: Any, topics: dict[str, Topic]) -> dict[str, Tree]:
    """One tree a namespace: /robot_1/tf and /robot_2/tf may use the same frame names."""
    spaces: dict[str, list[Topic]] = {}
    for topic in topics.values():
        if topic.type in TF_TYPES:
            spaces.setdefault(_namespace(topic), []).append(topic)
    return {space: read_tree(bag, found, path) for space, found in spaces.items()}


def _namespace(topic: Topic) -> str:
    return topic.name.rpartition("/")[0]


def _choices(topics: dict[str, Topic]) -> str:
    return listed(topic for topic in topics.values() if topic.type in (*POSE_TYPES, *TF_TYPES))
