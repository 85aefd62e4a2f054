"""What leaves a node: frames, at no more bytes a second than allowed, the urgent ones first.

Lanes: posts, then summaries, then the channels in their order, then answers. A channel's lane is filled when its turn
comes, with what is then worth most and as it is then; nothing waits in it but the message that is being sent.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

from terrafuse.exchange.budget import Budget
from terrafuse.exchange.framing import frames_of, message_id
from terrafuse.exchange.links import Frame, Link
from terrafuse.exchange.links.base import overhead_of

POST, SUMMARY, REPLY = "post", "summary", "reply"
USUAL_TOPIC = "delta/fine/robot/station"
"""By its length, frames are made as long as the budget likes them."""
FAIR = 8
"""Of so many frames one is of the last lane that has any, so that the first ones starve none: a post of 64 KiB no
summary, by which others know that the node is there, and the coarse map not the fine one."""


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


@dataclass
class Lane:
    refill: Callable[[], bool] = lambda: False
    """Puts more into the lane; False: there is nothing more."""
    waiting: deque[tuple[Outgoing, int]] = field(default_factory=deque)

    def filled(self) -> bool:
        return bool(self.waiting) or (self.refill() and bool(self.waiting))


@dataclass
class Group:
    """Lanes of which the first has precedence, and the last its share."""

    lanes: list[Lane]
    taken: int = 0

    def next(self) -> Lane | None:
        order = self.lanes if (self.taken + 1) % FAIR else self.lanes[::-1]
        lane = next((lane for lane in order if lane.filled()), None)
        self.taken += lane is not None
        return lane


class Outbox:
    """Sends by `link`; counts messages, frames and bytes by kind in `counts`."""

    def __init__(self, link: Link, budget: Budget, channels: Sequence[str], counts: Counter[str]) -> None:
        self._link, self._overhead = link, overhead_of(link)
        self.max_frame_bytes = budget.frame_bytes(link.max_frame_bytes, self._overhead(USUAL_TOPIC, 0))
        self._budget = budget
        self._counts = counts
        self._lanes = {name: Lane() for name in (POST, SUMMARY, *channels, REPLY)}
        self._groups = [self._group(POST, SUMMARY), self._group(*channels, REPLY)]

    def fill(self, lane: str, refill: Callable[[], bool]) -> None:
        """Have this called whenever the lane is empty and something may leave."""
        self._lanes[lane].refill = refill

    def message(self, topic: str, message: bytes) -> Outgoing:
        return outgoing(topic, message, self.max_frame_bytes)

    def put(self, message: Outgoing, lane: str, parts: Iterable[int] | None = None) -> None:
        """Send these parts of a message, or all; what waits already, waits once."""
        self._counts[f"messages_sent.{message.kind}"] += 1
        for part in range(len(message.frames)) if parts is None else parts:
            if part not in message.queued:
                message.queued.add(part)
                self._lanes[lane].waiting.append((message, part))

    def send(self, now_ns: int) -> None:
        """Send what may go by now."""
        self._budget.earn(now_ns)
        while self._budget.left and (lane := self._next()) is not None:
            self._send(*lane.waiting.popleft(), now_ns)

    def _next(self) -> Lane | None:
        return next((lane for group in self._groups if (lane := group.next()) is not None), None)

    def _group(self, *names: str) -> Group:
        return Group([self._lanes[name] for name in names])

    def _send(self, message: Outgoing, part: int, now_ns: int) -> None:
        frame = message.frames[part]
        self._link.send(*frame, now_ns)
        message.queued.discard(part)
        message.left_ns = now_ns
        self._counts[f"frames_sent.{message.kind}"] += 1
        self._counts[f"bytes_sent.{message.kind}"] += self._budget.pay(
            len(frame.payload), self._overhead(frame.topic, len(frame.payload))
        )
