"""The tf tree: which frame hangs from which, and where each was when."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from terrafuse.errors import LogError
from terrafuse.logs.options import listed
from terrafuse.logs.ros.bag import Topic, frame_of, messages, stamp_of
from terrafuse.logs.trajectory import PoseAt, Trajectory, trajectory
from terrafuse.types import Pose, Stamp

TF_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")


@dataclass
class Samples:
    """What the messages said of one edge; `numbers` are those of the messages, for errors."""

    stamps: list[Stamp] = field(default_factory=list)
    numbers: list[int] = field(default_factory=list)
    positions: list[tuple[float, float, float]] = field(default_factory=list)
    quaternions: list[tuple[float, float, float, float]] = field(default_factory=list)


@dataclass(frozen=True)
class Edge:
    """`latched` edges come from tf_static. Checked only where used: many bags have nonsense in frames of no concern."""

    parent: str
    child: str
    latched: bool
    samples: Samples
    where: str

    def at(self, stamp_ns: Stamp, max_gap_ns: int) -> Pose:
        """T_parent_child at this time. Raises NoPose."""
        return self.rigid if self.latched else self._poses.at(stamp_ns, max_gap_ns)

    @cached_property
    def rigid(self) -> Pose:
        """T_parent_child of an edge that does not move: what the last message said."""
        last = len(self.samples.stamps) - 1
        return self._trajectory_of(np.array([last])).at(self.samples.stamps[last], 0)

    @cached_property
    def moves(self) -> bool:
        """Mountings are on /tf too in ROS 1 bags, over and over: a transform that never changes is one."""
        values = np.hstack([self.samples.positions, self.samples.quaternions])
        return not (self.latched or np.ptp(values, axis=0).max() < 1e-9)  # NaN counts as moving, to be refused

    @cached_property
    def _poses(self) -> Trajectory:
        return self._trajectory_of(np.unique(np.array(self.samples.stamps, np.int64), return_index=True)[1])

    def _trajectory_of(self, chosen: NDArray[np.intp]) -> Trajectory:
        """As tf2 buffers do, `chosen` is ordered by stamp and has the first of several with one stamp."""
        return trajectory(
            np.array(self.samples.stamps)[chosen],
            np.array(self.samples.positions)[chosen],
            np.array(self.samples.quaternions)[chosen],
            lambda i: f"{self.where}: message {self.samples.numbers[chosen[i]]}",
        )


@dataclass(frozen=True)
class Tree:
    """Edges by child. `other_parents` has the children that were seen under several: no tree there."""

    path: Path
    edges: dict[str, Edge]
    other_parents: dict[str, set[str]] = field(default_factory=dict)

    @property
    def frames(self) -> set[str]:
        return {name for edge in self.edges.values() for name in (edge.parent, edge.child)}

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

    def fixed_between(self, base: str, sensor: str) -> Pose | None:
        """T_base_sensor where only rigid edges lie between the two, else None."""
        base_root, T_root_base = self._fixed_root(base)
        sensor_root, T_root_sensor = self._fixed_root(sensor)
        return T_root_base.inverse() @ T_root_sensor if base_root == sensor_root else None

    def _fixed_root(self, frame: str) -> tuple[str, Pose]:
        T_root_frame, root = Pose.identity(), frame
        for edge in self.chain(frame):
            if edge.moves:
                break
            T_root_frame, root = edge.rigid @ T_root_frame, edge.parent
        return root, T_root_frame


def pose_along(edges: list[Edge], max_gap_ns: int) -> PoseAt:
    """The product of the edges at a time, each interpolated on its own: their rates differ."""

    def pose_at(stamp_ns: Stamp) -> Pose:
        T_fixed_frame = Pose.identity()
        for edge in edges:
            T_fixed_frame = edge.at(stamp_ns, max_gap_ns) @ T_fixed_frame
        return T_fixed_frame

    return pose_at


def read_tree(bag: Any, topics: Iterable[Topic], path: Path) -> Tree:
    """The tree of these tf topics; those named …tf_static hold latched edges, whose last message counts."""
    edges: dict[tuple[str, str, bool], Edge] = {}
    for topic in topics:
        latched = topic.name.endswith("tf_static")
        for number, message in messages(bag, topic, path):
            for transform in message.transforms:
                parent, child = frame_of(transform.header.frame_id), frame_of(transform.child_frame_id)
                where = f"{path}: {topic.name} {parent} → {child}"
                edge = edges.setdefault((parent, child, latched), Edge(parent, child, latched, Samples(), where))
                _add(edge.samples, transform, number)
    parents: dict[str, set[str]] = {}
    for edge in edges.values():
        parents.setdefault(edge.child, set()).add(edge.parent)
    by_child = {edge.child: edge for edge in sorted(edges.values(), key=lambda edge: not edge.latched)}
    return Tree(path, by_child, {child: several for child, several in parents.items() if len(several) > 1})


def _add(samples: Samples, transform: Any, number: int) -> None:
    move, turn = transform.transform.translation, transform.transform.rotation
    samples.stamps.append(stamp_of(transform.header))
    samples.numbers.append(number)
    samples.positions.append((move.x, move.y, move.z))
    samples.quaternions.append((turn.x, turn.y, turn.z, turn.w))


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
