"""Frozen values that every room shares. They know nothing of each other's rooms.

Frames and units are in the names: `T_world_sensor` takes a point in the sensor's frame to the world's,
`stamp_ns` counts nanoseconds since 1970-01-01 UTC. The world is x east, y north, z up, in metres.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from terrafuse.errors import PoseError

Array = NDArray[Any]
Floats = NDArray[np.float64]
Stamp = int
"""Nanoseconds since 1970-01-01 UTC."""

RIGID_TOLERANCE = 1e-3
"""How far RRᵀ may be from the identity: KITTI's printed poses are off by 1e-5, a sheared matrix by far more."""


class TileKey(NamedTuple):
    """Which tile: `x` counts tiles east, `y` north of the world's origin; `level` 0 is the finest lattice."""

    x: int
    y: int
    level: int = 0


class Bounds(NamedTuple):
    """A rectangle in world coordinates, metres."""

    west: float
    south: float
    east: float
    north: float

    def union(self, other: Bounds) -> Bounds:
        return Bounds(
            min(self.west, other.west),
            min(self.south, other.south),
            max(self.east, other.east),
            max(self.north, other.north),
        )


@dataclass(frozen=True, eq=False)
class Pose:
    """A rigid motion as a 4×4 float64 matrix; `T_a_b` takes points of frame b to frame a.

    Build one with `pose(...)` or `Pose.from_quaternion(...)`, which check; the bare constructor trusts its argument.
    """

    matrix: Floats

    @property
    def position(self) -> Floats:
        return self.matrix[:3, 3]

    def __matmul__(self, other: Pose) -> Pose:
        return Pose(self.matrix @ other.matrix)

    def inverse(self) -> Pose:
        rotation = self.matrix[:3, :3].T
        return pose_of(rotation, -rotation @ self.position)

    def shifted(self, east_m: float, north_m: float, up_m: float = 0.0) -> Pose:
        """The same pose in a world whose origin lies at (-east, -north, -up) of this one."""
        matrix = self.matrix.copy()
        matrix[:3, 3] += (east_m, north_m, up_m)
        return Pose(matrix)

    @staticmethod
    def identity() -> Pose:
        return Pose(np.eye(4))

    @staticmethod
    def from_quaternion(position: Any, xyzw: Any) -> Pose:
        """`position` (3,) metres, `xyzw` (4,) scalar last, of any length but zero. Raises PoseError."""
        quaternion = np.asarray(xyzw, np.float64)
        length = float(np.linalg.norm(quaternion))
        if not np.isfinite(length) or length < 1e-9:
            raise PoseError(f"quaternion {quaternion.tolist()} has no direction; give x y z w of a unit quaternion")
        x, y, z, w = quaternion / length
        rotation = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )
        return checked_pose(pose_of(rotation, np.asarray(position, np.float64)).matrix)


IDENTITY = np.eye(4)


def pose_of(rotation: Floats, position: Floats) -> Pose:
    """The pose with this 3×3 rotation and (3,) position, unchecked."""
    matrix = IDENTITY.copy()
    matrix[:3, :3] = rotation
    matrix[:3, 3] = position
    return Pose(matrix)


def checked_pose(matrix: Any, what: str = "pose") -> Pose:
    """A Pose from a 3×4 or 4×4 matrix. Raises PoseError, naming `what`, unless it is finite and rigid."""
    given = np.asarray(matrix, np.float64)
    if given.shape not in ((3, 4), (4, 4)):
        raise PoseError(f"{what}: a pose has 3×4 or 4×4 numbers, not {'×'.join(map(str, given.shape))}")
    full = np.eye(4)
    full[: given.shape[0]] = given
    if not np.isfinite(full).all():
        raise PoseError(f"{what}: holds NaN or infinity; drop this pose or repair the trajectory")
    if full[3].tolist() != [0, 0, 0, 1]:
        raise PoseError(f"{what}: the last row is {full[3].tolist()}, not 0 0 0 1; is the matrix transposed?")
    error, determinant = _off_rigid(full)
    if error > RIGID_TOLERANCE or determinant < 0:
        raise PoseError(
            f"{what}: not a rigid motion (RRᵀ is off the identity by {error:.3g}, "
            f"determinant {determinant:.3g}); scale, shear and mirrored axes must be taken out first"
        )
    return Pose(full)


