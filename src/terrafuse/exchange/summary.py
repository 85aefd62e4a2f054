"""Which revisions a node holds, in messages that fit a frame each: what peers go by, and their acknowledgement.

A message is msgpack, an array of

    born_ns     int, when this life of the node began: an older life's summaries no longer count
    said_ns     int, when it was said; messages of one summary have the same
    replica     bool, whether the node takes contributions
    robots      int, of how many robots it holds something: who did not hear of so many can't know what it lacks
    held        map of robot to revision: it lacks nothing that this robot last changed up to then; robots that are not
                among them are as they were said before
    missing     array of [id, [first, last, first, last, ...]]: parts that lack of messages that arrived in part
    finished    array of ids: posts that arrived since the last summary
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import msgspec

from terrafuse.errors import CodecError

MOST_GAPS = 64
"""Of one message, in a summary; parts beyond are asked for once these came."""
FIXED_BYTES = 42
"""Of a message without entries, at most."""


class Summary(msgspec.Struct, array_like=True, forbid_unknown_fields=True):
    """One message of a summary; fields as in the module's text."""

    born_ns: int
    said_ns: int
    replica: bool
    robots: int
    held: dict[str, int] = {}
    missing: list[tuple[bytes, list[int]]] = []
    finished: list[bytes] = []


_encode = msgspec.msgpack.Encoder().encode
_decode = msgspec.msgpack.Decoder(Summary).decode


@dataclass
class State:
    """What a summary tells."""

    held: Mapping[str, int] = field(default_factory=dict)
    missing: Mapping[bytes, list[int]] = field(default_factory=dict)
    finished: Iterable[bytes] = ()


def pack(head: Summary, state: State, room: int) -> list[bytes]:
    """The summary as messages of at most `room` bytes, unless one entry alone takes more; at least one message."""
    messages = [_begun(head)]
    left = room - FIXED_BYTES

    def at_hand(entry: object) -> Summary:
        nonlocal left
        size = len(_encode(entry))
        if size > left and left < room - FIXED_BYTES:
            messages.append(_begun(head))
            left = room - FIXED_BYTES
        left -= size
        return messages[-1]

    for id_ in state.finished:
        at_hand(id_).finished.append(id_)
    for id_, gaps in state.missing.items():
        at_hand((id_, gaps[:MOST_GAPS])).missing.append((id_, gaps[:MOST_GAPS]))
    for robot, revision in state.held.items():
        at_hand((robot, revision)).held[robot] = revision
    return [_encode(message) for message in messages]


def _begun(head: Summary) -> Summary:
    return Summary(head.born_ns, head.said_ns, head.replica, head.robots, {}, [], [])


def unpack(message: bytes) -> Summary:
    """Bytes → summary. Raises CodecError for anything else."""
    try:
        return _decode(message)
    except (msgspec.DecodeError, msgspec.ValidationError) as error:
        raise CodecError(f"a summary that can't be read: {error}") from error
