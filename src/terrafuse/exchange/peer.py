"""What a node knows of a peer, and what of its own is under way to it."""

from __future__ import annotations

from dataclasses import dataclass, field

from terrafuse.exchange.outbox import Outgoing


@dataclass
class Flight:
    """A message on its way to one peer."""

    message: Outgoing
    patience_ns: float

    def in_vain(self, peer: Peer) -> bool:
        """Whether the peer said so late that it lacks it that it can't be under way any more."""
        return not self.message.queued and peer.heard_ns >= self.message.left_ns + self.patience_ns


@dataclass
class DeltaFlight(Flight):
    revision: int
    """That the peer holds once it arrived."""
    last: bool
    """Nothing newer was there."""


@dataclass
class Posted:
    """The newest post of its kind to a peer."""

    number: int
    payload: bytes
    flight: Flight | None = None
    arrived: bool = False


@dataclass
class Peer:
    """What a peer said of itself, and what is under way to it."""

    name: str
    born_ns: int = -1
    said_ns: int = -1
    heard_ns: int = -(1 << 62)
    replica: bool = False
    robots: int = 0
    held: dict[str, int] = field(default_factory=dict)
    missing: dict[bytes, list[int]] = field(default_factory=dict)
    flights: dict[str, DeltaFlight] = field(default_factory=dict)
    """By robot."""
    posts: dict[str, Posted] = field(default_factory=dict)
    """By kind."""

    @property
    def served(self) -> bool:
        """Whether it takes contributions, and said all of what it holds."""
        return self.replica and len(self.held) >= self.robots

    def reborn(self, born_ns: int) -> None:
        self.born_ns, self.said_ns = born_ns, -1
        self.held, self.missing, self.flights = {}, {}, {}
        for post in self.posts.values():
            post.flight, post.arrived = None, False
