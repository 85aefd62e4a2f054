"""The service that makes a robot's own map (*patrol*: Robot Mapping)."""

from __future__ import annotations

from collections import Counter
from typing import Any

from terrafuse.errors import InputError
from terrafuse.exchange.coarse import CoarseContribution
from terrafuse.mapper import Mapper
from terrafuse.mapping import Plan
from terrafuse.services.ports import Handover, ScanPort
from terrafuse.services.service import SECOND_NS, Contract, Message, Service
from terrafuse.store.base import Store
from terrafuse.store.behind import WriteBehind
from terrafuse.types import Scan
from terrafuse.window import make_window

COMMIT_S = 1.0
"""What is older is on disk, and so can be told: nothing is told that a crash could take back."""
WAIT_S = 0.01


class Mapping(Service):
    """Takes scans from a port into the robot's map, and that to `archive`, from where the exchange has it.

    Started afresh, it goes on after the last scan that the archive holds, as `terrafuse map` does. A map that failed in
    the middle of a scan is thrown away.
    """

    contract = Contract("terrafuse/mapping", 1, frozenset({"commit"}))
    partners = ("source", "exchange")

    def __init__(self, run: Plan, robot: str, archive: Store, port: ScanPort, handover: Handover) -> None:
        super().__init__()
        self._run, self._port, self._handover = run, port, handover
        self._archive = WriteBehind(archive)
        window = make_window(run.settings.window, run.lattice)
        self.mapper = Mapper(robot, run.lattice, run.model, window, self._archive)
        factor = run.settings.global_factor
        self._coarse = CoarseContribution(self.mapper, factor) if factor > 1 else None
        self._coarse_told = 0
        self._committed, self._commit_ns = self.mapper.revision, 0
        self._dropped: Counter[str] = Counter()
        self._touched = 0
        self._scans = 0
        self._resumed = self.mapper.revision
        self._place_m: list[float] | None = None
        port.ask(after=self._resumed)

    def post(self, message: Message) -> None:
        self._commit()

    def tick(self, now_ns: int) -> float:
        scan = self._port.take()
        if scan is not None:
            self._integrate(scan)
        ended = scan is None and self._port.ended
        if ended or self._due(now_ns):
            self._commit_ns = now_ns
            self._commit()
            self._tell_coarse()
        if ended:
            self._end()
        return 0.0 if scan is not None else WAIT_S

    def state(self) -> dict[str, Any]:
        mapper = self.mapper
        return {
            "robot": mapper.robot,
            "revision": mapper.revision,
            "committed": self._committed,
            "resumed_scans": self._resumed,
            "tiles": len(mapper.keys),
            "resident_bytes": mapper.resident_bytes,
            "waiting_scans": self._port.waiting,
            "place_m": self._place_m,
            "stamp_ns": mapper.stamp_ns,
            "dropped": dict(sorted(self._dropped.items())),
        }

    def leave(self) -> None:
        if not self.done:
            self._commit()

    def close(self) -> None:
        if not self.done:
            self._archive.close()

    def _integrate(self, scan: Scan) -> None:
        try:
            done = self.mapper.integrate(scan)
        except InputError as error:
            raise InputError(f"{self.mapper.robot}: {self._run.logs[self.mapper.robot].path}: {error}") from error
        self._place_m = [round(metres, 3) for metres in scan.T_world_sensor.position.tolist()]
        self._scans += 1
        self._touched += done.cells
        self._dropped.update(scan.dropped)
        self._dropped.update(done.dropped)

    def _due(self, now_ns: int) -> bool:
        fresh = self.mapper.revision - self._committed
        late = fresh > 0 and now_ns - self._commit_ns >= COMMIT_S * SECOND_NS
        return late or fresh >= self._run.settings.commit_scans

    def _commit(self) -> None:
        self.mapper.commit()
        self._committed = self.mapper.revision

    def _tell_coarse(self) -> None:
        if self._coarse is not None and not self._handover.full:
            self._coarse.update()
            if self._coarse.revision > self._coarse_told:
                self._handover.coarse.append(self._coarse.delta(self._coarse_told))
                self._coarse_told = self._coarse.revision

    def _end(self) -> None:
        """All is in: wait until it is on disk, and say so."""
        self._archive.close()
        if self._touched == 0 and self._resumed == 0:
            why = ", ".join(f"{n} {reason}" for reason, n in self._dropped.most_common()) or "the source is empty"
            raise InputError(
                f"{self.mapper.robot}: {self._run.logs[self.mapper.robot].path} puts nothing on the map: "
                f"{self._scans} scans ({why}); check its poses and points"
            )
        self.done = True
        self._handover.committed.set()
