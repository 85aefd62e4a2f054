"""Brings contributions and small messages to other nodes, over a link that loses, repeats, reorders, damages and cuts.

robot = Courier(radio.link("r1", place), replica.store, CoarseContribution(mapper, 10), peers=["station"])
station = Courier(radio.link("station", place), replica.store, relay=True, on_message=heard)
station.post("r1", "route", b"...")
for now_ns in ...:
    robot.tick(now_ns), station.tick(now_ns)

One rule makes all robust. Every node says every now and then, in a *summary*, up to which revision it holds each
robot's contribution without a gap. Who hears that and holds more sends what lacks: `delta(since=what the peer holds)`.
So a lost message, a peer that was away, one that starts with nothing, and a healed partition are one case; and what
changed ten times meanwhile is sent once.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection
from dataclasses import dataclass
from math import inf
from typing import Protocol

from terrafuse.exchange.delta import Delta
from terrafuse.exchange.links import Link
from terrafuse.store.base import Store


class Source(Protocol):
    """A contribution that a node can tell of: a robot's own (`CoarseContribution`, `Mapper`)."""

    @property
    def robot(self) -> str: ...

    @property
    def revision(self) -> int:
        """Of what `delta` would tell now."""

    def delta(self, since: int) -> Delta: ...


@dataclass(frozen=True)
class CourierSettings:
    """How often, how much."""

    period_s: float = 1.0
    """Between reports of what is new, and between summaries."""
    answer_s: float = 0.2
    """What arrived is acknowledged by a summary as soon as this is over since the last one."""
    retry_s: float = 1.0
    """A peer that says, this long after the last frame of a message has left, that it lacks it, gets it again; each
    time in vain doubles that, up to `longest_retry_s`."""
    longest_retry_s: float = 16.0
    silent_s: float = 5.0
    """Nothing is sent to a peer of whom nothing was heard for so long."""
    bytes_per_s: float = inf
    """What this node sends at most, frames' payloads counted; less than what the link carries, or it queues there."""
    message_cells: int = 4096
    """Longer deltas are sent as several messages, oldest revisions first (more only where one revision has more)."""


class Courier:
    """One node's end of the exchange. Not for two threads at once.

    `store`: what this node holds of all robots, its own included; None for one that only reports its `own`.
    `own`: what this node itself reports, in the node's own name; the courier takes it into the store, too.
    `peers`: to whom it reports; None: to everyone whom it hears.
    `relay`: whether it passes on what others report, out of its store: a station does.
    `on_message(sender, kind, payload)` is called, within `tick`, for each message that was posted to this node; an older
    one than the last of its sender and kind never comes.

    `counts`: messages_sent, frames_sent, bytes_sent by kind (`bytes_sent.delta`, `.summary`, `.post`), messages_received,
    deltas_applied, and refused by reason (`refused.crc`, `.version`, `.gap`, `.delta`, ...).
    """

    def __init__(
        self,
        link: Link,
        store: Store | None = None,
        own: Source | None = None,
        *,
        peers: Collection[str] | None = None,
        relay: bool = False,
        on_message: Callable[[str, str, bytes], None] | None = None,
        settings: CourierSettings | None = None,
    ) -> None:
        self.counts: Counter[str] = Counter()

    @property
    def node(self) -> str:
        raise NotImplementedError

    def tick(self, now_ns: int) -> None:
        """Receive what arrived, send what is due. To be called ten times a second or so; `now_ns` as for the link."""
        raise NotImplementedError

    def post(self, peer: str, kind: str, payload: bytes) -> None:
        """Bring `payload` to a peer, reliably, in place of anything older of this kind that has not arrived.

        Sent with the next `tick`, and until it is acknowledged; again to a peer that was started afresh. Raises
        InputError for over 64 KiB.
        """
        raise NotImplementedError

    def reached(self, now_ns: int) -> list[str]:
        """Peers of whom something was heard within `silent_s`, sorted."""
        raise NotImplementedError

    def behind(self, peer: str) -> dict[str, int]:
        """By robot, how many revisions a peer lacks of what this node would send it; empty: it is level."""
        raise NotImplementedError