def is_rigid(matrix: Floats) -> bool:
    """Whether a 4×4 matrix has a finite rotation and no mirror in it; quick enough for every scan."""
    error, determinant = _off_rigid(matrix)
    return error <= RIGID_TOLERANCE and determinant > 0


def _off_rigid(matrix: Floats) -> tuple[float, float]:
    """(how far RRᵀ is from the identity, det R). In plain floats: for nine numbers NumPy costs ten times more."""
    a, b, c = matrix[:3, :3].tolist()
    dots = (_dot(a, a) - 1, _dot(b, b) - 1, _dot(c, c) - 1, _dot(a, b), _dot(a, c), _dot(b, c))
    cross = (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
    return max(map(abs, dots)), _dot(cross, c)


def _dot(a: Any, b: Any) -> float:
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


@dataclass(frozen=True)
class Beam:
    """How wide a sensor's beams are and how well they measure. A lidar's is `RAY`, a sonar's is a cone."""

    half_angle_rad: float = 0.0
    """Of the cone around the axis; 0 is a ray."""
    range_error_m: float = 0.0
    """The echo lies within ± this of the reading."""
    min_range_m: float = 0.0
    max_range_m: float = float("inf")
    reliability: float = 1.0
    """How far its readings are believed, 0 to 1."""


RAY = Beam()


@dataclass(frozen=True, eq=False)
class NoReturns:
    """Beams whose reading is no distance: a code, 0, NaN, beyond a limit. What they mean, the log does not say.

    `directions`: (K, 3), unit, in the sensor's frame; `readings_m`: (K,), as they stand in the log. Models leave them
    alone: only the description of a sensor can say that they mean empty space.
    """

    directions: Floats
    readings_m: Floats


@dataclass(frozen=True, eq=False)
class Readings:
    """What each of a scan's N beams read, in the log's order: only with these can a description re-aim the beams.

    `ranges_m`: (N,), as they stand in the log; `returned`: (N,), which of them the log calls returns; `directions`:
    (N, 3), unit, in the sensor's frame, where the log itself states them; `clear_m`: up to where a beam met nothing
    whose reading is +inf.
    """

    ranges_m: Floats
    returned: Array
    directions: Floats | None = None
    clear_m: float = float("inf")


@dataclass(frozen=True, eq=False)
class Scan:
    """What one sensor saw at one instant.

    `points`: (N, 3) float32 or float64, metres, in the sensor's frame; NaN and infinite rows mean "no return".
    `T_world_sensor` takes them to the world. A scan that is already in the world's frame has the identity.

    Models that ask what lies on the way of a beam also use: `misses` (M, 3), up to where beams went that met nothing;
    `origins` (N + M, 3), where the beams of the points, then of the misses start, None for the sensor frame's origin;
    and the shape of the `beam`, of which a point or miss is the axis's end.
    """

    stamp_ns: Stamp
    points: Array
    T_world_sensor: Pose
    misses: Array | None = None
    origins: Array | None = None
    beam: Beam = RAY
    no_returns: NoReturns | None = None
    readings: Readings | None = None
    """Beside the points, where the log has a reading for each beam."""
    dropped: Mapping[str, int] = field(default_factory=dict)
    """Readings that were left out before models see the scan, by reason."""


@dataclass(frozen=True)
class Skipped:
    """A scan that a log holds but that can't be placed or read; it is counted by its `reason`, never guessed."""

    stamp_ns: Stamp
    reason: str
