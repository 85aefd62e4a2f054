"""Logs in, one store out: what `terrafuse map` does before it exports.

One robot a thread; each integrates its scans, pages through a write-behind archive and commits whole deltas, so that a
run that is killed goes on where its last commit ended and comes to the same bytes.
"""

from __future__ import annotations

import hashlib
import math
import os
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from terrafuse import crs, plugins
from terrafuse.config import MapSettings
from terrafuse.errors import InputError, StoreMismatch
from terrafuse.exchange.corrections import Corrections, corrected
from terrafuse.lattice import MAX_TILE_CELLS, Lattice, default_tile_m
from terrafuse.logs import open_log
from terrafuse.logs.base import Log, Record, Source, parse_source
from terrafuse.mapper import Mapper
from terrafuse.models import make_model
from terrafuse.models.base import Model
from terrafuse.prior import ROBOT, Prior, check_model, open_prior
from terrafuse.sense import Sensor, applied, check_aim, load_sensor, undescribed
from terrafuse.sense.describe import content
from terrafuse.store.behind import WriteBehind
from terrafuse.store.sqlite import SqliteStore, remove_store, removed_if_empty
from terrafuse.types import Scan
from terrafuse.window import make_window

Progress = Callable[[str, int, int | None, int], None]
"""Called for each record: robot, records so far, records in all where known, points so far; of a prior map the records
are tiles, the points cells."""


@dataclass
class RobotReport:
    """What became of one robot's log."""

    log: str
    reader: str
    sensor: str | None = None
    """The name in its description, where it was described."""
    scans: int = 0
    resumed_scans: int = 0
    """Of these, taken over from a run that was cut short."""
    skipped: Counter[str] = field(default_factory=Counter)
    points: int = 0
    resumed_points: int = 0
    """Of these, in scans that were taken over; `dropped` and the seconds do not count those."""
    dropped: Counter[str] = field(default_factory=Counter)
    seconds: dict[str, float] = field(default_factory=dict)
    wall_seconds: float = 0.0
    distance_m: float = 0.0
    loads: int = 0
    evictions: int = 0
    writes: int = 0
    commits: int = 0
    most_resident: int = 0
    most_tile_bytes: int = 0
    allocation: dict[str, float] = field(default_factory=dict)
    """See `Allocation`; the window's claims are this run's, without scans that were taken over."""
    touched_cells: int = 0
    """Cells that each scan touched, added up over the scans."""


@dataclass(frozen=True)
class Plan:
    """A checked mapping run: nothing has been written yet."""

    logs: Mapping[str, Log]
    options: Mapping[str, Mapping[str, str]]
    """How each log is read: what followed the `?`."""
    settings: MapSettings
    lattice: Lattice
    model: Model
    sensors: Mapping[str, Sensor] = field(default_factory=dict)
    """Of the robots whose sensor is described."""
    prior: Prior | None = None

    @property
    def fingerprint(self) -> dict[str, Any]:
        """What must be equal for an unfinished run to go on: all that decides what a scan's revision holds."""
        return {
            "settings": self.settings.model_dump(
                mode="json", exclude={"commit_scans", "window", "sensors", "global_factor"}
            ),
            "sensors": {name: content(sensor) for name, sensor in self.sensors.items()},
            "model": self.model.settings(),
            "plugins": plugins.fingerprints(),
            "prior": [_content(path) for path in self.prior.paths] if self.prior else [],
            "logs": {name: [self._read_as(name), _content(log.path)] for name, log in self.logs.items()},
        }

    def _read_as(self, name: str) -> list[Any]:
        """The options, and what is in files that they name; `backwards=drop` is how a run goes on that stopped."""
        out: list[Any] = []
        for key, value in sorted(self.options[name].items()):
            if key != "backwards":
                files = [path for path in (Path(value), self.logs[name].path / value) if path.is_file()]
                out.append([key, value, *(_content(path) for path in files[:1])])
        return out


