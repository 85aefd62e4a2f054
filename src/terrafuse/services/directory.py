"""The service that knows which services there are: its own node's, and those of nodes that report to it.

Nodes report to their stations; whoever asks a station, learns of the whole fleet.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any

import msgspec
import zstandard

from terrafuse.services.ports import Letter, Letterbox
from terrafuse.services.service import IDLE_S, SECOND_NS, Contract, Message, Service, Status

DIRECTORY = "directory"
CONTRACT = Contract(f"terrafuse/{DIRECTORY}", 1, remote=frozenset({"states", "ask", "fleet"}))
PERIOD_S = 1.0
BUDGET_SHARE = 0.05
"""Of a thin link, for these reports."""
LOST_PERIODS = 3.0
GRACE_S = 2.0
FORGET_S = 600.0
"""A node that says nothing is shown as lost for so long."""
MOST_NODES = 4096
MOST_BYTES = 1 << 16
"""Of a node's report, unpacked; what a directory tells of a node may be longer, as a station's own is."""
MOST_PACKED = 60_000


class Report(msgspec.Struct):
    """What a node says of its services."""

    period_s: float
    """When the next report is to be expected."""
    services: list[Status]


class Entry(msgspec.Struct):
    """A node as a directory tells of it. `number` is the question's, `of` how many nodes there are in all."""

    node: str
    number: int
    of: int
    age_s: float
    lost: bool
    services: list[Status]


def pack(value: msgspec.Struct) -> bytes:
    return zstandard.ZstdCompressor(level=3).compress(msgspec.msgpack.encode(value))


DECODERS = {kind: msgspec.msgpack.Decoder(kind) for kind in (Report, Entry)}


def unpack(payload: bytes, kind: type[Any], most_bytes: int = MOST_BYTES) -> Any:
    """Raises ValueError for what is none, or too large."""
    try:
        if not 0 <= zstandard.frame_content_size(payload) <= most_bytes:
            raise ValueError(f"no {kind.__name__}: too large")
        return DECODERS[kind].decode(zstandard.ZstdDecompressor().decompress(payload))
    except (zstandard.ZstdError, ValueError, RecursionError) as error:
        raise ValueError(f"no {kind.__name__}: {error}") from error


@dataclass
class _Known:
    report: Report
    heard_ns: int

    def age_s(self, now_ns: int) -> float:
        return (now_ns - self.heard_ns) / SECOND_NS

    def lost(self, now_ns: int) -> bool:
        return self.age_s(now_ns) > LOST_PERIODS * self.report.period_s + GRACE_S


class Directory(Service):
    """`statuses` are the node's own; `report_to` the nodes whose directories hear of them."""

    contract = CONTRACT

    def __init__(
        self,
        node: str,
        statuses: Callable[[], list[Status]],
        letters: Letterbox,
        report_to: Sequence[str] = (),
        bytes_per_s: float = inf,
    ) -> None:
        super().__init__()
        self.partners = tuple(f"{peer}/{DIRECTORY}" for peer in report_to)
        self._node, self._statuses, self._letters, self._report_to = node, statuses, letters, report_to
        self._bytes_per_s = bytes_per_s
        self._known: OrderedDict[str, _Known] = OrderedDict()
        """Whom it heard last comes last."""
        self._now_ns = self._next_ns = 0

    def tick(self, now_ns: int) -> float:
        self._now_ns = now_ns
        if self._report_to and now_ns >= self._next_ns:
            self._next_ns = now_ns + round(self._report() * SECOND_NS)
        while self._known and next(iter(self._known.values())).age_s(now_ns) > FORGET_S:
            self._known.popitem(last=False)
        return IDLE_S

    def post(self, message: Message) -> None:
        if message.kind == "states":
            self._hear(message)
        elif message.kind == "ask":
            self._answer(message)

    def state(self) -> dict[str, Any]:
        return {"nodes": {name: round(known.age_s(self._now_ns), 1) for name, known in sorted(self._known.items())}}

    def _report(self) -> float:
        """Returns when the next one is due: thin links have less often."""
        statuses = self._statuses()
        period_s = max(PERIOD_S, len(pack(Report(0.0, statuses))) / (BUDGET_SHARE * self._bytes_per_s))
        message = Message(CONTRACT.id, "states", pack(Report(period_s, statuses)))
        for peer in self._report_to:
            self._letters.put(Letter(peer, DIRECTORY, message))
        return period_s

    def _hear(self, message: Message) -> None:
        try:
            report = unpack(message.payload, Report)
        except ValueError:
            self.counts["refused.states"] += 1
            return
        if message.sender in self._known or len(self._known) < MOST_NODES:
            self._known[message.sender] = _Known(report, self._now_ns)
            self._known.move_to_end(message.sender)

    def _answer(self, message: Message) -> None:
        number = int.from_bytes(message.payload[:8], "big")
        nodes = {self._node: _Known(Report(PERIOD_S, self._statuses()), self._now_ns), **self._known}
        for name, known in nodes.items():
            entry = Entry(
                name, number, len(nodes), known.age_s(self._now_ns), known.lost(self._now_ns), known.report.services
            )
            packed = pack(entry)
            if len(packed) > MOST_PACKED:
                self.counts["refused.large"] += 1
                entry.services = [msgspec.structs.replace(status, state={}) for status in entry.services]
                packed = pack(entry)
            self._letters.put(Letter(message.sender, DIRECTORY, Message(CONTRACT.id, "fleet", packed), name))
