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
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import ExitStack

from terrafuse.errors import CodecError, InputError, TerrafuseError
from terrafuse.exchange.asking import Answerer, Question
from terrafuse.exchange.bringing import Bringer
from terrafuse.exchange.budget import Budget
from terrafuse.exchange.channel import Channel
from terrafuse.exchange.comparing import Comparing
from terrafuse.exchange.contents import decode_digests
from terrafuse.exchange.framing import Limits, Reassembler
from terrafuse.exchange.herald import Herald
from terrafuse.exchange.holding import Holding
from terrafuse.exchange.known import Known
from terrafuse.exchange.links import Frame, Link
from terrafuse.exchange.links.base import ANY
from terrafuse.exchange.lives import Lives
from terrafuse.exchange.outbox import Outbox
from terrafuse.exchange.own import Source
from terrafuse.exchange.pace import SECOND_NS, CourierSettings
from terrafuse.exchange.peer import Peer, PeerChannel
from terrafuse.exchange.piece import decode_piece, in_topic
from terrafuse.exchange.postbox import OnAnswer, OnCorrection, OnMessage, Postbox
from terrafuse.exchange.summary import OtherVersion, Summary, unpack
from terrafuse.types import Bounds, TileKey

LEAST_FRAME = 64
MOST_PEERS = 4096
FORGET_S = 600
"""Who said nothing for so long makes room for others."""
MOST_ROBOTS = 1 << 16
"""That a peer may say it holds."""
MOST_TILES = 1 << 16
"""Of a robot, of which it may say so one by one."""

__all__ = ["Channel", "Courier", "CourierSettings", "Source"]