def plan(sources: Mapping[str, str], settings: MapSettings) -> Plan:
    """Open the logs of each robot and check everything that can be checked. Raises InputError and its kin."""
    if not sources:
        raise InputError("no logs: give at least one NAME=LOG")
    lattice = Lattice(settings.resolution_m, settings.tile_m or tile_for(settings.resolution_m, settings.global_factor))
    lattice.coarser(settings.global_factor)
    model = make_model(settings.model, settings.model_settings)
    make_window(settings.window, lattice)
    sensors = _sensors(settings.sensors)
    parsed = {name: _source(text, sensors.get(name)) for name, text in sources.items()}
    logs = {name: open_log(source) for name, source in parsed.items()}
    _check_frames(logs, settings)
    for name, sensor in sensors.items():
        _check_sensor(name, logs[name], sensor)
    prior = _prior(settings.prior, model, logs)
    stated = {f"{name} ({log.path})": log.crs for name, log in logs.items()}
    options = {name: source.options for name, source in parsed.items()}
    lattice = replace(lattice, crs=crs.common(settings.crs, stated))
    if prior is not None:
        prior.placed(lattice, _beginnings(logs, settings))  # before anything is written
    return Plan(logs, options, settings, lattice, model, sensors, prior)


LEAST_TILE_M = 4.0
"""Smaller tiles than that are more work than map: of cells that need them, the user had better think again."""


