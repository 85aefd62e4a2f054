"""The radio between simulated nodes: whom a frame reaches depends on where they are.

From the sender's place to the receiver's, d metres apart, a frame is lost with probability (d/R)^exponent, 1 from R on;
R is `range_m`, or what walls leave of it where they can't see each other. Where the communications layer has no signal,
at either end, nothing passes.
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import count
from math import dist
from zlib import crc32

import numpy as np

from terrafuse.errors import InputError
from terrafuse.exchange.links.base import Frame, check_frame, closed
from terrafuse.exchange.links.faults import FATES, Cut, Faults, Queue, disturbed
from terrafuse.exchange.links.memory import MemoryHub, MemoryLink

Place = tuple[float, float, float]
"""East, north, up, metres."""
WIFI_FRAME = 2312
"""Bytes that a frame of IEEE 802.11b carries, as the *grey* paper counts."""
WIFI = Faults(delay_s=0.002, bytes_per_s=250_000.0, overhead_bytes=12)


@dataclass(frozen=True)
class RadioCut(Cut):
    """A cut between two nodes, or between `node` and all others, or, without a name, between all."""

    node: str | None = None
    other: str | None = None

    def parts(self, one: str, two: str) -> bool:
        return {name for name in (self.node, self.other) if name is not None} <= {one, two}


@dataclass(frozen=True)
class RadioSettings:
    """What a radio is like. The default carries the *grey* paper's frames."""

    range_m: float = 150.0
    """In sight of each other; from there on nothing arrives."""
    behind_walls: float = 0.3
    """Share of the range that is left out of sight, 0 to 1."""
    exponent: float = 4.0
    """How the loss grows with the distance: at half the range it is 2^-exponent."""
    frame_bytes: int = WIFI_FRAME
    faults: Faults = WIFI
    """What goes wrong whatever the distance; latency, rate of each sender, and header of each frame."""
    cuts: tuple[RadioCut, ...] = ()

    def __post_init__(self) -> None:
        if not (self.range_m > 0 and self.exponent > 0 and 0 <= self.behind_walls <= 1):
            raise InputError(
                f"radio of range_m {self.range_m}, exponent {self.exponent}, behind_walls {self.behind_walls}: "
                "give positive numbers, and a share from 0 to 1"
            )
        if self.frame_bytes <= self.faults.overhead_bytes:
            raise InputError(f"frame_bytes {self.frame_bytes}: no room beside {self.faults.overhead_bytes} of overhead")


@dataclass(frozen=True)
class Surroundings:
    """What the world does to radio: whether two places see each other, and whether there is a signal at (x, y)."""

    sight: Callable[[Place, Place], bool] = lambda one, two: True
    communications: Callable[[float, float], object] = lambda x_m, y_m: True


def loss(settings: RadioSettings, surroundings: Surroundings, one: Place, two: Place) -> float:
    """Chance that a frame from one place to the other is lost on the way; 1: out of reach."""
    distance_m = dist(one, two)
    if distance_m >= settings.range_m or not all(surroundings.communications(*end[:2]) for end in (one, two)):
        return 1.0
    reach_m = settings.range_m
    if not surroundings.sight(one, two):
        reach_m *= settings.behind_walls
    return float((distance_m / reach_m) ** settings.exponent) if distance_m < reach_m else 1.0


