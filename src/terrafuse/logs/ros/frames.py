"""The tf tree: which frame hangs from which, and where each was when."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from terrafuse.errors import LogError
from terrafuse.logs.options import listed
from terrafuse.logs.ros.bag import Topic, frame_of, messages, stamp_of
from terrafuse.logs.trajectory import PoseAt, Trajectory, trajectory
from terrafuse.types import Pose, Stamp

TF_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")


@dataclass(frozen=True)
class Edge:
    """`T_parent_child` is a Trajectory where it moves, one Pose where it is fixed."""

    parent: str
    child: str
    T_parent_child: Pose | Trajectory

    @property
    def moves(self) -> bool:
        return isinstance(self.T_parent_child, Trajectory)


@dataclass(frozen=True)
class Tree:
    """Edges by child. `other_parents` has the children that were seen under several: no tree there."""

    path: Path
    edges: dict[str, Edge]
    other_parents: dict[str, set[str]] = field(default_factory=dict)

    def chain(self, frame: str, fixed_frame: str | None = None) -> list[Edge]:
        """Edges from `frame` up to the fixed frame, or to the root. Raises LogError if it is not above."""
        edges: list[Edge] = []
        at = frame
        while at != fixed_frame and at in self.edges:
            if at in self.other_parents:
                parents = listed(sorted(self.other_parents[at]))
                raise LogError(f"{self.path}: tf gives frame '{at}' several parents ({parents}); give ?pose=TOPIC")
            edges.append(self.edges[at])
            at = edges[-1].parent
            if len(edges) > len(self.edges):
                raise LogError(f"{self.path}: tf runs in a circle above '{frame}'; give ?pose=TOPIC")
        if fixed_frame is not None and at != fixed_frame:
            above = listed([frame, *(edge.parent for edge in edges)])
            raise LogError(f"{self.path}: fixed_frame '{fixed_frame}' is not above the cloud's frame; tf has {above}")
        return edges

    def moves(self, frame: str) -> bool:
        return any(edge.moves for edge in self.chain(frame))

    def fixed_between(self, base: str, sensor: str) -> Pose | None:
        """T_base_sensor where only fixed edges lie between the two, else None."""
        base_root, T_root_base = self._fixed_root(base)
        sensor_root, T_root_sensor = self._fixed_root(sensor)
        return T_root_base.inverse() @ T_root_sensor if base_root == sensor_root else None

    def _fixed_root(self, frame: str) -> tuple[str, Pose]:
        T_root_frame, root = Pose.identity(), frame
        for edge in self.chain(frame):
            if not isinstance(edge.T_parent_child, Pose):
                break
            T_root_frame, root = edge.T_parent_child @ T_root_frame, edge.parent
        return root, T_root_frame


def pose_along(edges: list[Edge], max_gap_ns: int) -> PoseAt:
    """The product of the edges at a time, each interpolated on its own: their rates differ."""

    def pose_at(stamp_ns: Stamp) -> Pose:
        T_fixed_frame = Pose.identity()
        for edge in edges:
            T = edge.T_parent_child
            T_fixed_frame = (T.at(stamp_ns, max_gap_ns) if isinstance(T, Trajectory) else T) @ T_fixed_frame
        return T_fixed_frame

    return pose_at


@dataclass
class _Samples:
    stamps: list[Stamp] = field(default_factory=list)
    numbers: list[int] = field(default_factory=list)
    positions: list[tuple[float, float, float]] = field(default_factory=list)
    quaternions: list[tuple[float, float, float, float]] = field(default_factory=list)


def read_tree(bag: Any, topics: Iterable[Topic], path: Path) -> Tree:
    """The tree of these tf topics; those named …tf_static hold fixed edges, whose last message counts."""
    samples: dict[tuple[str, str, bool], _Samples] = {}
    names: dict[tuple[str, str, bool], str] = {}
    for topic in topics:
        fixed = topic.name.endswith("tf_static")
        for number, message in messages(bag, topic, path):
            for transform in message.transforms:
                key = (frame_of(transform.header.frame_id), frame_of(transform.child_frame_id), fixed)
                names.setdefault(key, topic.name)
                _add(samples.setdefault(key, _Samples()), transform, number)
    edges: dict[str, Edge] = {}
    parents: dict[str, set[str]] = {}
    for (parent, child, fixed), found in sorted(samples.items(), key=lambda item: not item[0][2]):
        parents.setdefault(child, set()).add(parent)
        where = f"{path}: {names[parent, child, fixed]} {parent} → {child}"
        edges[child] = Edge(parent, child, _fixed(found, where) if fixed else _moving(found, where))
    return Tree(path, edges, {child: several for child, several in parents.items() if len(several) > 1})


def _add(samples: _Samples, transform: Any, number: int) -> None:
    move, turn = transform.transform.translation, transform.transform.rotation
    samples.stamps.append(stamp_of(transform.header))
    samples.numbers.append(number)
    samples.positions.append((move.x, move.y, move.z))
    samples.quaternions.append((turn.x, turn.y, turn.z, turn.w))


def _fixed(samples: _Samples, where: str) -> Pose:
    one = trajectory(
        samples.stamps[-1:],
        samples.positions[-1:],
        samples.quaternions[-1:],
        lambda _: f"{where}: message {samples.numbers[-1]}",
    )
    return one.at(samples.stamps[-1], 0)


def _moving(samples: _Samples, where: str) -> Trajectory:
    """As tf2 buffers do: ordered by stamp, and of several transforms with one stamp the first counts."""
    stamps, first = np.unique(np.array(samples.stamps, np.int64), return_index=True)
    return trajectory(
        stamps,
        np.array(samples.positions)[first],
        np.array(samples.quaternions)[first],
        lambda i: f"{where}: message {samples.numbers[first[i]]}",
    )


def pose_from_numbers(text: str) -> Pose | None:
    """`identity`, or `x,y,z,qx,qy,qz,qw`; None for anything else."""
    if text == "identity":
        return Pose.identity()
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        return None
    if len(numbers) != 7:
        return None
    return trajectory([0], numbers[:3], numbers[3:], lambda _: f"T_base_sensor={text}").at(0, 0)