def tile_for(resolution_m: float, factor: int = 1) -> float:
    """Side of a tile that cells of this side, and cells `factor` times as wide, fit into.

    It is the usual one where these do, else the nearest to it whose number of cells ends in 0. Where there is none of a
    sensible size it is the usual one, too, and `Lattice` says why it can't be.
    """
    usual_m = default_tile_m(resolution_m)
    exact = usual_m / resolution_m
    whole = abs(exact - round(exact)) <= 1e-6
    if not math.isfinite(exact) or (whole and round(exact) % factor == 0 and exact <= MAX_TILE_CELLS):
        return usual_m
    step = math.lcm(10, factor)
    cells = min(max(1, round(exact / step)), MAX_TILE_CELLS // step) * step
    tile_m = round(cells * resolution_m, 9)
    return tile_m if tile_m >= LEAST_TILE_M else usual_m


def _sensors(described: Mapping[str, str]) -> dict[str, Sensor]:
    loaded = {text: load_sensor(text) for text in set(described.values())}
    return {name: loaded[text] for name, text in sorted(described.items())}


def _source(text: str, sensor: Sensor | None) -> Source:
    return parse_source(text, aimed=sensor is not None and sensor.beams is not None)


def _check_sensor(name: str, log: Log, sensor: Sensor) -> None:
    """That the log can be of such a sensor, as far as its first scan tells."""
    if log.georeferenced:
        raise InputError(
            f"{name}: {log.path} holds points in the map's frame, not a sensor's readings; "
            "say whose sensor is described: --sensor NAME=…"
        )
    first = None if sensor.beams is None else next((r for r in log.scans() if isinstance(r, Scan)), None)
    if first is not None and first.readings is not None:
        with _of_log(name, log):
            check_aim(sensor, first.readings)


@contextmanager
def _of_log(name: str, log: Log) -> Iterator[None]:
    """What is wrong between a description and a scan is said of the log."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{name}: {log.path}: {error}") from error


def _prior(texts: Sequence[str], model: Model, logs: Mapping[str, Log]) -> Prior | None:
    if not texts:
        return None
    if ROBOT in logs:
        raise InputError(f"a robot named '{ROBOT}' and a prior map, whose contribution has that name; rename the robot")
    check_model(model)
    return open_prior(texts)


def _beginnings(logs: Mapping[str, Log], settings: MapSettings) -> dict[str, tuple[float, float]]:
    """(east, north) of each log's first scan, of those that have one."""
    firsts = {name: next((r for r in log.scans() if isinstance(r, Scan)), None) for name, log in logs.items()}
    return {
        name: _place(placed(scan, logs[name], settings), logs[name].georeferenced)
        for name, scan in firsts.items()
        if scan is not None
    }


def _place(scan: Scan, georeferenced: bool) -> tuple[float, float]:
    """Of its sensor, or of a point where the sensor's place is not known."""
    points = scan.points[:, :3]
    seen = points[np.isfinite(points).all(axis=1)]
    point = seen[0] if georeferenced and len(seen) else np.zeros(3)
    east_m, north_m, _ = (scan.T_world_sensor.matrix[:3, :3] @ point + scan.T_world_sensor.position).tolist()
    return east_m, north_m


def _check_frames(logs: Mapping[str, Log], settings: MapSettings) -> None:
    """Logs in local frames meet logs in map coordinates only through an origin."""
    placed = [name for name, log in logs.items() if log.georeferenced]
    local = [name for name, log in logs.items() if not log.georeferenced]
    if placed and local and settings.origin_m is None:
        raise InputError(
            f"{', '.join(local)}: in a frame of their own, while {', '.join(placed)} are georeferenced; "
            "say where the local origin lies: --origin EAST,NORTH"
        )


AFRESH = "start afresh with --overwrite, or choose another --out"


def open_partial(path: Path, run: Plan, overwrite: bool = False, afresh: str = AFRESH) -> SqliteStore:
    """The store of this run: new, or that of the same run cut short.

    Raises StoreMismatch for another's, unless it may be overwritten or is empty; `afresh` is how to begin anew.
    """
    if not path.exists():
        return SqliteStore.create(path, run.lattice, run.model, {"run": run.fingerprint})
    store = SqliteStore.open(path)
    held = store.notes().get("run")
    if held != run.fingerprint:
        if removed_if_empty(store):
            return open_partial(path, run)
        if overwrite:
            remove_store(path)
            return open_partial(path, run)
        raise StoreMismatch(
            f"{path}: of a run with other logs or settings, or other plug-ins; run that again to go on with it, "
            f"or {afresh}"
        )
    return store


def map_logs(run: Plan, store: SqliteStore, progress: Progress | None = None) -> dict[str, RobotReport]:
    """Map every log of the plan into the store, one robot a thread. Returns a report for each robot.

    A fault in one log stops all; what was committed until then stays in the store.
    """
    if run.prior is not None:
        tell = None if progress is None else partial(progress, ROBOT)
        for delta in run.prior.deltas(run.lattice, run.model, tell):
            store.accept(delta)
    stop = threading.Event()
    reports: dict[str, RobotReport] = {}
    with ThreadPoolExecutor(max_workers=len(run.logs), thread_name_prefix="robot") as pool:
        jobs = {pool.submit(_map_robot, name, run, store, progress, stop): name for name in run.logs}
        try:
            for job in as_completed(jobs):
                reports[jobs[job]] = job.result()
        finally:
            stop.set()
    _check_something_seen(run, reports)
    return {name: reports[name] for name in run.logs}


def _map_robot(
    name: str, run: Plan, store: SqliteStore, progress: Progress | None, stop: threading.Event
) -> RobotReport:
    archive = WriteBehind(store)
    started = time.perf_counter()
    try:
        mapper = Mapper(name, run.lattice, run.model, make_window(run.settings.window, run.lattice), archive)
        report = RobotReport(str(run.logs[name].path), run.logs[name].reader, resumed_scans=mapper.revision)
        _integrate_all(mapper, run, report, progress, stop)
        mapper.commit()
    finally:
        archive.close()
    report.wall_seconds = time.perf_counter() - started
    _tell_paging(report, mapper)
    report.seconds |= mapper.seconds
    return report


def _tell_paging(report: RobotReport, mapper: Mapper) -> None:
    paging, allocation = mapper.paging, mapper.allocation()
    report.loads, report.evictions = paging.loads, paging.evictions
    report.writes, report.commits = paging.writes, paging.commits
    report.most_resident, report.most_tile_bytes = paging.most_resident, paging.most_bytes
    report.allocation = allocation.as_json()


def _integrate_all(
    mapper: Mapper, run: Plan, report: RobotReport, progress: Progress | None, stop: threading.Event
) -> None:
    log, sensor = run.logs[mapper.robot], run.sensors.get(mapper.robot)
    report.sensor = sensor.name if sensor else None
    clock = report.seconds
    clock["read"] = clock["commit"] = 0.0
    position: np.ndarray[Any, Any] | None = None
    for count, record in enumerate(_timed(log.scans(), clock), start=1):
        if stop.is_set():
            return
        if isinstance(record, Scan):
            scan = prepared(run, mapper.robot, record)
            points = len(record.points) or len(scan.points)  # a log of bare ranges has none before they are aimed
            here = scan.T_world_sensor.position
            report.distance_m += float(np.linalg.norm(here - position)) if position is not None else 0.0
            position = here
            report.scans += 1
            report.points += points
            if report.scans <= report.resumed_scans:
                report.resumed_points += points
            else:
                done = mapper.integrate(scan)
                report.touched_cells += done.cells
                report.dropped.update(scan.dropped)
                report.dropped.update(done.dropped)
                if done.revision % run.settings.commit_scans == 0:
                    t0 = time.perf_counter()
                    mapper.commit()
                    clock["commit"] += time.perf_counter() - t0
        else:
            report.skipped[record.reason] += 1
        if progress is not None:
            progress(mapper.robot, count, log.count, report.points)


def _timed(records: Iterator[Record], clock: dict[str, float]) -> Iterator[Record]:
    """Pass records on, adding up the time that reading them takes."""
    while True:
        t0 = time.perf_counter()
        record = next(records, None)
        clock["read"] += time.perf_counter() - t0
        if record is None:
            return
        yield record


def prepared(run: Plan, robot: str, scan: Scan, corrections: Corrections = ()) -> Scan:
    """A scan of the robot's log as its mapper takes it: in the map's frame, its pose corrected, read as its sensor is
    described."""
    log, sensor = run.logs[robot], run.sensors.get(robot)
    there = corrected(placed(scan, log, run.settings), corrections)
    with _of_log(robot, log):
        return applied(sensor, there) if sensor else undescribed(there)


def placed(scan: Scan, log: Log, settings: MapSettings) -> Scan:
    """The scan in the map's frame."""
    if log.georeferenced or settings.origin_m is None:
        return scan
    return replace(scan, T_world_sensor=scan.T_world_sensor.shifted(*settings.origin_m))


def _check_something_seen(run: Plan, reports: Mapping[str, RobotReport]) -> None:
    for name, report in reports.items():
        if report.touched_cells == 0 and report.resumed_scans == 0:
            why = ", ".join(f"{n} {reason}" for reason, n in (report.skipped + report.dropped).most_common())
            raise InputError(
                f"{name}: {report.log} puts nothing on the map: {report.scans} scans placed, "
                f"{report.points} points ({why or 'the log is empty'}); check its poses and points"
            )


WHOLE_BYTES = 1 << 20
EDGE_BYTES = 1 << 16


def _content(path: Path) -> Any:
    """Enough of a log to notice another one: sizes, all of small files (poses, …), the edges of large ones."""
    if path.is_dir():
        files = sorted(p for p in path.rglob("*") if p.is_file())
        listing = [(str(p.relative_to(path)), p.stat().st_size) for p in files]
        small = [_content(p) for p in files if p.stat().st_size <= WHOLE_BYTES and p.suffix in TEXT_SUFFIXES]
        return hashlib.sha256(repr((listing, small)).encode()).hexdigest()
    size = path.stat().st_size
    with path.open("rb") as file:
        content = file.read(WHOLE_BYTES if size <= WHOLE_BYTES else EDGE_BYTES)
        if size > WHOLE_BYTES:
            file.seek(-EDGE_BYTES, os.SEEK_END)
            content += file.read()
    return [size, hashlib.sha256(content).hexdigest()]


TEXT_SUFFIXES = {".txt", ".tum", ".csv", ".yaml", ".json"}
