"""Says what a node holds: all of it now and then, what is new soon after it came."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from itertools import cycle, islice
from math import inf
from typing import TypeVar

from terrafuse.exchange.comparing import Comparing
from terrafuse.exchange.framing import HEADER_BYTES, Reassembler
from terrafuse.exchange.holding import Holding
from terrafuse.exchange.outbox import SUMMARY, Outbox
from terrafuse.exchange.pace import SECOND_NS, CourierSettings
from terrafuse.exchange.summary import VERSION, State, Summary, pack
from terrafuse.types import Bounds

ENTRY_BYTES = 12
"""About what a robot takes in a summary."""
LEAST_ENTRIES = 4
MOST_AHEAD = 64
"""Tiles of a robot that are ahead, in a whole summary; what came since the last one is said all."""
MOST_UNSAID = 64
"""Unfinished messages told of in one summary."""


T = TypeVar("T")


class Herald:
    """`holdings`: of channels into which the node takes contributions."""

    def __init__(
        self, node: str, holdings: Mapping[str, Holding], outbox: Outbox, reassembler: Reassembler,
        settings: CourierSettings, comparing: Mapping[str, Comparing],
    ) -> None:  # fmt: skip
        self.area: Bounds | None = None
        """Of interest to this node."""
        self._node, self._holdings, self._outbox, self._reassembler = node, holdings, outbox, reassembler
        self._settings, self._comparing = settings, comparing
        self._share = settings.summary_share * settings.bytes_per_s
        self._soon_ns = 0
        """Until then it has nothing more to say than it must."""
        self._whole = False
        """Whether a whole summary is due."""
        self._next: dict[str, int] = {}
        """Where the next whole summary goes on that can't say all at once: by channel, of robots; of their tiles."""

    def say(self, now_ns: int, born_ns: int, whole: bool, finished: Callable[[], list[bytes]], posts: bool) -> None:
        """All that is held, with `whole`; else what is new, if anything is; as soon as it is time. `posts`: arrived."""
        self._whole |= whole
        news = posts or any(holding.unsaid for holding in self._holdings.values())
        if now_ns < self._soon_ns or not (self._whole or news):
            return
        whole, self._whole = self._whole, False
        robots = {name: self._robots(name, whole) for name in self._holdings}
        held = {name: {robot: self._holdings[name].of(robot).base for robot in some} for name, some in robots.items()}
        ahead = {name: {robot: self._ahead(name, robot, whole) for robot in some} for name, some in robots.items()}
        roots = {name: self._comparing[name].roots(some, now_ns) for name, some in robots.items() if whole}
        missing = dict(list(self._reassembler.missing().items())[-self._entries(MOST_UNSAID) :])
        counts = {name: len(holding.known) for name, holding in self._holdings.items()}
        head = Summary(VERSION, born_ns, now_ns, counts, area=self.area)
        size = 0
        for message in pack(
            head, State(held, missing, finished(), ahead, roots), self._outbox.max_frame_bytes - HEADER_BYTES
        ):
            self._outbox.put(self._outbox.message(f"summary/{self._node}", message), SUMMARY)
            size += len(message) + HEADER_BYTES
        for holding in self._holdings.values():
            holding.unsaid.clear()
        self._soon_ns = now_ns + round(max(self._settings.answer_s, size / self._share) * SECOND_NS)

    def _entries(self, most: int) -> int:
        """How many entries of a kind a summary should have, of so many."""
        room = self._share * self._settings.period_s / ENTRY_BYTES / (len(self._holdings) + 1)
        return most if room == inf else min(most, max(LEAST_ENTRIES, round(room)))

    def _robots(self, channel: str, whole: bool) -> Collection[str]:
        holding = self._holdings[channel]
        if not whole:
            return list(holding.unsaid)
        return list(dict.fromkeys([*holding.unsaid, *self._turn(channel, list(holding.known), len(holding.known))]))

    def _turn(self, what: str, entries: Sequence[T], most: int) -> list[T]:
        """As many as there is room for, and the next time those that follow."""
        count = min(self._entries(most), len(entries))
        start = self._next.get(what, 0) % max(len(entries), 1)
        self._next[what] = start + count
        return list(islice(cycle(entries), start, start + count))

    def _ahead(self, channel: str, robot: str, whole: bool) -> list[tuple[int, int, int]]:
        holding = self._holdings[channel]
        known, new = holding.of(robot), holding.unsaid.get(robot, set())
        keys = [key for key in known.ahead if key in new]
        if whole:
            keys += self._turn(f"{channel}/{robot}", [key for key in known.ahead if key not in new], MOST_AHEAD)
        return [(key.x, key.y, known.ahead[key]) for key in keys]
