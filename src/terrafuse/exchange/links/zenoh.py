"""Links over Zenoh: nodes of many processes and hosts, over TCP or TLS.

    link = ZenohLink("r4", Transport(connect="tls/192.168.1.10:7447", keys="fleet/nodes/r4"))

What goes out waits in a bounded queue for a thread of the link's own, since Zenoh's `put` can block for as long as a
receiver is slow, whatever it was told. The same thread connects: it tries again until somebody answers, and says once
what is in the way. A connection that is lost later comes back by itself; meanwhile frames are dropped and counted, and
what lacks is asked for by the exchange.

Whatever is asked of Zenoh may wait for its own threads, and those for what our callbacks wait for. So **only the
link's thread calls into Zenoh**, but for the end of a session, which has a thread to itself, and the answer to who asks
for our name; **no lock is held meanwhile**; and callbacks take only the one lock, which is held for a few statements at
a time. Who uses the link never waits for Zenoh.

What comes in waits in Zenoh's own rings, without Python: a callback for each frame would have Zenoh's threads and ours
wait for each other's interpreter lock three thousand times a second at a station of a thousand robots, which takes it
a third of its time.
"""

from __future__ import annotations

import json
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from terrafuse.errors import InputError, MissingExtra, TerrafuseError
from terrafuse.exchange.links.base import Frame, check_frame, check_heard, check_topic, closed, covers
from terrafuse.exchange.links.presence import Presence
from terrafuse.exchange.links.reach import diagnosis, listen_trouble
from terrafuse.exchange.links.sending import SendQueue
from terrafuse.exchange.links.topics import ROOT, key_of, topic_of
from terrafuse.exchange.links.transport import LARGEST_BATCH, Transport, addresses, zenoh_settings

if TYPE_CHECKING:
    from terrafuse.keys.identity import Identity

FIRST_S = 5.0
"""How long a new link waits for its first attempt to connect to end, so that it can say what is wrong."""
PAUSE_S, LONGEST_PAUSE_S = 0.2, 2.0
LOOK_S = 0.2
"""How often the thread looks whether anything is to be done that nobody tells it of."""
CLOSE_S = 1.0
NO_WORD_S = 1.0
SHORT_BREAK_S = 5.0
"""A station that went is not tried to be told from something else there that speaks another language."""
"""A lost connection is spoken of when it has not come back by then."""
LISTEN_S = 1.0
"""How long `listen` waits to be heeded, at most."""
DEAF_S = 20.0
"""Nodes say something each second or two. Is one there of which nothing comes for so long, the session was damaged on
its way: Zenoh checks no sums, and a declaration that was not understood is never made again."""
STUCK_S = 60.0
"""Whoever sends, connects, or is given up, takes less; a call that lasts longer never ends."""
ZENOH_BYTES, TLS_BYTES, TCP_BYTES, SEGMENT_BYTES = 28, 22, 52, 1500
"""Beside the key: a batch's and a message's headers, 13 to 24 bytes as measured, and numbers grow by 3. A record
of TLS 1.3 has 5 bytes of header, 1 of type and 16 of proof; IPv4 has 20, TCP 20 and its timestamps 12."""