class Courier:
    """One node's end of the exchange. Not for two threads at once.

    `channels`: the maps that it exchanges, the most urgent first; all under one budget.
    `peers`: with whom it exchanges; None: with everyone whom it hears.
    `on_message(sender, kind, payload)` is called, within `tick`, for each message that was posted to this node; one
    that is older than the last of its sender and kind never comes. `on_correction(sender, corrections)` likewise, for
    all the corrections of its poses that hold (`exchange.corrections`).
    `answerer(peer, question)` answers what peers ask, `on_answer(peer, number, answer)` is called with what they answer
    (`exchange.asking`). `grant(peer, area)` says whether a peer may have an area of interest.

    `counts`: messages_sent, frames_sent and bytes_sent by kind (`bytes_sent.delta`, `.summary`, `.post`),
    messages_received by kind, deltas_applied, deltas_known (of which nothing was new), and what was refused by reason
    (`refused.checksum`, `.version`, `.gap`, `.delta`, ...).
    `namesakes`: names that two nodes have, this one's perhaps; nothing is taken of either.
    `strangers`: nodes that speak another version of the protocol, and which; nothing of theirs is taken.
    """

    def __init__(
        self,
        link: Link,
        channels: Sequence[Channel] = (),
        *,
        peers: Collection[str] | None = None,
        on_message: OnMessage | None = None,
        on_correction: OnCorrection | None = None,
        on_answer: OnAnswer | None = None,
        answerer: Answerer | None = None,
        grant: Callable[[str, Bounds], bool] | None = None,
        settings: CourierSettings | None = None,
        limits: Limits | None = None,
    ) -> None:
        _check(link, channels)
        self.settings = settings or CourierSettings()
        self.counts: Counter[str] = Counter()
        self.strangers: dict[str, int] = {}
        self.namesakes: frozenset[str] = frozenset()
        self._link = link
        self._may_ask = grant
        self._only = None if peers is None else frozenset(peers)
        self._peers: dict[str, Peer] = {}
        self._reassembler = Reassembler(limits, self.counts)
        budget = Budget(self.settings.bytes_per_s, self.settings.overhead_bytes)
        self._outbox = Outbox(link, budget, [channel.name for channel in channels], self.counts)
        self._posts = Postbox(link.node, self._outbox, self.settings)
        self._posts.on_message, self._posts.on_correction = on_message, on_correction
        self._posts.on_answer, self._posts.answerer = on_answer, answerer
        self._holdings = {channel.name: Holding(channel, self.counts) for channel in channels}
        replicas = {name: holding for name, holding in self._holdings.items() if holding.takes}
        self._comparing = {name: Comparing(holding, self.settings) for name, holding in replicas.items()}
        self._bringers = {
            name: Bringer(
                link.node,
                holding,
                self._outbox,
                self.settings,
                self._comparing[name].unlike if name in replicas else {},
            )
            for name, holding in self._holdings.items()
        }
        self._herald = Herald(link.node, replicas, self._outbox, self._reassembler, self.settings, self._comparing)
        self._lives = Lives()
        self._born_ns = -1
        self._now_ns = self._report_ns = 0
        self._near: list[Peer] = []
        self._near_until_ns = 0
        """Whom it reaches, and until when nobody of them can have fallen silent."""
        self._listen()
        for name, bringer in self._bringers.items():
            self._outbox.fill(name, bringer.refill)

    @property
    def node(self) -> str:
        return self._link.node

    def tick(self, now_ns: int) -> None:
        """Receive what arrived, send what is due. To be called ten times a second or so; `now_ns` as for the link."""
        if self._born_ns < 0:
            self._born_ns = self._report_ns = now_ns
            for holding in self._holdings.values():
                holding.begin()
        self._now_ns = now_ns
        self.namesakes = self._lives.namesakes(now_ns)
        heard = self._take_in(self._link.receive(now_ns))
        reporting = now_ns >= self._report_ns
        if reporting:
            self._report_ns = now_ns + round(self.settings.period_s * SECOND_NS)
            for holding in self._holdings.values():
                holding.take_own()
        reached = [] if self.node in self.namesakes else self._reached()
        for peer in reached:
            if peer.posts:
                self._posts.bring(peer, self._born_ns)
        for comparing in self._comparing.values():
            comparing.tick(now_ns)
        for bringer in self._bringers.values():
            bringer.reach(reached, now_ns, news=reporting or bool(heard), reporting=reporting)
        self._herald.say(now_ns, self._born_ns, reporting, self._posts.finished, self._posts.unsaid)
        self._outbox.send(now_ns)

    def post(self, peer: str, kind: str, payload: bytes) -> None:
        """Bring `payload` to a peer, reliably, in place of anything older of this kind that has not arrived.

        Sent with the next `tick` once the peer was heard, and until it is acknowledged; again to a peer that was
        started afresh. Raises InputError for over 64 KiB, or a peer that is none of this node's.
        """
        self._posts.put(self._known(peer), kind, payload)

    def reached(self, now_ns: int) -> list[str]:
        """Peers of whom something was heard within `silent_s`, sorted."""
        since_ns = now_ns - self.settings.silent_s * SECOND_NS
        return sorted(name for name, peer in self._peers.items() if peer.heard_ns >= since_ns)

    def waiting(self, peer: str) -> bool:
        """Whether something that was posted to a peer has not arrived."""
        known = self._peers.get(peer)
        return known is not None and any(not post.arrived for post in known.posts.values())

    def receiving(self, peer: str) -> int:
        """How many frames have arrived of what this peer posts and did not arrive whole."""
        return self._reassembler.receiving(peer, f"post/{self.node}/")

    def behind(self, peer: str) -> dict[str, dict[str, int]]:
        """By channel, then by robot, how many tiles a peer lacks something of that this node would send it.

        Empty: it is level. Of a channel that the peer never spoke of, all is lacking.
        """
        lacks = {name: bringer.behind(self._peers.get(peer)) for name, bringer in self._bringers.items()}
        return {name: some for name, some in lacks.items() if some}

    @property
    def area(self) -> Bounds | None:
        """Of interest to this node: what it is told of the global map. None: nothing."""
        return self._herald.area

    @area.setter
    def area(self, area: Bounds | None) -> None:
        self._herald.area = area

    @property
    def areas(self) -> list[Bounds]:
        """Of interest to peers that can be reached."""
        return [peer.area for peer in self._reached() if peer.area is not None]

    def ask(self, peer: str, question: Question) -> int:
        """Ask a peer; `on_answer` is called with the number that this gives. Raises InputError as `post` does."""
        return self._posts.ask(self._known(peer), question)

    def _reached(self) -> list[Peer]:
        """As `reached`, by now. A station has a thousand peers: it asks each only when one may have come or gone."""
        if self._now_ns >= self._near_until_ns:
            self._near = [self._peers[name] for name in self.reached(self._now_ns)]
            first_ns = min((peer.heard_ns for peer in self._near), default=self._now_ns)
            self._near_until_ns = first_ns + round(self.settings.silent_s * SECOND_NS) + 1
        return self._near

    # --- what comes ---------------------------------------------------------------------------------------------------

    def _listen(self) -> None:
        self._link.listen(f"post/{self.node}")
        # Its own name, too: another node's that has it.
        for name in [""] if self._only is None else [f"/{name}" for name in sorted({*self._only, self.node})]:
            self._link.listen("summary" + name)
        for channel, holding in self._holdings.items():
            if holding.takes:
                for sender in self._heard:
                    self._link.listen(f"delta/{channel}{sender}")
                    self._link.listen(f"tiles/{channel}{sender}")

    @property
    def _heard(self) -> list[str]:
        """What topics of contributions end with, from their robot on."""
        if self._only is None or self.settings.overhears:
            return [""]
        return [f"/{ANY}/{name}" for name in sorted(self._only)]

    def _take_in(self, frames: Collection[Frame]) -> set[str]:
        """Names of peers who said something new. What this node then says that it holds, or passes on, is there for
        good: all that came at once is made to last at once."""
        with ExitStack() as lasting:
            for holding in self._holdings.values() if frames else ():
                if holding.store is not None:
                    lasting.enter_context(holding.store.together())
            return {name for frame in frames if (name := self._receive(frame))}

    def _receive(self, frame: Frame) -> str | None:
        """The name of the peer whose summary it was, if it was one."""
        kind, *about = frame.topic.split("/")
        sender = about[-1] if about else ""
        taken = self._reassembler.take(sender, frame, self._now_ns)
        if taken is None:
            return None
        id_, message = taken
        if message is None:
            if kind == "post" and self._reassembler.finished(sender, id_):
                self._posts.acknowledge(id_)
            return None
        self.counts[f"messages_received.{kind}"] += 1
        try:
            if kind == "summary":
                return self._hear(sender, unpack(message))
            if sender in self.namesakes:
                self.counts["refused.namesake"] += 1
            elif kind == "tiles" and (comparing := self._comparing.get(about[0])):
                comparing.differ(decode_digests(message))
            elif kind == "delta" and len(about) == 3 and (holding := self._holdings.get(about[0])):
                if not holding.apply(sender, about[1], decode_piece(message), self._now_ns):
                    self._reassembler.forget(sender, id_)
            elif kind == "post":
                self._deliver(sender, id_, message)
        except OtherVersion as error:
            self.counts["refused.version"] += 1
            if len(self.strangers) < MOST_PEERS:
                self.strangers[sender] = error.version
        except CodecError:
            self.counts[f"refused.{kind}"] += 1
        return None

    def _deliver(self, sender: str, id_: bytes, message: bytes) -> None:
        """Who posted it is told, unless it may count yet: its clock may have been set back.

        It may say anything: what nobody thought of is counted like other nonsense, and does not come again.
        """
        try:
            counts = self._posts.deliver(self._peer(sender), sender, message)
        except TerrafuseError:
            raise
        except Exception as error:
            self.counts[f"refused.{type(error).__name__}"] += 1
            counts = True
        if counts:
            self._posts.acknowledge(id_)
        else:
            self._reassembler.forget(sender, id_)

    def _hear(self, sender: str, summary: Summary) -> str | None:
        """Take in what a peer says; its name, if that is news."""
        if sender == self.node:
            self._hear_namesake(summary)
            return None
        peer = self._peer(sender)
        before = -1 if peer is None else peer.born_ns
        if peer is None or not self._lives.heard(peer, summary.born_ns, summary.said_ns, self._now_ns):
            self.counts["refused.peer"] += 1
            return None
        if sender in self.namesakes:
            self.counts["refused.namesake"] += 1
            return None
        self.strangers.pop(sender, None)
        if summary.born_ns < before:
            self._posts.forget(sender)
        if summary.said_ns > peer.said_ns:
            peer.said_ns, peer.missing = summary.said_ns, {}
        if summary.said_ns == peer.said_ns:
            peer.missing.update(summary.missing)
            if peer.heard_ns < self._now_ns - self.settings.silent_s * SECOND_NS:
                self._near_until_ns = 0
            peer.heard_ns = self._now_ns
        for channel, robots in summary.robots.items():
            if channel in self._holdings:
                known = peer.channels.setdefault(channel, PeerChannel())
                _learn(known, robots, summary.held.get(channel, {}), summary.ahead.get(channel, {}))
                self._compare(peer, channel, summary.roots.get(channel, {}))
        self._grant(peer, None if summary.area is None else Bounds(*summary.area))
        for post in peer.posts.values():
            post.arrived |= post.flight is not None and post.flight.message.id in summary.finished
        for channel, said in summary.held.items():
            if self.node in said:
                self._recover(peer, channel)
        return sender

    def _grant(self, peer: Peer, area: Bounds | None) -> None:
        """What a peer is interested in, unless it is refused."""
        if area == peer.asked_area:
            return
        peer.asked_area, peer.area = area, area
        if area is not None and self._may_ask is not None and not self._may_ask(peer.name, area):
            peer.area = None
            self.counts["refused.area"] += 1

    def _hear_namesake(self, summary: Summary) -> None:
        """A node of this one's own name; or this one's former life, late."""
        self._lives.other(self.node, summary.born_ns, summary.said_ns, self._now_ns)
        self.counts["refused.namesake"] += 1

    def _known(self, name: str) -> Peer:
        if (known := self._peer(name)) is None:
            raise InputError(f"'{name}' is no peer of '{self.node}': it has no place for more, or others only")
        return known

    def _peer(self, name: str) -> Peer | None:
        if name not in self._peers and (self._only is None or name in self._only):
            if len(self._peers) >= MOST_PEERS:
                self._forget_somebody()
            if len(self._peers) < MOST_PEERS:
                self._peers[name] = Peer(name)
        return self._peers.get(name)

    def _forget_somebody(self) -> None:
        """Who has said nothing for longest, and for long: those who look at a station have a new name each time."""
        spoke = [peer for peer in self._peers.values() if peer.heard_ns >= 0]
        oldest = min(spoke, key=lambda peer: peer.heard_ns, default=None)
        if oldest is not None and oldest.heard_ns + FORGET_S * SECOND_NS < self._now_ns:
            del self._peers[oldest.name]
            self._near_until_ns = 0
            self._lives.forget(oldest.name)

    def _recover(self, peer: Peer, channel: str) -> None:
        """A peer that holds more of this node's robot than it ever told, has it from an earlier life of the node."""
        holding = self._holdings.get(channel)
        if holding is not None and holding.surpass(peer.channels[channel].of(self.node).newest):
            self._report_ns = self._now_ns

    def _compare(self, peer: Peer, channel: str, roots: Mapping[str, int]) -> None:
        """Where contents differ though revisions don't, tell the digests of this node's tiles."""
        comparing = self._comparing.get(channel)
        for robot, root in roots.items() if comparing is not None else ():
            assert comparing is not None
            message = comparing.hear(peer.name, robot, peer.channels[channel].of(robot), root, self._now_ns)
            if message is not None:
                topic = f"tiles/{channel}/{in_topic(robot)}/{self.node}"
                self._outbox.put(self._outbox.message(topic, message), channel)


def _learn(known: PeerChannel, robots: int, held: dict[str, int], ahead: dict[str, list[int]]) -> None:
    known.robots = robots
    for robot, base in held.items():
        if len(known.known) < MOST_ROBOTS or robot in known.known:
            known.said.add(robot)
            theirs = known.known.setdefault(robot, Known())
            theirs.level(base)
            numbers = iter(ahead.get(robot, ()))
            for x, y, beyond in zip(numbers, numbers, numbers, strict=False):
                if len(theirs.ahead) < MOST_TILES:
                    theirs.learn(TileKey(x, y), base + beyond)


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
