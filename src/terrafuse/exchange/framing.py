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

from collections import Counter
from dataclasses import dataclass

from terrafuse.exchange.links import Frame


def frames_of(topic: str, message: bytes, max_frame_bytes: int) -> list[Frame]:
    """The message as frames of at most so many bytes; one, if it is empty. Equal messages give equal frames.

    Raises InputError for a message of over 65,535 parts, or frames without room for any.
    """
    raise NotImplementedError


@dataclass(frozen=True)
class Limits:
    """What a reassembler holds at most; what would be more makes it forget the oldest unfinished message."""

    message_bytes: int = 32 << 20
    unfinished: int = 256
    """Messages of one sender."""
    bytes: int = 64 << 20
    """Of one sender's unfinished messages."""
    senders: int = 4096


class Reassembler:
    """Puts frames together. Damaged and foreign ones are counted in `counts` and change nothing."""

    def __init__(self, limits: Limits | None = None) -> None:
        self.counts: Counter[str] = Counter()

    def take(self, sender: str, frame: Frame) -> bytes | None:
        """The whole message, once this frame completes it."""
        raise NotImplementedError
