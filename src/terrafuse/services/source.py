"""The service that senses: scans of a recording, or of a simulated robot, in the map's frame (*patrol*: 3D Laser)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any

from terrafuse.exchange.corrections import Corrections, corrected
from terrafuse.logs.base import Log, Record
from terrafuse.mapping import Plan, placed, prepared
from terrafuse.services.places import Track
from terrafuse.services.ports import ScanPort
from terrafuse.services.service import IDLE_S, SECOND_NS, Contract, Message, Service
from terrafuse.types import Scan

AT_A_TIME = 64
"""Scans that were mapped in an earlier life, passed over in one tick."""


class Source(Service):
    """Gives the plan's robot's scans to a port, as fast as they are taken, or at the pace of their stamps; and to a
    track where they were taken."""

    contract = Contract("terrafuse/source", 1, frozenset({"pause", "resume", "begin"}))
    partners = ("mapping",)

    def __init__(
        self, run: Plan, robot: str, port: ScanPort, realtime: bool = False, track: Track | None = None
    ) -> None:
        super().__init__()
        self._run, self._robot, self._port, self._realtime = run, robot, port, realtime
        self._log: Log = run.logs[robot]
        self._track = track or Track()
        self._life = 0
        self._records: Iterator[Record] = iter(())
        self._passed_over = 0
        self._after = self._known = 0
        self._corrections: Corrections = ()
        self._skipped: Counter[str] = Counter()
        self._next: Scan | None = None
        self._offset_ns: int | None = None
        self._paused = False
        self._points = self._scans = 0

    def post(self, message: Message) -> None:
        """`begin`: there is more to give, though all was given."""
        if message.kind == "begin":
            self.done = self.done and self._port.life == self._life
            return
        self._paused = message.kind == "pause"
        self._offset_ns = None

    def tick(self, now_ns: int) -> float:
        if self._port.life != self._life:
            self._begin()
        if self._paused or self.done or not self._life or self._port.full:
            return IDLE_S
        if self._passed_over < self._after:
            return self._pass_over()
        self._next = self._next or self._read()
        if self._next is None:
            self._port.end(self._life)
            self.done = True
            return IDLE_S
        if self._realtime and self._scans > self._known and (wait_s := self._early_s(self._next.stamp_ns, now_ns)) > 0:
            return wait_s
        scan = prepared(self._run, self._robot, self._next, self._corrections)
        self._track.add(scan)
        self._port.put(self._life, scan)
        self._next = None
        return 0.0

    def state(self) -> dict[str, Any]:
        return {
            "log": str(self._log.path),
            "reader": self._log.reader,
            "scans": self._scans,
            "points": self._points,
            "resumed_scans": self._passed_over,
            "records": self._log.count,
            "skipped": dict(sorted(self._skipped.items())),
            "paused": self._paused,
        }

    def _begin(self) -> None:
        wanted = self._port.wanted
        self._life, self._after = wanted.life, wanted.after
        self._known, self._corrections = wanted.known, wanted.corrections
        self._track.clear()
        self._records, self._next, self._offset_ns, self.done = self._log.scans(), None, None, False
        self._passed_over = self._scans = self._points = 0
        self._skipped.clear()

    def _pass_over(self) -> float:
        """Scans that the map holds already."""
        for _ in range(min(AT_A_TIME, self._after - self._passed_over)):
            scan = self._read()
            if scan is None:
                self._after = self._passed_over  # fewer than the map holds: the mapping says what that means
                break
            self._track.add(corrected(placed(scan, self._log, self._run.settings), self._corrections))
            self._passed_over += 1
        return 0.0

    def _read(self) -> Scan | None:
        for record in self._records:
            if isinstance(record, Scan):
                self._scans += 1
                self._points += len(record.points)
                return record
            self._skipped[record.reason] += 1
        return None

    def _early_s(self, stamp_ns: int, now_ns: int) -> float:
        """How long until a scan of this stamp is due, where the first one of this pass was due when it was read."""
        if self._offset_ns is None:
            self._offset_ns = now_ns - stamp_ns
        return min((stamp_ns + self._offset_ns - now_ns) / SECOND_NS, IDLE_S)

    def close(self) -> None:
        closing = getattr(self._records, "close", None)
        if closing is not None:
            closing()
