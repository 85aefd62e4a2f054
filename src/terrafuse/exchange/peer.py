"""What a node knows of a peer, and what of its own is under way to it."""

from __future__ import annotations

from dataclasses import dataclass, field

from terrafuse.exchange.known import Known
from terrafuse.exchange.outbox import Outgoing
from terrafuse.types import Bounds, TileKey

ANSWER = "answer/"
"""What kinds of posts begin with that answer a question."""


@dataclass
class Flight:
    """A message on its way to one peer."""

    message: Outgoing
    patience_ns: float

    def in_vain(self, peer: Peer) -> bool:
        """Whether the peer said so late that it lacks it that it can't be under way any more."""
        return not self.message.queued and peer.heard_ns >= self.message.left_ns + self.patience_ns


@dataclass
class TileFlight(Flight):
    until: int
    """The revision up to which the peer holds the tile, or all, once it arrived."""


@dataclass
class Posted:
    """The newest post of its kind to a peer."""

    number: int
    payload: bytes
    flight: Flight | None = None
    arrived: bool = False


@dataclass
class PeerChannel:
    """What a peer said of a channel into which it takes contributions, and what is under way to it."""

    robots: int = 0
    known: dict[str, Known] = field(default_factory=dict)
    said: set[str] = field(default_factory=set)
    """Robots of which it said up to which revision it holds all."""
    tiles: dict[tuple[str, TileKey], TileFlight] = field(default_factory=dict)
    claims: dict[str, TileFlight] = field(default_factory=dict)

    @property
    def served(self) -> bool:
        """Whether it said of every robot what it holds."""
        return len(self.said) >= self.robots

    def of(self, robot: str) -> Known:
        return self.known.get(robot) or Known()

    def arrived(self) -> None:
        """Forget what is no longer under way."""
        self.tiles = {at: one for at, one in self.tiles.items() if self.of(at[0]).of(at[1]) < one.until}
        self.claims = {robot: one for robot, one in self.claims.items() if self.of(robot).base < one.until}


@dataclass
class Peer:
    """What a peer said of itself, and what is under way to it."""

    name: str
    born_ns: int = -1
    said_ns: int = -1
    heard_ns: int = -(1 << 62)
    channels: dict[str, PeerChannel] = field(default_factory=dict)
    missing: dict[bytes, list[int]] = field(default_factory=dict)
    area: Bounds | None = None
    """Of interest to it, metres, if it may have it."""
    asked_area: Bounds | None = None
    """As it said."""
    posts: dict[str, Posted] = field(default_factory=dict)
    """By kind."""

    def reborn(self, born_ns: int) -> None:
        self.born_ns, self.said_ns = born_ns, -1
        self.channels, self.missing = {}, {}
        # It asked in its former life.
        self.posts = {kind: post for kind, post in self.posts.items() if not kind.startswith(ANSWER)}
        for post in self.posts.values():
            post.flight, post.arrived = None, False


def parts_of(message: Outgoing, peer: Peer) -> list[int] | None:
    """The parts of a message that a peer says it lacks, as far as there are such; None: it says nothing of it."""
    if (gaps := peer.missing.get(message.id)) is None:
        return None
    pairs = zip(gaps[::2], gaps[1::2], strict=False)
    return [part for first, last in pairs for part in range(max(first, 0), min(last + 1, len(message.frames)))]
