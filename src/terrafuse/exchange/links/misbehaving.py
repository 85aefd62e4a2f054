"""A link that misbehaves as a seed and a script say, around any other."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Sequence
from itertools import count

import numpy as np

from terrafuse.errors import InputError
from terrafuse.exchange.links.base import Frame, Link, check_frame, closed, overhead_of
from terrafuse.exchange.links.faults import FATES, PERFECT, Faults, Queue, disturbed


class MisbehavingLink:
    """`link`, with faults on what it sends; in a cut it receives nothing, either.

    The same seed, calls and times give the same behaviour. Frames that are delayed go on when their time has come and
    the link is used again: poll it as often as times shall be exact. `now_ns` may not run backwards. `counts` has how
    many frames were sent, lost, corrupted, duplicated, reordered, cut (lost in one) and overflowed (lost in the queue).
    """

    def __init__(self, link: Link, faults: Faults = PERFECT, seed: int | Sequence[int] = 0) -> None:
        self.counts: Counter[str] = Counter()
        self.faults = faults
        self._link = link
        self._rng = np.random.default_rng(seed)
        self._queue = Queue()
        self._under_way: list[tuple[int, int, Frame]] = []
        self._order = count()
        self._now_ns = 0
        self._closed = False

    @property
    def node(self) -> str:
        return self._link.node

    @property
    def max_frame_bytes(self) -> int:
        return self._link.max_frame_bytes

    def overhead_bytes(self, topic: str, payload_bytes: int) -> int:
        return overhead_of(self._link)(topic, payload_bytes)

    def listen(self, topic: str) -> None:
        self._link.listen(topic)

    def send(self, topic: str, payload: bytes, now_ns: int) -> None:
        check_frame(self, topic, payload)
        if self._closed:
            raise closed(self, topic)
        self._forward(now_ns)
        self.counts["sent"] += 1
        fate = self._rng.random(FATES)
        leaves_ns = self._queue.leaves_ns(payload, self.faults, now_ns)
        if leaves_ns is None:
            self.counts["overflowed"] += 1
        elif self.faults.cut(leaves_ns):
            self.counts["cut"] += 1
        else:
            for delay_ns, arriving in disturbed(payload, self.faults, fate, self.counts):
                entry = (leaves_ns + delay_ns, next(self._order), Frame(topic, arriving))
                heapq.heappush(self._under_way, entry)
        self._forward(now_ns)

    def receive(self, now_ns: int) -> list[Frame]:
        self._forward(now_ns)
        frames = self._link.receive(now_ns)
        if self.faults.cut(now_ns):
            self.counts["cut"] += len(frames)
            return []
        return frames

    def close(self) -> None:
        self._under_way.clear()
        self._closed = True
        self._link.close()

    def _forward(self, now_ns: int) -> None:
        """Pass on what is due."""
        if now_ns < self._now_ns:
            raise InputError(f"now_ns {now_ns} after {self._now_ns}: a link's clock never runs backwards")
        self._now_ns = now_ns
        while self._under_way and self._under_way[0][0] <= now_ns:
            due_ns, _, frame = heapq.heappop(self._under_way)
            self._link.send(*frame, due_ns)
