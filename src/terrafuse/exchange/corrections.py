"""Corrections of a robot's poses: what a person, GNSS or registration found out about where it was.

They are posted as a whole, all that hold for a robot, so that a later message says all that an earlier one said:

station.post("r1", CORRECTION, encode_corrections([Correction(stamp_ns, T_world_old), ...]))

A message is msgpack, an array of [from_ns, [12 floats]], by `from_ns`, rising: from that stamp on, until the next one,
each pose T_world_sensor of the robot is to be taken as T_new_old @ T_world_sensor, where T_new_old is these rows:

    [r00, r01, r02, x,  r10, r11, r12, y,  r20, r21, r22, z]
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import msgspec
import numpy as np

from terrafuse.errors import CodecError, InputError, PoseError
from terrafuse.types import Pose, Stamp, checked_pose

CORRECTION = "correction"
"""The kind of the post."""
MOST = 500
"""Of them fit a post."""


@dataclass(frozen=True, eq=False)
class Correction:
    """From `from_ns` on, a pose T_world_sensor that the robot assumed is rather T_new_old @ T_world_sensor."""

    from_ns: Stamp
    T_new_old: Pose


class _Wire(msgspec.Struct, array_like=True, forbid_unknown_fields=True):
    from_ns: int
    rows: list[float]


_encode = msgspec.msgpack.Encoder().encode
_decode = msgspec.msgpack.Decoder(list[_Wire]).decode


def flat(east_m: float, north_m: float, yaw: float) -> Pose:
    """A motion in the plane: turned by `yaw` about the world's origin, counterclockwise, then moved."""
    matrix = np.eye(4)
    matrix[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    matrix[:2, 3] = east_m, north_m
    return Pose(matrix)


def encode_corrections(corrections: Iterable[Correction]) -> bytes:
    """Raises InputError for more than fit a post, or two from the same stamp on."""
    some = sorted(corrections, key=lambda one: one.from_ns)
    if len(some) > MOST or any(one.from_ns == other.from_ns for one, other in pairwise(some)):
        raise InputError(f"{len(some)} corrections: give {MOST} at most, each from another stamp on")
    return _encode([_Wire(one.from_ns, one.T_new_old.matrix[:3].reshape(-1).tolist()) for one in some])


def decode_corrections(message: bytes) -> Sequence[Correction]:
    """Bytes → corrections, by stamp. Raises CodecError for anything else, motions that are not rigid among it."""
    try:
        some = [Correction(one.from_ns, _pose(one.rows)) for one in _decode(message)]
    except (ValueError, PoseError) as error:
        raise CodecError(f"corrections that can't be read: {error}") from error
    if len(some) > MOST or any(one.from_ns >= other.from_ns for one, other in pairwise(some)):
        raise CodecError(f"{len(some)} corrections whose stamps do not rise")
    return some


def _pose(rows: list[float]) -> Pose:
    if len(rows) != 12:
        raise PoseError(f"{len(rows)} numbers for the 12 of three rows")
    return checked_pose(np.vstack([np.reshape(rows, (3, 4)), [0.0, 0.0, 0.0, 1.0]]), "a correction")
