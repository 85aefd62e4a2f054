"""The service that makes a robot's own map (*patrol*: Robot Mapping)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from terrafuse.errors import InputError, OutputError, StoreError
from terrafuse.exchange.coarse import CoarseContribution
from terrafuse.exchange.corrections import Corrections, fingerprint
from terrafuse.mapper import Mapper
from terrafuse.mapping import Plan
from terrafuse.services.book import Book
from terrafuse.services.ports import Handover, ScanPort
from terrafuse.services.rebuild import Bases, Rebuild, once_known
from terrafuse.services.service import SECOND_NS, Contract, Message, Service
from terrafuse.store.base import Store
from terrafuse.store.behind import WriteBehind
from terrafuse.types import Scan
from terrafuse.window import make_window

COMMIT_S = 1.0
"""What is older is on disk, and so can be told: nothing is told that a crash could take back."""
WAIT_S = 0.01
MAPPING = Contract("terrafuse/mapping", 1, frozenset({"commit", "correct"}))


class Mapping(Service):
    """Takes scans from a port into the robot's map, and that to `archive`, from where the exchange has it.

    `beside`: the archive's file, which the corrections that hold are kept beside; where the map is not by those, it is
    made anew (`services.rebuild`), at once. If that fails, the map before stays as it is, `trouble` says why, and it
    waits for other corrections. `begin` is called when the source has to give something again.

    Started afresh, it goes on after the last scan that the archive holds, as `terrafuse map` does. A map that failed in
    the middle of a scan is thrown away.
    """

    contract = MAPPING
    partners = ("source", "exchange")

    def __init__(
        self,
        run: Plan,
        robot: str,
        archive: Store,
        port: ScanPort,
        handover: Handover,
        beside: Path,
        begin: Callable[[], object] = lambda: None,
    ) -> None:
        super().__init__()
        self._run, self._robot, self._port, self._handover, self._begin = run, robot, port, handover, begin
        self._store = archive
        self._beside = beside
        self._bases = Bases(beside.with_suffix(".bases"))
        self._rebuild: Rebuild | None = None
        self._corrections: Corrections = ()
        self._failed: Corrections | None = None
        """Those by which no map could be made; until others hold, nothing is mapped."""
        self._trouble = ""
        self._looked = -1
        self._commit_ns = 0
        self._dropped: Counter[str] = Counter()
        self._touched = 0
        self._scans = 0
        self._place_m: list[float] | None = None
        self._archive: WriteBehind
        self._go_on()
        self._resumed = self.mapper.revision - self._basis.base
        self._look_at_corrections()
        if self._rebuild is None:
            self._ask(self._resumed)

    def post(self, message: Message) -> None:
        """`commit`; `correct`: look at the corrections that hold."""
        if message.kind == "correct":
            self._look_at_corrections()
        elif self._rebuild is None and self._failed is None:
            self._commit()

    def tick(self, now_ns: int) -> float:
        if self._failed is not None:
            return WAIT_S
        if self._rebuild is not None and self._rebuild.left <= 0:
            self._replace(self._rebuild)
        scan = self._port.take()
        if scan is not None:
            self._integrate(scan)
        if self._failed is not None:
            return WAIT_S
        ended = scan is None and self._port.ended
        if ended and self._rebuild is not None:
            self._replace(self._rebuild)
        if self._rebuild is not None:
            return 0.0 if scan is not None else WAIT_S
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
            "scans": mapper.revision - self._basis.base,
            "corrections": len(self._corrections),
            "rebuilding": None if self._rebuild is None else self._rebuild.left,
            "trouble": self._trouble,
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
        if not self.done and self._rebuild is None and self._failed is None:
            self._commit()

    def close(self) -> None:
        if self._rebuild is not None:
            self._rebuild.close()
        elif not self.done and self._failed is None:
            self._archive.close()

    def _go_on(self) -> None:
        """From what the archive holds."""
        run = self._run
        self._archive = WriteBehind(self._store)
        window = make_window(run.settings.window, run.lattice)
        self.mapper = Mapper(self._robot, run.lattice, run.model, window, self._archive)
        self._basis = self._bases.of(self.mapper.revision)
        self._committed = self.mapper.revision
        factor = run.settings.global_factor
        once = once_known(self._store, self._robot, factor) if self._basis.base and factor > 1 else {}
        self._coarse = CoarseContribution(self.mapper, factor, once) if factor > 1 else None
        self._coarse_told = 0

    def _ask(self, after: int, known: int = 0) -> None:
        self._port.ask(after, known, self._corrections)
        self._begin()

    def _look_at_corrections(self) -> None:
        """Make the map anew, if it is not by those that hold."""
        self._looked = self._handover.corrected
        corrections = Book(self._beside.with_suffix(".corrections")).of(self._robot)
        tried = self._failed if self._rebuild is None else self._rebuild.corrections
        by = self._basis.corrections if tried is None else fingerprint(tried)
        self._corrections = corrections
        if fingerprint(corrections) == by:
            if self.done:
                self._handover.committed.set()
            return
        if self._rebuild is not None:
            self._rebuild.close()
        elif not self.done and self._failed is None:
            self._commit()
            self._archive.close()
        self._failed, self._trouble = None, ""
        scans = self._store.revision(self._robot) - self._basis.base
        self._handover.committed.clear()
        self.done = False
        beside = self._beside.with_name(f"{self._beside.stem}.rebuild.db")
        self._rebuild = Rebuild(self._run, self._robot, corrections, scans, beside)
        self._ask(0, scans)

    def _replace(self, rebuild: Rebuild) -> None:
        """What was made anew takes its place; go on from there."""
        rebuild.put_into(self._store, self._bases)
        self.counts["rebuilds"] += 1
        self._rebuild = None
        self._go_on()

    def _give_up(self, corrections: Corrections, by: str, error: InputError) -> None:
        """A scan can't be mapped where these say that it was taken: keep what is on disk until others hold."""
        (self._archive if self._rebuild is None else self._rebuild).close()
        self._rebuild, self._failed = None, corrections
        self.counts["gave_up"] += 1
        self._trouble = (
            f"no map can be made by the corrections {by or 'that are left'} ({error}); the map before is kept: "
            f"take one back (terrafuse correct {self._robot} --id ID)"
        )

    def _integrate(self, scan: Scan) -> None:
        try:
            done = (self._rebuild or self.mapper).integrate(scan)
        except InputError as error:
            some = self._corrections if self._rebuild is None else self._rebuild.corrections
            by = ", ".join(f"'{one.id}'" for one in some if one.from_ns <= scan.stamp_ns < one.until_ns)
            if (by or self._rebuild is not None) and not isinstance(error, OutputError | StoreError):
                self._give_up(some, by, error)
                return
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
        if self._looked == self._handover.corrected:
            self._handover.committed.set()
