"""Messages cut into frames that a link carries, and put together again.

A frame, little endian:

| bytes | |
|---|---|
| 4 | CRC-32 of the topic (UTF-8) and of all that follows |
| 1 | version, 1 |
| 7 | id of the message: BLAKE2b of the topic (UTF-8), a zero byte and the whole message, 7 bytes of digest |
| 2 | number of this part, from 0 |
| 2 | parts of the message, from 1 |
| rest | the part: all parts but the last are equally long |

The id is the content's: a message that is sent again, be it by a sender who was started afresh, completes what arrived
before, and parts of different messages never meet.
"""

from __future__ import annotations

import struct
from collections import Counter, OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass, field
from hashlib import blake2b
from zlib import crc32

from terrafuse.errors import InputError
from terrafuse.exchange.links import Frame

VERSION = 1
CHECK = struct.Struct("<I")
HEAD = struct.Struct("<B7sHH")
"""version, id, part, parts"""
HEADER_BYTES = CHECK.size + HEAD.size
MOST_PARTS = 2**16 - 1
PART_COST = 100
"""Bytes that a part takes in memory, beside its own."""


def message_id(topic: str, message: bytes) -> bytes:
    return blake2b(topic.encode() + b"\0" + message, digest_size=7).digest()


def frames_of(topic: str, message: bytes, max_frame_bytes: int) -> list[Frame]:
    """The message as frames of at most so many bytes; one, if it is empty. Equal messages give equal frames.

    Raises InputError for a message of over 65,535 parts, or frames without room for any.
    """
    room = max_frame_bytes - HEADER_BYTES
    if room < 1 or len(message) > room * MOST_PARTS:
        raise InputError(
            f"a message of {len(message)} bytes on '{topic}' in frames of {max_frame_bytes}, {HEADER_BYTES} of them "
            f"header: the most is {MOST_PARTS} parts; use larger frames, or cut the message"
        )
    parts = [message[at : at + room] for at in range(0, len(message), room)] or [b""]
    id_, seed = message_id(topic, message), crc32(topic.encode())
    bodies = (HEAD.pack(VERSION, id_, number, len(parts)) + part for number, part in enumerate(parts))
    return [Frame(topic, CHECK.pack(crc32(body, seed)) + body) for body in bodies]


@dataclass(frozen=True)
class Limits:
    """What a reassembler holds at most; what would be more makes it forget the unfinished message idle for longest.

    Of too much in all, it is that of the sender who holds most: who floods, displaces only its own.
    """

    message_bytes: int = 16 << 20
    unfinished: int = 256
    """Messages of one sender."""
    bytes: int = 32 << 20
    """Of one sender's unfinished messages."""
    all_bytes: int = 256 << 20
    """Of all senders' unfinished messages."""
    senders: int = 1 << 14
    """Of which anything is held, or known to be finished; who was heard of least lately goes first, but those with
    unfinished messages last."""
    idle_s: float = 60.0
    """After so long without a new part, a message is forgotten."""


@dataclass
class _Unfinished:
    topic: str
    parts: int
    latest_ns: int = 0
    held: dict[int, bytes] = field(default_factory=dict)

    @property
    def cost(self) -> int:
        return sum(map(len, self.held.values())) + PART_COST * len(self.held)


@dataclass
class _Sender:
    unfinished: OrderedDict[bytes, _Unfinished] = field(default_factory=OrderedDict)
    cost: int = 0
    finished: OrderedDict[bytes, None] = field(default_factory=OrderedDict)
    """Lately, of several parts: frames of them that come late don't begin them anew."""


