"""Where the poses of a bag come from: tf, or one topic of odometry or poses. Ambiguity is an error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
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


@dataclass(frozen=True)
class Recording:
    """An open bag, and what the user said of it."""

    source: Source
    path: Path
    bag: Any
    topics: dict[str, Topic]

    @cached_property
    def trees(self) -> dict[str, Tree]:
        """One tree a namespace: /robot_1/tf and /robot_2/tf may use the same frame names."""
        spaces: dict[str, list[Topic]] = {}
        for topic in self.of_types(*TF_TYPES):
            spaces.setdefault(_namespace(topic), []).append(topic)
        return {space: read_tree(self.bag, found, self.path) for space, found in spaces.items()}

    @property
    def fixed_frame(self) -> str | None:
        given = self.source.options.get("fixed_frame")
        return None if given is None else frame_of(given)

    def of_types(self, *types: str) -> list[Topic]:
        return [topic for topic in self.topics.values() if topic.type in types]


def motion_of(recording: Recording, frame: str) -> Motion:
    """The motion that the options name, else the only one there is; `frame` is that of the first cloud."""
    options, path = recording.source.options, recording.path
    asked = options.get("pose")
    if asked == "identity":
        return lambda _: in_world
    if asked is not None:
        return _asked(recording, asked)
    if "T_base_sensor" in options and "fixed_frame" not in options:
        return _from_topic(recording, _only_pose_topic(recording))
    placing = [tree for tree in recording.trees.values() if _places(recording, tree, frame)]
    if len(placing) > 1:
        raise LogError(f"{path}: several tf trees ({_choices(recording)}); say which: ?pose=TOPIC")
    return _from_tf(recording, *placing) if placing else _from_topic(recording, _only_pose_topic(recording))


def _asked(recording: Recording, asked: str) -> Motion:
    topic = recording.topics.get(asked)
    if topic in recording.of_types(*POSE_TYPES):
        return _from_topic(recording, topic)
    if topic in recording.of_types(*TF_TYPES):
        return _from_tf(recording, recording.trees[_namespace(topic)])
    raise LogError(
        f"{recording.path}: ?pose={asked} is no topic with poses; there is {_choices(recording)}, or say ?pose=identity"
    )


def _places(recording: Recording, tree: Tree, frame: str) -> bool:
    """Whether tf says how the sensor moved in the world.

    It does not where all above the sensor is rigid, nor where the root is the body whose odometry is a topic: then tf
    only has mountings and joints, and would put every scan at the same place.
    """
    edges = tree.chain(frame, recording.fixed_frame)
    if recording.fixed_frame is not None:
        return True
    return any(edge.moves for edge in edges) and edges[-1].parent not in _bodies(recording)


def _bodies(recording: Recording) -> set[str]:
    first = (next(messages(recording.bag, topic, recording.path)) for topic in recording.of_types(ODOMETRY))
    return {frame_of(message.child_frame_id) for _, message in first}


def _from_tf(recording: Recording, tree: Tree) -> Motion:
    path, fixed_frame, gap_ns = recording.path, recording.fixed_frame, max_gap_ns(recording.source)
    if "T_base_sensor" in recording.source.options:
        raise LogError(
            f"{path}: ?T_base_sensor does not count with tf, which has its own; drop it, or give ?pose=TOPIC"
        )

    def poses_of(frame: str) -> PoseAt:
        if frame not in tree.frames:
            known = listed(sorted(tree.frames))
            raise LogError(f"{path}: tf does not have the cloud's frame '{frame}', only {known}; {RECORD_POSES}")
        return pose_along(tree.chain(frame, fixed_frame), gap_ns)

    return poses_of


@dataclass(frozen=True)
class Track:
    """A pose topic: poses of `child` ('' where the type does not say) in `world`."""

    topic: Topic
    world: str
    child: str
    poses: Trajectory


def _from_topic(recording: Recording, topic: Topic) -> Motion:
    if recording.fixed_frame is not None:
        raise LogError(
            f"{recording.path}: ?fixed_frame only counts with tf; {topic.name} has its own: leave out one of them"
        )
    track = read_track(recording.bag, topic, recording.path)
    gap_ns, given = max_gap_ns(recording.source), _given_mounting(recording)
    trees = [] if given is not None else list(recording.trees.values())

    def poses_of(frame: str) -> PoseAt:
        if given is None and frame == track.world != "":
            return in_world
        T_base_sensor = given or _mounting(recording.path, trees, track, frame)
        return lambda stamp_ns: track.poses.at(stamp_ns, gap_ns) @ T_base_sensor

    return poses_of


def _given_mounting(recording: Recording) -> Pose | None:
    text = recording.source.options.get("T_base_sensor")
    if text is None:
        return None
    given = pose_from_numbers(text)
    if given is None:
        raise LogError(f"{recording.path}: ?T_base_sensor={text} is neither 'identity' nor x,y,z,qx,qy,qz,qw")
    return given


def _mounting(path: Path, trees: list[Tree], track: Track, frame: str) -> Pose:
    if frame == track.child != "":
        return Pose.identity()
    found = [T for tree in trees if track.child and (T := tree.fixed_between(track.child, frame)) is not None]
    if len(found) == 1:
        return found[0]
    base = f"'{track.child}'" if track.child else "a frame that its type does not name"
    raise LogError(
        f"{path}: the clouds are in frame '{frame}', {track.topic.name} has the pose of {base}, "
        f"and no /tf_static links them; say {T_BASE_SENSOR}"
    )


def read_track(bag: Any, topic: Topic, path: Path) -> Track:
    """All poses of the topic. Raises PoseError for one that can't be used, LogError where the frames change."""
    frames: set[tuple[str, str]] = set()
    samples: dict[Stamp, tuple[int, tuple[float, ...]]] = {}
    for number, message in messages(bag, topic, path):
        frames.add((frame_of(message.header.frame_id), frame_of(getattr(message, "child_frame_id", ""))))
        # repeats say nothing new: the first counts, as in tf
        samples.setdefault(stamp_of(message.header), (number, _seven(message.pose)))
    if len(frames) > 1:
        raise LogError(f"{path}: {topic.name} changes its frames ({listed(sorted(frames))}); give another ?pose=TOPIC")
    numbers, values = zip(*samples.values(), strict=True)
    table = np.array(values)
    name = f"{path}: {topic.name}: message"
    poses = trajectory(list(samples), table[:, :3], table[:, 3:], lambda i: f"{name} {numbers[i]}")
    return Track(topic, *frames.pop(), poses)


def _seven(pose: Any) -> tuple[float, ...]:
    """x y z qx qy qz qw of a Pose, or of the Pose in a PoseWithCovariance."""
    plain = getattr(pose, "pose", pose)
    move, turn = plain.position, plain.orientation
    return move.x, move.y, move.z, turn.x, turn.y, turn.z, turn.w


def _only_pose_topic(recording: Recording) -> Topic:
    path, found = recording.path, recording.of_types(*POSE_TYPES)
    if len(found) > 1:
        raise LogError(f"{path}: several topics have poses ({listed(found)}); say which: ?pose={found[0].name}")
    if found:
        return found[0]
    tf = recording.of_types(*TF_TYPES)
    if tf:
        raise LogError(
            f"{path}: {listed(tf)} has no moving frame above the clouds'; {RECORD_POSES}; "
            f"if the sensor stood still, say ?pose={tf[-1].name}; {IDENTITY}"
        )
    raise LogError(f"{path}: no poses; {RECORD_POSES}; {IDENTITY}")


def _namespace(topic: Topic) -> str:
    return topic.name.rpartition("/")[0]


def _choices(recording: Recording) -> str:
    return listed(recording.of_types(*POSE_TYPES, *TF_TYPES))
