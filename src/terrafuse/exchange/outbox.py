"""What waits to be sent: frames, at no more bytes a second than allowed, small messages before contributions."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from math import isinf

from terrafuse.exchange.framing import frames_of, message_id
from terrafuse.exchange.links import Frame, Link

BURST_S = 0.1
"""Of what was not used, so much may be sent at once."""


@dataclass(eq=False)
class Outgoing:
    """A message on its way."""

    id: bytes
    kind: str
    frames: list[Frame]
    queued: set[int] = field(default_factory=set)
    """Parts that wait for their turn."""
    left_ns: int = 0
    """When the last of its frames so far left."""


def outgoing(topic: str, message: bytes, max_frame_bytes: int) -> Outgoing:
    kind = topic.split("/", 1)[0]
    return Outgoing(message_id(topic, message), kind, frames_of(topic, message, max_frame_bytes))


class Outbox:
    """Sends by `link`; counts messages, frames and bytes by kind in `counts`."""

    def __init__(self, link: Link, bytes_per_s: float, counts: Counter[str]) -> None:
        self._link = link
        self._bytes_per_s = bytes_per_s
        self._counts = counts
        self._small: deque[tuple[Outgoing, int]] = deque()
        self._bulk: deque[tuple[Outgoing, int]] = deque()
        self._allowed = 0.0
        self._now_ns: int | None = None

    @property
    def max_frame_bytes(self) -> int:
        return self._link.max_frame_bytes

    def put(self, message: Outgoing, parts: Iterable[int] | None = None) -> None:
        """Send these parts of a message, or all; what waits already, waits once."""
        waiting = self._bulk if message.kind == "delta" else self._small
        self._counts[f"messages_sent.{message.kind}"] += 1
        for part in range(len(message.frames)) if parts is None else parts:
            if part not in message.queued:
                message.queued.add(part)
                waiting.append((message, part))

    def send(self, now_ns: int) -> None:
        """Send what may go by now."""
        self._earn(now_ns)
        for waiting in (self._small, self._bulk):
            while waiting and self._allowed > 0:
                self._send(*waiting.popleft(), now_ns)

    def _earn(self, now_ns: int) -> None:
        # A frame goes as soon as anything is allowed, whatever its size, and is paid for afterwards.
        burst = self._bytes_per_s * BURST_S
        elapsed_s = 0.0 if self._now_ns is None else (now_ns - self._now_ns) / 1e9
        earned = burst if isinf(burst) or self._now_ns is None else self._bytes_per_s * elapsed_s
        self._allowed = min(self._allowed + earned, max(burst, earned))
        self._now_ns = now_ns

    def _send(self, message: Outgoing, part: int, now_ns: int) -> None:
        frame = message.frames[part]
        self._link.send(*frame, now_ns)
        message.queued.discard(part)
        message.left_ns = now_ns
        self._allowed -= len(frame.payload)
        self._counts[f"frames_sent.{message.kind}"] += 1
        self._counts[f"bytes_sent.{message.kind}"] += len(frame.payload)
