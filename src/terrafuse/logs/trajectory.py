"""Where the robot was, and the one place where poses are interpolated."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from terrafuse.errors import PoseError
from terrafuse.logs.base import Record
from terrafuse.logs.options import NS
from terrafuse.logs.rows import Row, rows
from terrafuse.logs.stamps import in_seconds, seconds_to_ns
from terrafuse.types import Array, Floats, Pose, Scan, Skipped, Stamp

PoseAt = Callable[[Stamp], Pose]
"""Pose at a time; raises NoPose where there is none."""

UNIT_TOLERANCE = 1e-2
"""How far a quaternion's length may be from 1: two printed digits are off by half of this, a wrong column more."""


class NoPose(PoseError):  # noqa: N818 - an outcome, as StopIteration is
    """The trajectory says nothing of this time. Expected: `placed` turns it into a Skipped."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """`stamps_ns` (N,) strictly increasing, `positions` (N, 3) metres, `quaternions` (N, 4) unit, x y z w.

    Build one with `trajectory(...)`, which checks.
    """

    stamps_ns: NDArray[np.int64]
    positions: Floats
    quaternions: Floats

    @cached_property
    def _stamps(self) -> list[int]:
        # bisect on Python ints is ten times faster a look-up than searchsorted with its array wrapping
        stamps: list[int] = self.stamps_ns.tolist()
        return stamps

    def at(self, stamp_ns: Stamp, max_gap_ns: int) -> Pose:
        """Position linear, rotation slerp, between two neighbours at most `max_gap_ns` apart.

        An exact stamp needs no neighbour. Raises NoPose between poses further apart and outside the
        trajectory: nothing is extrapolated.
        """
        after = bisect_left(self._stamps, stamp_ns)
        if after < len(self._stamps) and self._stamps[after] == stamp_ns:
            return Pose.from_quaternion(self.positions[after], self.quaternions[after])
        if after in (0, len(self._stamps)) or self._stamps[after] - self._stamps[after - 1] > max_gap_ns:
            raise NoPose(f"no pose within {max_gap_ns / NS:g} s")
        before = after - 1
        fraction = (stamp_ns - self._stamps[before]) / (self._stamps[after] - self._stamps[before])
        position = (1 - fraction) * self.positions[before] + fraction * self.positions[after]
        return Pose.from_quaternion(position, slerp(self.quaternions[before], self.quaternions[after], fraction))


def slerp(start: Floats, end: Floats, fraction: float) -> Floats:
    """Shoemake, Animating Rotation with Quaternion Curves, 1985: along the shorter arc, at constant speed."""
    cosine = float(start @ end)
    if cosine < 0:  # q and -q are the same rotation; the nearer one gives the shorter arc
        end, cosine = -end, -cosine
    angle = float(np.arctan2(np.linalg.norm(end - cosine * start), cosine))
    if angle < 1e-8:  # sin(x) = x to double precision: the chord is the arc
        return (1 - fraction) * start + fraction * end
    first: Floats = (np.sin((1 - fraction) * angle) * start + np.sin(fraction * angle) * end) / np.sin(angle)
    return first


def quaternion_of(pose: Pose) -> Floats:
    """x y z w of unit length, the largest part positive; Shepperd 1978: no cancellation at any angle."""
    m = pose.matrix
    products = np.array(  # 4·q·qᵀ; the row of the largest part is q times a number safely away from zero
        [
            [1 + m[0, 0] - m[1, 1] - m[2, 2], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0], m[2, 1] - m[1, 2]],
            [m[0, 1] + m[1, 0], 1 - m[0, 0] + m[1, 1] - m[2, 2], m[1, 2] + m[2, 1], m[0, 2] - m[2, 0]],
            [m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], 1 - m[0, 0] - m[1, 1] + m[2, 2], m[1, 0] - m[0, 1]],
            [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], 1 + m[0, 0] + m[1, 1] + m[2, 2]],
        ]
    )
    row: Floats = products[int(np.argmax(np.diag(products)))]
    return row / np.linalg.norm(row)


def trajectory(stamps_ns: Any, positions: Any, quaternions: Any, name: Callable[[int], str]) -> Trajectory:
    """A checked Trajectory; quaternions x y z w. `name(i)` is what errors call record i, as `poses.tum:12`.

    Raises PoseError, naming the first offending record, for NaN, quaternions not of unit length and stamps
    that don't increase.
    """
    stamps = np.asarray(stamps_ns, np.int64)
    places = np.asarray(positions, np.float64).reshape(len(stamps), 3)
    turns = np.asarray(quaternions, np.float64).reshape(len(stamps), 4)
    lengths = np.linalg.norm(turns, axis=1)
    _refuse(~(np.isfinite(places).all(axis=1) & np.isfinite(lengths)), name, _not_finite)
    _refuse(np.abs(lengths - 1) > UNIT_TOLERANCE, name, lambda i: _not_unit(turns[i], float(lengths[i])))
    _refuse(
        np.diff(stamps, prepend=stamps[:1] - 1) <= 0, name, lambda i: _not_after(int(stamps[i]), int(stamps[i - 1]))
    )
    return Trajectory(stamps, places, turns / lengths[:, None])


def _refuse(bad: NDArray[np.bool_], name: Callable[[int], str], why: Callable[[int], str]) -> None:
    if bad.any():
        first = int(np.argmax(bad))
        raise PoseError(f"{name(first)}: {why(first)}")


def _not_finite(_: int) -> str:
    return "the pose holds NaN or infinity; remove this row"


def _not_unit(quaternion: Floats, length: float) -> str:
    return f"quaternion {quaternion.tolist()} has length {length:.4g}, not 1; the order must be qx qy qz qw"


def _not_after(stamp: int, before: int) -> str:
    return f"stamp {in_seconds(stamp)} s is not after the one before, {in_seconds(before)} s; sort, remove repeats"


def read_tum(path: Path) -> Trajectory:
    """A line: `stamp tx ty tz qx qy qz qw`, seconds and metres. Raises PoseError naming file:line."""
    found = list(rows(path))
    if not found:
        raise PoseError(f"{path}: holds no pose; a line reads `stamp tx ty tz qx qy qz qw`")
    values = [_tum_row(row) for row in found]
    numbers = np.array([numbers for _, numbers in values])
    return trajectory([stamp for stamp, _ in values], numbers[:, :3], numbers[:, 3:], lambda i: found[i].place)


def _tum_row(row: Row) -> tuple[Stamp, list[float]]:
    if len(row.words) != 8:
        raise PoseError(f"{row.place}: {len(row.words)} numbers; a line reads `stamp tx ty tz qx qy qz qw`")
    try:
        return seconds_to_ns(row.words[0]), [float(word) for word in row.words[1:]]
    except ValueError as error:
        raise PoseError(f"{row.place}: {error}; a line reads `stamp tx ty tz qx qy qz qw`") from None


def in_world(_: Stamp) -> Pose:
    """The PoseAt of clouds that are already in the world's frame."""
    return Pose.identity()


def placed(stamp_ns: Stamp, pose_at: PoseAt, points: Callable[[], Array]) -> Record:
    """The scan of these points at its pose; where there is none, a Skipped, and its points are not even read."""
    return placed_scan(stamp_ns, pose_at, lambda T_world_sensor: Scan(stamp_ns, points(), T_world_sensor))


def placed_scan(stamp_ns: Stamp, pose_at: PoseAt, scan: Callable[[Pose], Scan]) -> Record:
    """The scan that is made with its pose; where there is none, a Skipped, and none is made."""
    try:
        T_world_sensor = pose_at(stamp_ns)
    except NoPose as reason:
        return Skipped(stamp_ns, str(reason))
    return scan(T_world_sensor)
