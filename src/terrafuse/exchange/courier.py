"""Brings contributions and small messages to other nodes, over a link that loses, repeats, reorders, damages and cuts.

robot = Courier(radio.link("r1", place), replica.store, CoarseContribution(mapper, 10), peers=["station"])
station = Courier(radio.link("station", place), replica.store, relay=True, on_message=heard)
station.post("r1", "route", b"...")
for now_ns in ...:
    robot.tick(now_ns), station.tick(now_ns)

One rule makes all robust. Every node says every now and then, in a *summary*, up to which revision it holds each
robot's contribution without a gap. Who hears that and holds more sends what lacks: `delta(since=what the peer holds)`.
So a lost message, a peer that was away, one that starts with nothing, and a healed partition are one case; what changed
ten times meanwhile is sent once; and nothing is sent to those who can't be heard.

| topic | message | who listens |
|---|---|---|
| `summary/NODE` | `exchange.summary` | peers |
| `delta/ROBOT/NODE` | `exchange.codec`, from whoever passes it on; `_` in ROBOT: what no topic has | replicas |
| `post/PEER/NODE` | `exchange.posts` | that peer |

NODE is the sender. Each message travels in frames (`exchange.framing`).
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from math import inf

from terrafuse.errors import CodecError, DeltaError, InputError
from terrafuse.exchange.codec import decode, encode, heading
from terrafuse.exchange.framing import HEADER_BYTES, Limits, Reassembler
from terrafuse.exchange.links import Frame, Link
from terrafuse.exchange.outbox import Outbox, Outgoing, outgoing
from terrafuse.exchange.own import Own, Source
from terrafuse.exchange.parts import delta_since, oldest
from terrafuse.exchange.peer import DeltaFlight, Flight, Peer, Posted
from terrafuse.exchange.posts import MOST_PAYLOAD, Inbox, Post, decode_post, encode_post
from terrafuse.exchange.summary import State, Summary, pack, unpack
from terrafuse.store.base import Store

SECOND_NS = 1_000_000_000
LEAST_FRAME = 64
MOST_PEERS = 4096
MOST_ROBOTS = 1 << 16
"""That a peer may say it holds."""
MOST_UNSAID = 256
"""Posts acknowledged, and unfinished messages told of, in one summary."""
NOT_IN_TOPICS = re.compile(r"[/*$#?+\x00-\x1f\x7f]")

__all__ = ["Courier", "CourierSettings", "Source"]


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
    message_cells: int = 2048
    """Longer deltas are sent as several messages, oldest revisions first (more only where one revision has more)."""


class Courier:
    """One node's end of the exchange. Not for two threads at once.

    `store`: what this node holds of all robots, its own included; None for one that only reports its `own`. Once the
    courier has it, contributions come into it by the courier alone, or it can't know of gaps.
    `own`: what this node itself reports; its robot has the node's name. The courier takes it into the store, too.
    `peers`: with whom it exchanges; None: with everyone whom it hears.
    `relay`: whether it passes on what others report, out of its store: a station does.
    `on_message(sender, kind, payload)` is called, within `tick`, for each message that was posted to this node; one
    that is older than the last of its sender and kind never comes.

    `counts`: messages_sent, frames_sent and bytes_sent by kind (`bytes_sent.delta`, `.summary`, `.post`),
    messages_received by kind, deltas_applied, deltas_known (of which nothing was new), and what was refused by reason
    (`refused.checksum`, `.version`, `.gap`, `.delta`, ...).
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
        limits: Limits | None = None,
    ) -> None:
        _check(link, own)
        self.settings = settings or CourierSettings()
        self.counts: Counter[str] = Counter()
        self._link, self._store, self._relay, self._on_message = link, store, relay, on_message
        self._own = None if own is None else Own(own)
        self._only = None if peers is None else frozenset(peers)
        self._held = {} if store is None else {robot: store.revision(robot) for robot in store.robots()}
        self._lately: dict[str, int] = {}
        """What was held at the last report,"""
        self._settled: dict[str, int] = {}
        """and at the one before: by now, peers said whether they have it from elsewhere."""
        self._peers: dict[str, Peer] = {}
        self._reassembler = Reassembler(limits, self.counts)
        self._outbox = Outbox(link, self.settings.bytes_per_s, self.counts)
        self._inbox = Inbox()
        self._encoded: dict[tuple[str, int], tuple[Outgoing, int, bool] | None] = {}
        self._unsaid: dict[str, None] = {}
        """Robots of which more is held since the last summary."""
        self._finished: dict[bytes, None] = {}
        """Posts that arrived since the last summary."""
        self._posted = 0
        self._born_ns: int | None = None
        self._now_ns = self._report_ns = self._said_ns = 0
        self._listen()

    @property
    def node(self) -> str:
        return self._link.node

    def tick(self, now_ns: int) -> None:
        """Receive what arrived, send what is due. To be called ten times a second or so; `now_ns` as for the link."""
        if self._born_ns is None:
            self._born_ns = self._report_ns = now_ns
        self._now_ns = now_ns
        heard = {name for frame in self._link.receive(now_ns) if (name := self._receive(frame))}
        reporting = now_ns >= self._report_ns
        if reporting:
            self._report_ns = now_ns + round(self.settings.period_s * SECOND_NS)
            self._encoded.clear()
            self._take_own()
            self._settled, self._lately = self._lately, dict(self._held)
        told = self._told(self._settled)
        for name in self.reached(now_ns):
            peer = self._peers[name]
            if reporting or name in heard:
                self._bring(peer, told, reporting)
            self._bring_posts(peer)
        self._summarise(reporting)
        self._outbox.send(now_ns)

    def post(self, peer: str, kind: str, payload: bytes) -> None:
        """Bring `payload` to a peer, reliably, in place of anything older of this kind that has not arrived.

        Sent with the next `tick` once the peer was heard, and until it is acknowledged; again to a peer that was
        started afresh. Raises InputError for over 64 KiB, or a peer that is none of this node's.
        """
        if len(payload) > MOST_PAYLOAD:
            raise InputError(f"a post '{kind}' of {len(payload)} bytes to '{peer}': the most is {MOST_PAYLOAD}")
        if (known := self._peer(peer)) is None:
            raise InputError(f"'{peer}' is no peer of '{self.node}': it has no place for more, or others only")
        self._posted += 1
        known.posts[kind] = Posted(self._posted, payload)

    def reached(self, now_ns: int) -> list[str]:
        """Peers of whom something was heard within `silent_s`, sorted."""
        since_ns = now_ns - self.settings.silent_s * SECOND_NS
        return sorted(name for name, peer in self._peers.items() if peer.heard_ns >= since_ns)

    def behind(self, peer: str) -> dict[str, int]:
        """By robot, how many revisions a peer lacks of what this node would send it; empty: it is level."""
        held = self._peers[peer].held if peer in self._peers else {}
        lacks = {robot: revision - held.get(robot, 0) for robot, revision in self._told(self._held).items()}
        return {robot: revisions for robot, revisions in lacks.items() if revisions > 0}

    # --- what comes ---------------------------------------------------------------------------------------------------

    def _listen(self) -> None:
        self._link.listen(f"post/{self.node}")
        for name in [""] if self._only is None else [f"/{name}" for name in sorted(self._only)]:
            self._link.listen("summary" + name)
        if self._store is not None:
            self._link.listen("delta")

    def _receive(self, frame: Frame) -> str | None:
        """The name of the peer whose summary it was, if it was one."""
        parts = frame.topic.split("/")
        kind, sender = parts[0], parts[-1]
        taken = self._reassembler.take(sender, frame, self._now_ns)
        if taken is None:
            return None
        id_, message = taken
        if kind == "post" and (message is not None or self._reassembler.finished(sender, id_)):
            self._acknowledge(id_)
        if message is None:
            return None
        self.counts[f"messages_received.{kind}"] += 1
        try:
            if kind == "summary":
                return self._hear(sender, unpack(message))
            if kind == "delta":
                self._apply(sender, id_, message)
            elif kind == "post":
                self._deliver(sender, decode_post(message))
        except CodecError:
            self.counts[f"refused.{kind}"] += 1
        return None

    def _acknowledge(self, id_: bytes) -> None:
        if len(self._finished) < MOST_UNSAID:
            self._finished[id_] = None

    def _deliver(self, sender: str, post: Post) -> None:
        if self._inbox.is_new(sender, post) and self._on_message is not None:
            self._on_message(sender, post.kind, post.payload)

    def _apply(self, sender: str, id_: bytes, message: bytes) -> None:
        """Take a delta into the store, unless it is known, or leaves a gap: what is held never has one."""
        if self._store is None:
            return
        robot, since, revision = heading(message)
        held = self._held.get(robot, 0)
        if revision <= held:
            self.counts["deltas_known"] += 1
        elif since > held:
            self.counts["refused.gap"] += 1
            self._reassembler.forget(sender, id_)
        else:
            try:
                self._store.accept(decode(message, self._store.model.cell))
            except DeltaError:
                self.counts["refused.delta"] += 1
            else:
                self.counts["deltas_applied"] += 1
                self._held[robot] = revision
                self._unsaid[robot] = None

    def _hear(self, sender: str, summary: Summary) -> str | None:
        """Take in what a peer says; its name, if that is news."""
        peer = self._peer(sender)
        if peer is None or summary.born_ns < peer.born_ns:
            self.counts["refused.peer"] += 1
            return None
        if summary.born_ns > peer.born_ns:
            peer.reborn(summary.born_ns)
        if summary.said_ns > peer.said_ns:
            peer.said_ns, peer.missing = summary.said_ns, {}
        if summary.said_ns == peer.said_ns:
            peer.missing.update(summary.missing)
            peer.heard_ns = self._now_ns
        peer.replica, peer.robots = summary.replica, summary.robots
        for robot, revision in summary.held.items():
            if len(peer.held) < MOST_ROBOTS or robot in peer.held:
                peer.held[robot] = max(revision, peer.held.get(robot, 0))
        for post in peer.posts.values():
            post.arrived |= post.flight is not None and post.flight.message.id in summary.finished
        self._recover(peer)
        return sender

    def _peer(self, name: str) -> Peer | None:
        if name not in self._peers and (self._only is None or name in self._only) and len(self._peers) < MOST_PEERS:
            self._peers[name] = Peer(name)
        return self._peers.get(name)

    # --- the node's own contribution ----------------------------------------------------------------------------------

    def _recover(self, peer: Peer) -> None:
        """A peer that holds more of this node's robot than it ever reported, has it from an earlier life of the node.

        Until that came back, the store has a gap before what this life adds. To the peers that is a life of its own, or
        they would go by what it said before.
        """
        if self._own is not None and self._own.surpass(peer.held.get(self._own.robot, 0)):
            self._held[self._own.robot] = 0
            self._born_ns = self._report_ns = self._now_ns

    def _take_own(self) -> None:
        if self._own is None or self._store is None:
            return
        robot, held = self._own.robot, self._held.get(self._own.robot, 0)
        if self._own.revision > held:
            delta = self._own.delta(held)
            if delta.since <= held:
                self._store.accept(delta)
                self._held[robot] = delta.revision

    # --- what goes ----------------------------------------------------------------------------------------------------

    def _told(self, held: Mapping[str, int]) -> Mapping[str, int]:
        """By robot, up to which revision this node tells of it: of its own, and of `held` what it passes on."""
        relayed = held if self._relay else {}
        if self._own is None:
            return relayed
        robot = self._own.robot
        return {**relayed, robot: self._own.revision if self._store is None else self._held.get(robot, 0)}

    def _bring(self, peer: Peer, told: Mapping[str, int], reporting: bool) -> None:
        """Send the peer what it lacks: all of it when a report is due, else the rest of what was begun, and retries."""
        if not peer.served:
            return
        for robot, revision in told.items():
            held = peer.held.get(robot, 0)
            flight = peer.flights.get(robot)
            if flight is not None and held >= flight.revision:
                del peer.flights[robot]
            if held >= revision:
                peer.flights.pop(robot, None)
            elif robot in peer.flights:
                self._repeat(peer, robot, held, peer.flights[robot])
            elif reporting or (flight is not None and not flight.last):
                self._begin(peer, robot, held, self.settings.retry_s * SECOND_NS)

    def _begin(self, peer: Peer, robot: str, since: int, patience_ns: float) -> Outgoing | None:
        """Peers that lack the same share a message: it reaches all of them."""
        if (robot, since) not in self._encoded:
            self._encoded[robot, since] = self._encode(robot, since)
        if (encoded := self._encoded[robot, since]) is None:
            return None
        message, revision, last = encoded
        peer.flights[robot] = DeltaFlight(message, patience_ns, revision, last)
        return message

    def _encode(self, robot: str, since: int) -> tuple[Outgoing, int, bool] | None:
        """(message, the revision it leads to, whether that is the newest); put on its way. None: a gap is before it."""
        if self._store is not None:
            whole = delta_since(self._store, robot, since)
        elif self._own is not None:
            whole = self._own.delta(since)
        if whole.since > since:
            return None
        delta = oldest(whole, self.settings.message_cells)
        topic = f"delta/{NOT_IN_TOPICS.sub('_', robot)}/{self.node}"
        message = outgoing(topic, encode(delta), self._link.max_frame_bytes)
        self._outbox.put(message)
        return message, delta.revision, delta.revision == whole.revision

    def _repeat(self, peer: Peer, robot: str, held: int, flight: DeltaFlight) -> None:
        """Again what did not arrive: the parts that lack, or, if none came, the newest of it."""
        if not flight.in_vain(peer):
            return
        if flight.message.id in peer.missing:
            self._outbox.put(flight.message, _parts(peer.missing[flight.message.id], flight.message))
            return
        longest_ns = self.settings.longest_retry_s * SECOND_NS
        message = self._begin(peer, robot, held, min(2 * flight.patience_ns, longest_ns))
        if message is flight.message:
            self._outbox.put(message)

    def _bring_posts(self, peer: Peer) -> None:
        for kind, post in peer.posts.items():
            if post.arrived:
                continue
            if post.flight is None:
                content = encode_post(Post(self._born_ns or 0, post.number, kind, post.payload))
                message = outgoing(f"post/{peer.name}/{self.node}", content, self._link.max_frame_bytes)
                post.flight = Flight(message, self.settings.retry_s * SECOND_NS)
                self._outbox.put(message)
            elif post.flight.in_vain(peer):
                missing = peer.missing.get(post.flight.message.id)
                self._outbox.put(post.flight.message, None if missing is None else _parts(missing, post.flight.message))
                longest_ns = self.settings.longest_retry_s * SECOND_NS
                post.flight.patience_ns = min(2 * post.flight.patience_ns, longest_ns)

    def _summarise(self, whole: bool) -> None:
        """Say what is held: all of it with each report, in between what is new, soon after it came."""
        soon = self._now_ns >= self._said_ns + self.settings.answer_s * SECOND_NS
        if not whole and not (soon and (self._unsaid or self._finished)):
            return
        robots: Iterable[str] = self._held if whole else self._unsaid
        missing = dict(list(self._reassembler.missing().items())[-MOST_UNSAID:])
        state = State({robot: self._held[robot] for robot in robots}, missing, list(self._finished))
        room = self._link.max_frame_bytes - HEADER_BYTES
        head = Summary(self._born_ns or 0, self._now_ns, self._store is not None, len(self._held))
        for message in pack(head, state, room):
            self._outbox.put(outgoing(f"summary/{self.node}", message, self._link.max_frame_bytes))
        self._unsaid.clear()
        self._finished.clear()
        self._said_ns = self._now_ns


def _parts(gaps: list[int], message: Outgoing) -> Iterable[int]:
    """What a peer says it lacks, as far as there is such a part."""
    pairs = zip(gaps[::2], gaps[1::2], strict=False)
    return [part for first, last in pairs for part in range(max(first, 0), min(last + 1, len(message.frames)))]


def _check(link: Link, own: Source | None) -> None:
    if "/" in link.node:
        raise InputError(f"a node '{link.node}': topics take names without slashes")
    if link.max_frame_bytes < LEAST_FRAME:
        raise InputError(f"frames of {link.max_frame_bytes} bytes: the exchange needs {LEAST_FRAME} at least")
    if own is not None and own.robot != link.node:
        raise InputError(f"the node '{link.node}' can't report as '{own.robot}': give its link the robot's name")
