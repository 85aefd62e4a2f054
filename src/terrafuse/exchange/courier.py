"""Brings contributions and small messages to other nodes, over a link that loses, repeats, reorders, damages and cuts.

coarse = Channel("coarse", replica.store, CoarseContribution(mapper, 10))
robot = Courier(radio.link("r1", place), [coarse, Channel("fine", own=mapper)], peers=["station"])
station = Courier(radio.link("station", place), [Channel("coarse", store, relay=True)], on_message=heard)
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
| `delta/CHANNEL/ROBOT/NODE` | `exchange.codec`, from whoever passes it on; `_` in ROBOT: what no topic has | replicas |
| `post/PEER/NODE` | `exchange.posts` | that peer |

NODE is the sender. Each message travels in frames (`exchange.framing`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence

from terrafuse.errors import CodecError, InputError
from terrafuse.exchange.bringing import Bringer
from terrafuse.exchange.channel import Channel
from terrafuse.exchange.framing import HEADER_BYTES, Limits, Reassembler
from terrafuse.exchange.holding import Holding
from terrafuse.exchange.links import Frame, Link
from terrafuse.exchange.outbox import Outbox, outgoing
from terrafuse.exchange.own import Source
from terrafuse.exchange.pace import SECOND_NS, CourierSettings
from terrafuse.exchange.peer import Peer, PeerChannel
from terrafuse.exchange.postbox import OnMessage, Postbox
from terrafuse.exchange.summary import VERSION, OtherVersion, State, Summary, pack, unpack

LEAST_FRAME = 64
MOST_PEERS = 4096
MOST_ROBOTS = 1 << 16
"""That a peer may say it holds."""
MOST_UNSAID = 256
"""Unfinished messages told of in one summary."""

__all__ = ["Channel", "Courier", "CourierSettings", "Source"]


class Courier:
    """One node's end of the exchange. Not for two threads at once.

    `channels`: the maps that it exchanges, the most urgent first; all under one budget.
    `peers`: with whom it exchanges; None: with everyone whom it hears.
    `on_message(sender, kind, payload)` is called, within `tick`, for each message that was posted to this node; one
    that is older than the last of its sender and kind never comes.

    `counts`: messages_sent, frames_sent and bytes_sent by kind (`bytes_sent.delta`, `.summary`, `.post`),
    messages_received by kind, deltas_applied, deltas_known (of which nothing was new), and what was refused by reason
    (`refused.checksum`, `.version`, `.gap`, `.delta`, ...).
    `strangers`: nodes that speak another version of the protocol, and which; nothing of theirs is taken.
    """

    def __init__(
        self,
        link: Link,
        channels: Sequence[Channel] = (),
        *,
        peers: Collection[str] | None = None,
        on_message: OnMessage | None = None,
        settings: CourierSettings | None = None,
        limits: Limits | None = None,
    ) -> None:
        _check(link, channels)
        self.settings = settings or CourierSettings()
        self.counts: Counter[str] = Counter()
        self.strangers: dict[str, int] = {}
        self._link = link
        self._only = None if peers is None else frozenset(peers)
        self._peers: dict[str, Peer] = {}
        self._reassembler = Reassembler(limits, self.counts)
        self._outbox = Outbox(link, self.settings.bytes_per_s, self.counts)
        self._posts = Postbox(link.node, self._outbox, self.settings, on_message)
        self._holdings = {channel.name: Holding(channel, self.counts) for channel in channels}
        self._bringers = {
            name: Bringer(link.node, holding, self._outbox, self.settings) for name, holding in self._holdings.items()
        }
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
            for name, holding in self._holdings.items():
                holding.report()
                self._bringers[name].report()
        reached = [self._peers[name] for name in self.reached(now_ns)]
        for peer in reached:
            self._posts.bring(peer, self._born_ns)
        for name, holding in self._holdings.items():
            told = holding.settled
            for peer in reached:
                if reporting or peer.name in heard:
                    self._bringers[name].bring(peer, told, reporting)
        self._summarise(reporting)
        self._outbox.send(now_ns)

    def post(self, peer: str, kind: str, payload: bytes) -> None:
        """Bring `payload` to a peer, reliably, in place of anything older of this kind that has not arrived.

        Sent with the next `tick` once the peer was heard, and until it is acknowledged; again to a peer that was
        started afresh. Raises InputError for over 64 KiB, or a peer that is none of this node's.
        """
        if (known := self._peer(peer)) is None:
            raise InputError(f"'{peer}' is no peer of '{self.node}': it has no place for more, or others only")
        self._posts.put(known, kind, payload)

    def reached(self, now_ns: int) -> list[str]:
        """Peers of whom something was heard within `silent_s`, sorted."""
        since_ns = now_ns - self.settings.silent_s * SECOND_NS
        return sorted(name for name, peer in self._peers.items() if peer.heard_ns >= since_ns)

    def behind(self, peer: str) -> dict[str, dict[str, int]]:
        """By channel, then by robot, how many revisions a peer lacks of what this node would send it.

        Empty: it is level. Of a channel that the peer never spoke of, all is lacking.
        """
        lacks = {name: self._lacks(peer, name) for name in self._holdings}
        return {name: some for name, some in lacks.items() if some}

    def _lacks(self, peer: str, channel: str) -> dict[str, int]:
        known = self._peers[peer].channels.get(channel) if peer in self._peers else None
        held = known.held if known else {}
        lacks = {robot: last - held.get(robot, 0) for robot, last in self._holdings[channel].told.items()}
        return {robot: revisions for robot, revisions in lacks.items() if revisions > 0}

    # --- what comes ---------------------------------------------------------------------------------------------------

    def _listen(self) -> None:
        self._link.listen(f"post/{self.node}")
        for name in [""] if self._only is None else [f"/{name}" for name in sorted(self._only)]:
            self._link.listen("summary" + name)
        for channel, holding in self._holdings.items():
            if holding.store is not None:
                self._link.listen(f"delta/{channel}")

    def _receive(self, frame: Frame) -> str | None:
        """The name of the peer whose summary it was, if it was one."""
        kind, *about = frame.topic.split("/")
        sender = about[-1] if about else ""
        taken = self._reassembler.take(sender, frame, self._now_ns)
        if taken is None:
            return None
        id_, message = taken
        if kind == "post" and (message is not None or self._reassembler.finished(sender, id_)):
            self._posts.acknowledge(id_)
        if message is None:
            return None
        self.counts[f"messages_received.{kind}"] += 1
        try:
            if kind == "summary":
                return self._hear(sender, unpack(message))
            if kind == "delta" and (holding := self._holdings.get(about[0])):
                if not holding.apply(sender, message, self._now_ns):
                    self._reassembler.forget(sender, id_)
            elif kind == "post":
                self._posts.deliver(sender, message)
        except OtherVersion as error:
            self.counts["refused.version"] += 1
            if len(self.strangers) < MOST_PEERS:
                self.strangers[sender] = error.version
        except CodecError:
            self.counts[f"refused.{kind}"] += 1
        return None

    def _hear(self, sender: str, summary: Summary) -> str | None:
        """Take in what a peer says; its name, if that is news."""
        peer = self._peer(sender)
        if peer is None or summary.born_ns < peer.born_ns:
            self.counts["refused.peer"] += 1
            return None
        self.strangers.pop(sender, None)
        if summary.born_ns > peer.born_ns:
            peer.reborn(summary.born_ns)
        if summary.said_ns > peer.said_ns:
            peer.said_ns, peer.missing = summary.said_ns, {}
        if summary.said_ns == peer.said_ns:
            peer.missing.update(summary.missing)
            peer.heard_ns = self._now_ns
        for channel, robots in summary.robots.items():
            if channel in self._holdings:
                _learn(peer.channels.setdefault(channel, PeerChannel()), robots, summary.held.get(channel, {}))
        for post in peer.posts.values():
            post.arrived |= post.flight is not None and post.flight.message.id in summary.finished
        self._recover(peer)
        return sender

    def _peer(self, name: str) -> Peer | None:
        if name not in self._peers and (self._only is None or name in self._only) and len(self._peers) < MOST_PEERS:
            self._peers[name] = Peer(name)
        return self._peers.get(name)

    def _recover(self, peer: Peer) -> None:
        """A peer that holds more of this node's robot than it ever reported, has it from an earlier life of the node.

        To the peers this is a life of its own then, or they would go by what it said before.
        """
        for channel, holding in self._holdings.items():
            known = peer.channels.get(channel)
            if known is not None and holding.surpass(known.held.get(self.node, 0)):
                self._born_ns = self._report_ns = self._now_ns

    # --- what goes ----------------------------------------------------------------------------------------------------

    def _summarise(self, whole: bool) -> None:
        """Say what is held: all of it with each report, in between what is new, soon after it came."""
        soon = self._now_ns >= self._said_ns + self.settings.answer_s * SECOND_NS
        unsaid = self._posts.unsaid or any(holding.unsaid for holding in self._holdings.values())
        if not whole and not (soon and unsaid):
            return
        replicas = {name: holding for name, holding in self._holdings.items() if holding.store is not None}
        held = {
            name: {robot: holding.held[robot] for robot in (holding.held if whole else holding.unsaid)}
            for name, holding in replicas.items()
        }
        missing = dict(list(self._reassembler.missing().items())[-MOST_UNSAID:])
        state = State(held, missing, self._posts.finished())
        robots = {name: len(holding.held) for name, holding in replicas.items()}
        head = Summary(VERSION, self._born_ns or 0, self._now_ns, robots)
        for message in pack(head, state, self._link.max_frame_bytes - HEADER_BYTES):
            self._outbox.put(outgoing(f"summary/{self.node}", message, self._link.max_frame_bytes))
        for holding in replicas.values():
            holding.unsaid.clear()
        self._said_ns = self._now_ns


def _learn(known: PeerChannel, robots: int, held: dict[str, int]) -> None:
    known.robots = robots
    for robot, revision in held.items():
        if len(known.held) < MOST_ROBOTS or robot in known.held:
            known.held[robot] = max(revision, known.held.get(robot, 0))


def _check(link: Link, channels: Sequence[Channel]) -> None:
    if "/" in link.node:
        raise InputError(f"a node '{link.node}': topics take names without slashes")
    if link.max_frame_bytes < LEAST_FRAME:
        raise InputError(f"frames of {link.max_frame_bytes} bytes: the exchange needs {LEAST_FRAME} at least")
    names = [channel.name for channel in channels]
    if len(set(names)) < len(names):
        raise InputError(f"channels {', '.join(names)}: give each another name")
    for channel in channels:
        if channel.own is not None and channel.own.robot != link.node:
            raise InputError(
                f"the node '{link.node}' can't report as '{channel.own.robot}': give its link the robot's name"
            )
