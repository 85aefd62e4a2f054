"""Corrections of a robot's poses: what a person, GNSS or registration found out about where it was.

station.post("r1", CORRECTION, encode_corrections([Correction("c1", issued_ns, from_ns, until_ns, T_new_old), ...]))

A correction says that, from one stamp on and before another, each pose T_world_sensor of the robot is rather
T_new_old @ T_world_sensor. It has an id, by which it is known when it comes again, by whatever way; a later one of the
same id takes its place. Who holds some of them applies them in the order in which they were issued, each to what those
before it made of the pose: whoever gave it looked at such a map. The order in which they arrive makes no difference.

A message is msgpack, an array of [id, issued_ns, from_ns, until_ns, [12 floats]], in that order; the numbers are rows:

    [r00, r01, r02, x,  r10, r11, r12, y,  r20, r21, r22, z]
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from hashlib import blake2b

import msgspec
import numpy as np

from terrafuse.errors import CodecError, InputError, PoseError
from terrafuse.types import Pose, Scan, Stamp, checked_pose

CORRECTION = "correction"
"""The kind of the post."""
MOST = 256
"""Of them a robot may have; they fit a post."""
MOST_ID = 64
MOST_SHIFT_M = 1e7
"""That a correction is said to move poses."""
MOST_MOTION_M = 1e8
"""That its motion's translation may be: more, as a turn about a far place has it, which UTM's origin is."""
ALWAYS_NS = 2**63 - 1
"""`until_ns` of what holds from then on."""


@dataclass(frozen=True, eq=False)
class Correction:
    """From `from_ns` on and before `until_ns`, a pose T_world_sensor is rather T_new_old @ T_world_sensor."""

    id: str
    issued_ns: Stamp
    from_ns: Stamp
    until_ns: Stamp
    T_new_old: Pose

    @property
    def order(self) -> tuple[Stamp, str]:
        return self.issued_ns, self.id


Corrections = Sequence[Correction]
"""Each of another id, in their order."""


class _Wire(msgspec.Struct, array_like=True, forbid_unknown_fields=True):
    id: str
    issued_ns: int
    from_ns: int
    until_ns: int
    rows: list[float]


_encode = msgspec.msgpack.Encoder().encode
_decode = msgspec.msgpack.Decoder(list[_Wire]).decode


def flat(
    east_m: float, north_m: float, yaw: float, up_m: float = 0.0, about_m: tuple[float, float] = (0.0, 0.0)
) -> Pose:
    """Turned by `yaw` about a place (east, north), counterclockwise seen from above, then moved."""
    matrix = np.eye(4)
    matrix[:2, :2] = turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    place = np.array(about_m)
    matrix[:3, 3] = [*(place - turn @ place + (east_m, north_m)), up_m]
    return Pose(matrix)


def merged(*several: Iterable[Correction]) -> Corrections:
    """All of them, each once, in their order. Raises InputError for more than a robot may have."""
    held: dict[str, Correction] = {}
    for one in (one for some in several for one in some):
        if one.id not in held or _rank(held[one.id]) < _rank(one):
            held[one.id] = one
    if len(held) > MOST:
        raise InputError(f"{len(held)} corrections of one robot: {MOST} at most; map its log anew with better poses")
    return sorted(held.values(), key=lambda one: one.order)


def corrected(scan: Scan, corrections: Corrections) -> Scan:
    """The scan with its pose as these say."""
    pose = scan.T_world_sensor
    for one in corrections:
        if one.from_ns <= scan.stamp_ns < one.until_ns:
            pose = one.T_new_old @ pose
    return scan if pose is scan.T_world_sensor else replace(scan, T_world_sensor=pose)


def fingerprint(corrections: Corrections) -> str:
    """Equal for equal ones; empty of none."""
    return blake2b(encode_corrections(corrections), digest_size=8).hexdigest() if corrections else ""


def encode_corrections(corrections: Iterable[Correction]) -> bytes:
    """Raises InputError for what `decode_corrections` would not take."""
    some = sorted(corrections, key=lambda one: one.order)
    if flaw := _flaw(some):
        raise InputError(flaw)
    return _encode([_wire(one) for one in some])


def decode_corrections(message: bytes) -> Corrections:
    """Bytes → corrections, in their order. Raises CodecError for anything else, motions that are not rigid among it."""
    try:
        some = [
            Correction(one.id, one.issued_ns, one.from_ns, one.until_ns, _pose(one.rows)) for one in _decode(message)
        ]
    except (ValueError, PoseError) as error:
        raise CodecError(f"corrections that can't be read: {error}") from error
    if flaw := _flaw(some):
        raise CodecError(flaw)
    return some


def _flaw(some: Corrections) -> str | None:
    if len(some) > MOST:
        return f"{len(some)} corrections: give {MOST} at most"
    if len({one.id for one in some}) < len(some) or list(some) != sorted(some, key=lambda one: one.order):
        return "corrections that are not in their order, each of another id"
    for one in some:
        if not (0 < len(one.id) <= MOST_ID and one.id.isprintable()):
            return f"correction {one.id!r}: an id has 1 to {MOST_ID} printable characters"
        if not (0 <= one.issued_ns < 2**63 and 0 <= one.from_ns < one.until_ns < 2**63):
            return f"correction '{one.id}': from {one.from_ns} until {one.until_ns} ns is no time"
        if not np.all(np.abs(one.T_new_old.position) <= MOST_MOTION_M):
            return f"correction '{one.id}': moves by {one.T_new_old.position.tolist()} m; {MOST_MOTION_M:g} at most"
    return None


def _rank(one: Correction) -> tuple[Stamp, bytes]:
    """Of two with one id the one that was issued later counts; of equally late ones, the same one everywhere."""
    return one.issued_ns, _encode(_wire(one))


def _wire(one: Correction) -> _Wire:
    rows = one.T_new_old.matrix[:3].reshape(-1).tolist()
    return _Wire(one.id, one.issued_ns, one.from_ns, one.until_ns, rows)


def _pose(rows: list[float]) -> Pose:
    if len(rows) != 12:
        raise PoseError(f"{len(rows)} numbers for the 12 of three rows")
    return checked_pose(np.vstack([np.reshape(rows, (3, 4)), [0.0, 0.0, 0.0, 1.0]]), "a correction")