class Reassembler:
    """Puts frames together. Damaged and foreign ones change nothing but `counts` (`refused.checksum`, ...)."""

    def __init__(self, limits: Limits | None = None, counts: Counter[str] | None = None) -> None:
        self.counts: Counter[str] = Counter() if counts is None else counts
        self._limits = limits or Limits()
        self._senders: OrderedDict[str, _Sender] = OrderedDict()
        self._cost = 0

    def take(self, sender: str, frame: Frame, now_ns: int) -> tuple[bytes, bytes | None] | None:
        """(id, message) with the frame that completes it; (id, None) with any other good one; None with a bad one.

        A message of one part is completed by each frame of it; one of several parts but once, until it is forgotten.
        """
        opened = self._opened(frame)
        if opened is None:
            return None
        id_, number, parts, part = opened
        if parts == 1:
            return id_, self._checked(id_, frame.topic, part)
        own = self._sender(sender)
        if id_ in own.finished:
            return id_, None
        self._age(own, now_ns)
        one = own.unfinished.setdefault(id_, _Unfinished(frame.topic, parts))
        if (one.topic, one.parts) != (frame.topic, parts):
            self.counts["refused.mixed"] += 1
            return None
        one.latest_ns = now_ns
        own.unfinished.move_to_end(id_)
        return id_, self._add(own, id_, one, number, part)

    def missing(self) -> dict[bytes, list[int]]:
        """By id, the parts that unfinished messages lack, as first, last, first, last, ... (both included)."""
        unfinished = (pair for own in self._senders.values() for pair in own.unfinished.items())
        return {id_: gaps(one.held, one.parts) for id_, one in unfinished}

    def receiving(self, sender: str, prefix: str) -> int:
        """Parts that are there of this sender's unfinished messages whose topic begins so."""
        unfinished = self._senders[sender].unfinished.values() if sender in self._senders else ()
        return sum(len(one.held) for one in unfinished if one.topic.startswith(prefix))

    def finished(self, sender: str, id_: bytes) -> bool:
        """Whether this message, of several parts, was completed lately."""
        return sender in self._senders and id_ in self._senders[sender].finished

    def forget(self, sender: str, id_: bytes) -> None:
        """Take this message, if it comes again, as if it never had."""
        if sender in self._senders:
            self._senders[sender].finished.pop(id_, None)

    def _opened(self, frame: Frame) -> tuple[bytes, int, int, bytes] | None:
        """(id, number, parts, part), or None for a frame that can't be read."""
        payload = frame.payload
        if len(payload) < HEADER_BYTES:
            self.counts["refused.short"] += 1
            return None
        if crc32(payload[CHECK.size :], crc32(frame.topic.encode())) != CHECK.unpack_from(payload)[0]:
            self.counts["refused.checksum"] += 1
            return None
        version, id_, number, parts = HEAD.unpack_from(payload, CHECK.size)
        if version != VERSION:
            self.counts["refused.version"] += 1
            return None
        part = payload[HEADER_BYTES:]
        if number >= parts or parts * (len(part) if number < parts - 1 else 0) > self._limits.message_bytes:
            self.counts["refused.impossible"] += 1
            return None
        return id_, number, parts, part

    def _checked(self, id_: bytes, topic: str, message: bytes) -> bytes | None:
        if message_id(topic, message) != id_:
            self.counts["refused.mixed"] += 1
            return None
        return message

    def _sender(self, name: str) -> _Sender:
        own = self._senders.setdefault(name, _Sender())
        self._senders.move_to_end(name)
        if len(self._senders) > self._limits.senders:
            others = (one for one in self._senders if one != name)
            idle = next((one for one in self._senders if one != name and not self._senders[one].unfinished), None)
            self._leave(next(others) if idle is None else idle)
        return own

    def _leave(self, name: str) -> None:
        own = self._senders[name]
        while own.unfinished:
            self._forget_oldest(own)
        del self._senders[name]

    def _add(self, own: _Sender, id_: bytes, one: _Unfinished, number: int, part: bytes) -> bytes | None:
        if number not in one.held:
            one.held[number] = part
            own.cost += len(part) + PART_COST
            self._cost += len(part) + PART_COST
        if len(one.held) < one.parts:
            while len(own.unfinished) > self._limits.unfinished or own.cost > self._limits.bytes:
                self._forget_oldest(own)
            while self._cost > self._limits.all_bytes:
                self._forget_oldest(max(self._senders.values(), key=lambda sender: sender.cost))
            return None
        del own.unfinished[id_]
        own.cost -= one.cost
        self._cost -= one.cost
        message = self._checked(id_, one.topic, b"".join(one.held[k] for k in range(one.parts)))
        if message is not None:
            own.finished[id_] = None
            if len(own.finished) > self._limits.unfinished:
                own.finished.popitem(last=False)
        return message

    def _age(self, own: _Sender, now_ns: int) -> None:
        idle_ns = self._limits.idle_s * 1e9
        while own.unfinished and now_ns - next(iter(own.unfinished.values())).latest_ns > idle_ns:
            self._forget_oldest(own)

    def _forget_oldest(self, own: _Sender) -> None:
        _, oldest = own.unfinished.popitem(last=False)
        own.cost -= oldest.cost
        self._cost -= oldest.cost
        self.counts["messages_forgotten"] += 1


def gaps(held: Iterable[int], parts: int) -> list[int]:
    """What lacks of 0 ... parts - 1, as first, last, first, last, ... (both included)."""
    out: list[int] = []
    following = 0
    for number in [*sorted(held), parts]:
        if number > following:
            out += [following, number - 1]
        following = number + 1
    return out