class Radio:
    """All radios of a simulated world. Each node sends one frame after the other; nodes don't disturb each other.

    What befalls a frame is decided when its last byte leaves, by the places of that moment, for each receiver alone and
    from a stream of random numbers for each pair of names: a robot more changes nothing for the others.
    """

    def __init__(
        self, settings: RadioSettings | None = None, surroundings: Surroundings | None = None, seed: int = 0
    ) -> None:
        self.settings = settings or RadioSettings()
        self.counts: dict[str, Counter[str]] = {}
        """By node: frames_sent and bytes_sent with headers; frames_received and bytes_received; of what it sent, also
        overflowed, and for each receiver out_of_reach, cut, lost, corrupted, duplicated, reordered."""
        self._surroundings = surroundings or Surroundings()
        self._seed = seed
        self._hub = MemoryHub(self.settings.frame_bytes - self.settings.faults.overhead_bytes)
        self._places: dict[str, Place] = {}
        self._queues: dict[str, Queue] = {}
        self._streams: dict[tuple[str, str], np.random.Generator] = {}
        self._events: list[tuple[int, int, Callable[[int], None]]] = []
        self._order = count()
        self._now_ns = 0

    def link(self, node: str, place: Sequence[float]) -> RadioLink:
        """The radio of a new node at this place. Raises InputError while another node has its name."""
        end = self._hub.link(node)
        self._places[node] = _place(place)
        self._queues[node] = Queue()
        self.counts.setdefault(node, Counter())
        return RadioLink(self, end)

    def move(self, node: str, place: Sequence[float], now_ns: int) -> None:
        """From now on the node is there."""
        if node not in self._places:
            raise InputError(f"no node '{node}' has a radio; there are {', '.join(sorted(self._places)) or 'none'}")
        self.advance(now_ns)
        self._places[node] = _place(place)

    def send(self, sender: MemoryLink, frame: Frame, now_ns: int) -> None:
        """Put a frame into the sender's queue; its link calls this."""
        self.advance(now_ns)
        leaves_ns = self._queues[sender.node].leaves_ns(frame.payload, self.settings.faults, now_ns)
        if leaves_ns is None:
            self.counts[sender.node]["overflowed"] += 1
        else:
            self._at(leaves_ns, lambda at_ns: self._leave(sender, frame, at_ns))
        self.advance(now_ns)

    def advance(self, now_ns: int) -> None:
        """Let happen what happens up to now."""
        if now_ns < self._now_ns:
            raise InputError(f"now_ns {now_ns} after {self._now_ns}: a radio's clock never runs backwards")
        self._now_ns = now_ns
        while self._events and self._events[0][0] <= now_ns:
            at_ns, _, event = heapq.heappop(self._events)
            event(at_ns)

    def _at(self, time_ns: int, event: Callable[[int], None]) -> None:
        heapq.heappush(self._events, (time_ns, next(self._order), event))

    def _leave(self, sender: MemoryLink, frame: Frame, at_ns: int) -> None:
        """The last byte of a frame has left."""
        if not sender.open:
            return
        self._count(sender.node, "sent", frame)
        for receiver in self._hub.listeners(frame.topic, sender.node):
            for delay_ns, payload in self._arrivals(sender.node, receiver.node, frame.payload, at_ns):
                self._at(at_ns + delay_ns, self._arrival(receiver, Frame(frame.topic, payload)))

    def _arrivals(self, sender: str, receiver: str, payload: bytes, at_ns: int) -> Sequence[tuple[int, bytes]]:
        """(delay, bytes) of each copy that will arrive."""
        settings, counts = self.settings, self.counts[sender]
        fate = self._stream(sender, receiver).random(FATES)
        lost = loss(settings, self._surroundings, self._places[sender], self._places[receiver])
        if lost >= 1:
            counts["out_of_reach"] += 1
            return []
        faults = settings.faults
        if faults.cut(at_ns) or any(cut.at(at_ns) and cut.parts(sender, receiver) for cut in settings.cuts):
            counts["cut"] += 1
            return []
        return disturbed(payload, replace(faults, loss=1 - (1 - faults.loss) * (1 - lost)), fate, counts)

    def _arrival(self, receiver: MemoryLink, frame: Frame) -> Callable[[int], None]:
        def arrive(_: int) -> None:
            if receiver.open:
                self._count(receiver.node, "received", frame)
                receiver.deliver(frame)

        return arrive

    def _stream(self, sender: str, receiver: str) -> np.random.Generator:
        pair = (sender, receiver)
        if pair not in self._streams:
            self._streams[pair] = np.random.default_rng([self._seed, *(crc32(name.encode()) for name in pair)])
        return self._streams[pair]

    def _count(self, node: str, what: str, frame: Frame) -> None:
        self.counts[node][f"frames_{what}"] += 1
        self.counts[node][f"bytes_{what}"] += len(frame.payload) + self.settings.faults.overhead_bytes


class RadioLink:
    """A node's radio; made by `Radio.link`."""

    def __init__(self, radio: Radio, end: MemoryLink) -> None:
        self._radio = radio
        self._end = end

    @property
    def node(self) -> str:
        return self._end.node

    @property
    def max_frame_bytes(self) -> int:
        return self._end.max_frame_bytes

    def listen(self, topic: str) -> None:
        self._end.listen(topic)

    def send(self, topic: str, payload: bytes, now_ns: int) -> None:
        check_frame(self, topic, payload)
        if not self._end.open:
            raise closed(self, topic)
        self._radio.send(self._end, Frame(topic, payload), now_ns)

    def receive(self, now_ns: int) -> list[Frame]:
        self._radio.advance(now_ns)
        return self._end.receive(now_ns)

    def close(self) -> None:
        self._end.close()


def _place(place: Sequence[float]) -> Place:
    east_m, north_m, up_m = (float(value) for value in place)
    if not np.isfinite([east_m, north_m, up_m]).all():
        raise InputError(f"a radio at {(east_m, north_m, up_m)}: give finite metres")
    return east_m, north_m, up_m