class ZenohLink:
    """A link of Transport's making. Raises InputError where it can't listen, for settings and keys that can't be used,
    and for a name that another node has.

    If nobody answers where it connects, it goes on trying. `trouble` is what is in the way, None when all is well;
    `tell` is called with it, once each time, by the link's thread. Another node of this name may also be met later:
    then `send` and `receive` raise.

    `counts`: frames_sent, frames_received, bytes_sent, bytes_received; `dropped.unconnected`, `dropped.queue` (more
    waited than `queue_bytes`); `full.inbox`, how often so much waited of a topic that the oldest may have been lost
    (`inbox_bytes`); connections.
    """

    def __init__(self, node: str, transport: Transport, tell: Callable[[str], None] = lambda text: None) -> None:
        check_topic(node)
        if "/" in node:
            raise InputError(f"node '{node}': a name has no slash")
        self._zenoh = _library()
        self.node, self.transport = node, transport
        self.max_frame_bytes = transport.max_frame_bytes
        self.counts: Counter[str] = Counter()
        self.trouble: str | None = None
        self._tell = tell
        self._listens, self._connects = addresses(transport)
        self._identity = _identity(node, transport)
        self._presence = Presence(node, bool(self._listens), self._meet_namesake)
        self._wanted: tuple[str, ...] = ()
        """Topics to listen to, none of them below another."""
        self._heeded: tuple[str, ...] | None = None
        """Those that the session listens to. Like it and its subscribers, the link's thread's own."""
        self._subscribers: dict[str, Any] = {}
        self._changed = threading.Event()
        """What is heeded is what is wanted."""
        self._inlets: tuple[Any, ...] = ()
        """The same subscribers, for whoever receives."""
        self._room = max(1, transport.inbox_bytes // LARGEST_BATCH)
        self._queue = SendQueue(transport.queue_bytes)
        self._session: Any = None
        self._links: dict[str, bool] = {}
        """Who is on the other side of each connection, and whether that is a router."""
        self._linked_s = time.monotonic()
        self._quiet_s: float | None = None
        """Since when nothing came to who asked for it."""
        """When there was last a connection more or less."""
        self._met = threading.Event()
        self._refused: TerrafuseError | None = None
        self._closing = threading.Event()
        self._tried = threading.Event()
        self._lock = threading.Lock()
        """Of what callers, the link's thread and Zenoh's share. Never held while Zenoh is called."""
        self._alive_s = time.monotonic()
        """When the link's thread last had nothing to wait for."""
        self._thread = threading.Thread(target=self._run, name=f"link of {node}", daemon=True)
        self._thread.start()
        self._tried.wait(FIRST_S)
        if self._refused is not None:
            self.close()
            raise self._refused

    @property
    def connected(self) -> bool:
        """Whether there is anybody on the other side."""
        return bool(self._links)

    @property
    def _alone(self) -> bool:
        """Whether none of the addresses to connect to has been reached."""
        return bool(self._connects) and not any(self._links.values())

    def nodes(self) -> list[str]:
        """The other nodes that are there, sorted, as far as a connection leads to them: none while there is none. One
        that was killed leaves at once, one whose connection hangs after `hung_s`. A node that only connects looks for
        all when it is first asked: that answer may lack some."""
        return self._presence.nodes()

    def overhead_bytes(self, topic: str, payload_bytes: int) -> int:
        """Of Zenoh's key and headers, and of what TLS, TCP and IP add to each segment; measured, and a little more."""
        message = len(f"{ROOT}/{key_of(topic)}".encode()) + ZENOH_BYTES
        segment = TCP_BYTES + (0 if self.transport.keys is None else TLS_BYTES)
        return message + segment * -(-(payload_bytes + message) // (SEGMENT_BYTES - segment))

    def listen(self, topic: str) -> None:
        check_heard(topic)
        with self._lock:
            if any(covers(own, topic) for own in self._wanted):
                return
            self._wanted = (*(own for own in self._wanted if not covers(topic, own)), topic)
            self._changed.clear()
        self._queue.wake()
        if self._session is not None:
            self._changed.wait(LISTEN_S)

    def send(self, topic: str, payload: bytes, now_ns: int) -> None:
        check_frame(self, topic, payload)
        self._check_open(topic)
        if not self.connected:
            self.counts["dropped.unconnected"] += 1
        elif not self._queue.add(Frame(topic, payload)):
            self.counts["dropped.queue"] += 1

    def receive(self, now_ns: int) -> list[Frame]:
        if self._refused is not None:
            raise self._refused
        self._check_stuck()
        inlets = () if self._closing.is_set() else self._inlets
        frames = [frame for inlet in inlets for frame in self._taken(inlet)]
        self._quiet_s = None if frames else self._quiet_s or time.monotonic()
        self.counts["frames_received"] += len(frames)
        self.counts["bytes_received"] += sum(len(frame.payload) for frame in frames)
        return frames

    def _taken(self, inlet: Any) -> list[Frame]:
        frames: list[Frame] = []
        with suppress(self._zenoh.ZError):  # no longer listened to
            while len(frames) < self._room and (sample := inlet.try_recv()) is not None:
                topic = topic_of(str(sample.key_expr).removeprefix(f"{ROOT}/"))
                frames.append(Frame(topic, sample.payload.to_bytes()))
        if len(frames) == self._room:
            self.counts["full.inbox"] += 1
        return frames

    def close(self) -> None:
        """Leave, within two seconds, whoever hangs. What waits to be sent is lost."""
        self._closing.set()
        self._queue.clear()
        self._end_session()
        if self._thread is not threading.current_thread():
            self._thread.join(CLOSE_S)

    def _check_open(self, topic: str) -> None:
        if self._refused is not None:
            raise self._refused
        if self._closing.is_set():
            raise closed(self, topic)

    def _check_stuck(self) -> None:
        silent_s = time.monotonic() - self._alive_s
        if silent_s > STUCK_S and not self._closing.is_set():
            raise TerrafuseError(f"Zenoh has kept the link of '{self.node}' waiting for {silent_s:.0f} s; make it anew")

    # --- the link's thread --------------------------------------------------------------------------------------------

    def _run(self) -> None:
        pause_s, looked_s = PAUSE_S, 0.0
        while not self._closing.is_set():
            self._alive_s = time.monotonic()
            if self._session is None:
                if self._open():
                    pause_s = PAUSE_S
                else:
                    self._closing.wait(pause_s)
                    pause_s = min(2 * pause_s, LONGEST_PAUSE_S)
                continue
            with suppress(self._zenoh.ZError):  # closed meanwhile
                self._heed(self._session)
            frame = self._queue.take(LOOK_S)
            if frame is not None:
                self._put(frame)
            if time.monotonic() - looked_s >= LOOK_S:
                self._look()
                looked_s = time.monotonic()

    def _open(self) -> bool:
        """One attempt; whether there is a session now."""
        try:
            session = self._zenoh.open(self._config())
        except self._zenoh.ZError as error:
            self._not_opened(str(error))
            return False
        with self._lock:
            late = self._closing.is_set()
            self._session = None if late else session
        if late:
            self._leave(session)
            return False
        try:
            self._declare(session)
        except self._zenoh.ZError as error:
            self._end_session()
            if not self._closing.is_set():
                self._not_opened(str(error))
            return False
        self._check_name()
        if not self._alone:
            self._well()
        self._tried.set()
        return True

    def _config(self) -> Any:
        tls, access = (None, None) if self._identity is None else (self._identity.tls, self._identity.access)
        config = self._zenoh.Config()
        for path, value in zenoh_settings(self.transport, tls, access if self._listens else None).items():
            config.insert_json5(path, json.dumps(value))
        return config

    def _not_opened(self, error: str) -> None:
        trouble = listen_trouble(self._listens, error) if self._listens else self._diagnosis()
        if self._listens and not self._tried.is_set():
            self._refuse(InputError(trouble))
        else:
            self._say(trouble)
        self._tried.set()

    def _declare(self, session: Any) -> None:
        watch = self._zenoh.handlers.Callback(self._linked, indirect=False)
        session.info.declare_transport_events_listener(watch, history=True)
        self._presence.join(session)
        self._heeded, self._subscribers, self._inlets = None, {}, ()
        self._heed(session)

    def _heed(self, session: Any) -> None:
        """Have the session listen to what is wanted by now."""
        with self._lock:
            wanted = self._wanted
        if session is None or wanted == self._heeded:
            return
        for topic in self._subscribers.keys() - wanted:
            self._subscribers.pop(topic).undeclare()
        for topic in wanted:
            if topic not in self._subscribers:
                self._subscribers[topic] = self._subscribe(session, topic)
        self._heeded, self._inlets = wanted, tuple(self._subscribers.values())
        with self._lock:
            if wanted == self._wanted:
                self._changed.set()

    def _subscribe(self, session: Any, topic: str) -> Any:
        ring = self._zenoh.handlers.RingChannel(self._room)
        return session.declare_subscriber(
            f"{ROOT}/{key_of(topic)}/**", ring, allowed_origin=self._zenoh.Locality.REMOTE
        )

    def _end_session(self) -> None:
        with self._lock:
            session, self._session = self._session, None
            self._links = {}
        self._presence.lost()
        if session is not None:
            self._leave(session)

    def _leave(self, session: Any) -> None:
        """Zenoh takes leave of each connection in turn, of a hung one for ten seconds: it may do so alone."""

        def close() -> None:
            with suppress(self._zenoh.ZError):
                session.close()

        leaving = threading.Thread(target=close, name=f"end of {self.node}", daemon=True)
        leaving.start()
        leaving.join(CLOSE_S)

    def _put(self, frame: Frame) -> None:
        session = self._session
        if session is None or not self.connected:
            self.counts["dropped.unconnected"] += 1
            return
        try:
            session.put(
                f"{ROOT}/{key_of(frame.topic)}",
                frame.payload,
                congestion_control=self._zenoh.CongestionControl.DROP,
                allowed_destination=self._zenoh.Locality.REMOTE,
            )
        except self._zenoh.ZError:  # closed meanwhile
            self.counts["dropped.unconnected"] += 1
            return
        self.counts["frames_sent"] += 1
        self.counts["bytes_sent"] += len(frame.payload)

    def _look(self) -> None:
        """What nobody tells the thread of: rules that changed, a namesake, a connection that does not come back."""
        with suppress(self._zenoh.ZError):  # closed meanwhile
            self._presence.look(self._session)
        if self._met.is_set():
            self._met.clear()
            self._check_name()
        if self._identity is not None and self._identity.changed():
            self._renew()
        if self._deaf():
            self.counts["renewed"] += 1
            self._end_session()
        elif self._shut_out():
            self._say(
                f"connected, but nobody lets '{self.node}' hear or say anything: it was revoked, or the station does "
                "not know it yet; bring the fleet's fleet.json to the folder of the station's keys"
            )
        elif not self._alone:
            self._well()
        elif self.trouble is None and time.monotonic() - self._linked_s > NO_WORD_S:
            self._say(self._diagnosis())

    def _deaf(self) -> bool:
        """Only who connects ends its session for that: those who listen have others' connections."""
        quiet = self._quiet_s is not None and time.monotonic() - max(self._quiet_s, self._linked_s) > DEAF_S
        return quiet and not self._listens and not self._alone and self._presence.accompanied

    def _shut_out(self) -> bool:
        """Whether there is a connection, for long enough, and still no sign even of who is at its other end. Of who
        only listens nobody need be there."""
        settled = bool(self._connects) and time.monotonic() - self._linked_s > NO_WORD_S
        return self._identity is not None and not self._alone and settled and not self._presence.accompanied

    def _renew(self) -> None:
        """Keys and rules can't be changed on a session; a new one has them, and the others are back within seconds."""
        try:
            self._identity = _identity(self.node, self.transport)
        except TerrafuseError as error:
            self._say(f"{error}; what was before stays in force")
        else:
            self._end_session()

    def _check_name(self) -> None:
        session, namesake = self._session, None
        with suppress(self._zenoh.ZError):  # closed meanwhile
            namesake = None if session is None else self._presence.namesake(session)
        if namesake is None:
            return
        self._refuse(
            InputError(
                f"there is a node '{self.node}' already, and it answers; names must differ: give this one another, "
                "or stop the other"
            )
        )

    def _refuse(self, error: TerrafuseError) -> None:
        """The end of this link; said by whatever it is asked for next."""
        self._refused, self.trouble = error, str(error)
        self._closing.set()
        self._end_session()
        self._tried.set()

    def _diagnosis(self) -> str:
        if self.counts["connections"] and time.monotonic() - self._linked_s < SHORT_BREAK_S:
            return f"lost the connection to {', '.join(map(str, self._connects))}"
        return "; ".join(diagnosis(each, self._identity) for each in self._connects)

    def _say(self, trouble: str) -> None:
        if trouble != self.trouble and not self._closing.is_set():
            self.trouble = trouble
            self._tell(f"{trouble}; trying again until it works")

    def _well(self) -> None:
        if self.trouble is not None:
            self.trouble = None
            self._tell("connected")

    # --- Zenoh's threads ----------------------------------------------------------------------------------------------

    def _linked(self, event: Any) -> None:
        other, there = str(event.transport.zid), str(event.kind) == "SampleKind.PUT"
        router = event.transport.whatami == self._zenoh.WhatAmI.ROUTER
        with self._lock:
            others = {zid: hub for zid, hub in self._links.items() if zid != other}
            self._links = others | ({other: router} if there else {})
            self.counts["connections"] += there
            self._linked_s = time.monotonic()

    def _meet_namesake(self) -> None:
        self._met.set()


def _library() -> Any:
    try:
        import zenoh
    except ImportError as error:
        raise MissingExtra("a network of processes", "eclipse-zenoh", "net") from error
    return zenoh


def _identity(node: str, transport: Transport) -> Identity | None:
    if transport.keys is None:
        return None
    try:
        from terrafuse.keys.identity import load_identity
    except ImportError as error:
        raise MissingExtra("keys", "cryptography", "net") from error
    return load_identity(transport.keys, node, bool(transport.listen))
