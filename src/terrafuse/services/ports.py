"""What services of one node hand to each other across threads: typed, bounded, and safe to use from both ends."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass, replace
from typing import NamedTuple

from terrafuse.exchange.corrections import Corrections
from terrafuse.exchange.delta import Delta
from terrafuse.services.service import Message
from terrafuse.types import Scan

MOST_SCANS = 8
MOST_DELTAS = 64
MOST_LETTERS = 8192


@dataclass(frozen=True)
class Wanted:
    """What the mapping asks of the source: scans after so many. `life` counts up with each such wish."""

    life: int = 0
    after: int = 0
    known: int = 0
    """Scans that were mapped before: they come at once."""
    corrections: Corrections = ()
    """Of their poses."""


class ScanPort:
    """Scans from a source to a mapping. The mapping says where to begin; scans of an older wish never arrive."""

    def __init__(self, most: int = MOST_SCANS) -> None:
        self._most = most
        self._lock = threading.Lock()
        self._scans: deque[Scan] = deque()
        self._wanted = Wanted()
        self._given = 0
        self._ended = False

    def ask(self, after: int, known: int = 0, corrections: Corrections = ()) -> None:
        """From now on, give what comes after so many scans."""
        with self._lock:
            self._scans.clear()
            self._wanted = Wanted(self._wanted.life + 1, after, known, corrections)
            self._given, self._ended = after, False

    @property
    def wanted(self) -> Wanted:
        """For a source to begin with: a source that is started afresh goes on after what was given."""
        with self._lock:
            return replace(self._wanted, after=self._given)

    @property
    def life(self) -> int:
        return self._wanted.life

    @property
    def full(self) -> bool:
        return len(self._scans) >= self._most

    @property
    def waiting(self) -> int:
        return len(self._scans)

    @property
    def ended(self) -> bool:
        """Nothing waits, and nothing more will come."""
        with self._lock:
            return self._ended and not self._scans

    def put(self, life: int, scan: Scan) -> None:
        with self._lock:
            if life == self._wanted.life:
                self._scans.append(scan)
                self._given += 1

    def end(self, life: int) -> None:
        with self._lock:
            self._ended = self._ended or life == self._wanted.life

    def take(self) -> Scan | None:
        with self._lock:
            return self._scans.popleft() if self._scans else None


class Handover:
    """From a mapping to the exchange: that all is on disk, and what changed on the coarser lattice.

    The fine map goes by the store alone. Deltas that the exchange is too slow for are not dropped: `full` says so, and
    the mapping, whose coarse map only ever is the newest, makes one larger delta later.
    """

    def __init__(self) -> None:
        self.committed = threading.Event()
        """All scans of the source are, by the corrections that hold."""
        self.corrected = 0
        """How often corrections came that the mapping has to look at; the exchange's to count."""
        self.coarse: deque[Delta] = deque()

    @property
    def full(self) -> bool:
        return len(self.coarse) >= MOST_DELTAS


class Letter(NamedTuple):
    """A message for a service of another node. Of those to the same service, of one kind and subject, which have not
    gone yet, only the newest goes."""

    node: str
    service: str
    message: Message
    subject: str = ""

    @property
    def kind(self) -> str:
        """As couriers have it."""
        return f"{self.service} {self.message.contract} {self.message.kind} {self.subject}"


def letter_from(sender: str, kind: str, payload: bytes) -> Letter | None:
    """What a courier brought of a node; None: nothing that one of our services sent."""
    parts = kind.split(" ", 3)
    if len(parts) != 4:
        return None
    service, contract, name, subject = parts
    return Letter("", service, Message(contract, name, payload, sender), subject)


class Letterbox:
    """Letters on their way out, from any service of the node to its exchange."""

    def __init__(self) -> None:
        self._letters: deque[Letter] = deque(maxlen=MOST_LETTERS)

    def put(self, letter: Letter) -> None:
        self._letters.append(letter)

    def forked(self, node: str, other: Letterbox) -> Letterbox:
        """One that puts letters to `node` into the other, and the rest into this one."""
        return _Fork(self, node, other)

    def take(self) -> list[Letter]:
        return [self._letters.popleft() for _ in range(len(self._letters))]


class _Fork(Letterbox):
    def __init__(self, first: Letterbox, node: str, other: Letterbox) -> None:
        super().__init__()
        self._first, self._node, self._other = first, node, other

    def put(self, letter: Letter) -> None:
        (self._other if letter.node == self._node else self._first).put(letter)
