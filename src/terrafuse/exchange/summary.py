"""Which revisions a node holds, in messages that fit a frame each: what peers go by, and their acknowledgement.

A message is msgpack, an array of

    version     int, of the protocol; messages of another one are refused, and say no more than this
    born_ns     int, when this life of the node began: an older life's summaries no longer count
    said_ns     int, when it was said; messages of one summary have the same
    robots      map of channel to int: into these the node takes contributions, and it holds something of so many
                robots; who did not hear of so many can't know what it lacks
    held        map of channel to a map of robot to revision: it lacks nothing that this robot last changed up to then;
                robots that are not among them are as they were said before
    missing     array of [id, [first, last, first, last, ...]]: parts that lack of messages that arrived in part
    finished    array of ids: posts that arrived since the last summary
    ahead       map of channel to a map of robot to [x, y, beyond, x, y, beyond, ...]: of tile (x, y) it lacks nothing
                up to the revision in `held` of this very message plus `beyond`
    roots       map of channel to a map of robot to int: digest of all that it holds of the robot, up to the revision in
                `held` of this very message (`exchange.contents`)
    area        nil, or [west, south, east, north], metres: of interest to the node
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import msgspec

from terrafuse.errors import CodecError

VERSION = 1
"""Of the protocol."""
TILES_AT_ONCE = 8
MOST_GAPS = 64
"""Of one message, in a summary; parts beyond are asked for once these came."""
MAP_BYTES = 5
"""That the head of a map takes at most."""


class OtherVersion(CodecError):  # noqa: N818, that it is so is the error
    """A node speaks another protocol."""

    def __init__(self, version: int) -> None:
        super().__init__(f"protocol version {version}; this terrafuse speaks version {VERSION}")
        self.version = version


class Summary(msgspec.Struct, array_like=True, forbid_unknown_fields=True):
    """One message of a summary; fields as in the module's text."""

    version: int
    born_ns: int
    said_ns: int
    robots: dict[str, int]
    held: dict[str, dict[str, int]] = {}
    missing: list[tuple[bytes, list[int]]] = []
    finished: list[bytes] = []
    ahead: dict[str, dict[str, list[int]]] = {}
    roots: dict[str, dict[str, int]] = {}
    area: tuple[float, float, float, float] | None = None


_encode = msgspec.msgpack.Encoder().encode
_decode = msgspec.msgpack.Decoder(Summary).decode
_decode_any = msgspec.msgpack.Decoder(list[Any]).decode


@dataclass
class State:
    """What a summary tells."""

    held: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    missing: Mapping[bytes, list[int]] = field(default_factory=dict)
    finished: Iterable[bytes] = ()
    ahead: Mapping[str, Mapping[str, Sequence[tuple[int, int, int]]]] = field(default_factory=dict)
    """By channel and robot, of which `held` has something: x, y and the revision."""
    roots: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    """Likewise."""


def pack(head: Summary, state: State, room: int) -> list[bytes]:
    """The summary as messages of at most `room` bytes, unless one entry alone takes more; at least one message."""
    pages = _Pages(head, room)
    for id_ in state.finished:
        pages.at_hand(id_).finished.append(id_)
    for id_, gaps in state.missing.items():
        pages.at_hand((id_, gaps[:MOST_GAPS])).missing.append((id_, gaps[:MOST_GAPS]))
    for channel, held in state.held.items():
        roots, ahead = state.roots.get(channel, {}), state.ahead.get(channel, {})
        for robot, revision in held.items():
            _tell(pages, channel, robot, revision, roots.get(robot), ahead.get(robot, ()))
    return [_encode(message) for message in pages.messages]


class _Pages:
    """Messages that are being filled, one after the other."""

    def __init__(self, head: Summary, room: int) -> None:
        self._head = Summary(head.version, head.born_ns, head.said_ns, head.robots, area=head.area)
        # Heads of maps and arrays grow with them.
        self._room = self._left = room - len(_encode(self._head)) - min(6 * MAP_BYTES, room // 16)
        self.messages = [self._begun()]

    def at_hand(self, entry: object, *maps: str) -> Summary:
        """The message with room for an entry, in these maps by channel, too; with their names as part of it."""
        size = len(_encode(entry)) + sum(len(_encode(name)) + MAP_BYTES for name in maps)
        if size > self._left and self._left < self._room:
            self.messages.append(self._begun())
            self._left = self._room
        self._left -= size
        return self.messages[-1]

    def _begun(self) -> Summary:
        head = self._head
        return Summary(head.version, head.born_ns, head.said_ns, head.robots, {}, [], [], {}, {}, head.area)


def _tell(
    pages: _Pages, channel: str, robot: str, revision: int, root: int | None, tiles: Sequence[tuple[int, int, int]]
) -> None:
    """Of one robot, in one message or, with many tiles, several."""
    message = pages.messages[-1]
    names = [channel] * (channel not in message.held)
    if root is None:
        message = pages.at_hand((robot, revision), *names)
    else:
        message = pages.at_hand((robot, revision, robot, root), *names, channel)
        message.roots.setdefault(channel, {})[robot] = root
    message.held.setdefault(channel, {})[robot] = revision
    for first in range(0, len(tiles), TILES_AT_ONCE):
        some = tiles[first : first + TILES_AT_ONCE]
        flat = [number for x, y, until in some for number in (x, y, until - revision)]
        message = pages.at_hand((robot, revision, robot, flat), channel, channel)
        message.held.setdefault(channel, {})[robot] = revision
        message.ahead.setdefault(channel, {}).setdefault(robot, []).extend(flat)


def unpack(message: bytes) -> Summary:
    """Bytes → summary. Raises OtherVersion for one of another protocol, CodecError for anything else."""
    try:
        return _checked(_decode(message))
    except ValueError as error:
        _refuse_other_version(message)
        raise CodecError(f"a summary that can't be read: {error}") from error


def _checked(summary: Summary) -> Summary:
    if summary.version != VERSION:
        raise OtherVersion(summary.version)
    return summary


def _refuse_other_version(message: bytes) -> None:
    """Later protocols may say what they like after their version."""
    try:
        version, *_ = _decode_any(message)
    except ValueError:
        return
    if type(version) is int and version != VERSION and 0 <= version < 1 << 16:
        raise OtherVersion(version)
