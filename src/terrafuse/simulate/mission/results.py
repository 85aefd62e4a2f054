"""What a mission leaves behind: its maps, pictures, a film, report.html and report.json.

report.json is the same in every byte for one scenario and seed, whatever the threads and the day, but for what is under
"timings": times of clocks, and memory.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from terrafuse import __version__
from terrafuse.errors import MissingExtra, OutputError
from terrafuse.export.cog import write_cog
from terrafuse.export.files import final
from terrafuse.folders import folder_for
from terrafuse.replica import Replica
from terrafuse.results import STORE, Stage, map_facts, peak_resident_bytes
from terrafuse.simulate.mission.engine import Mission, Watcher, lattice_of, model_of
from terrafuse.simulate.mission.exchange import STATION, counts_of
from terrafuse.simulate.mission.film import Film
from terrafuse.simulate.mission.guarded import Guarded
from terrafuse.simulate.mission.measures import measures, truth_under, without_prior
from terrafuse.simulate.mission.parts import check_parts
from terrafuse.simulate.mission.pictures import Tracks, write_pictures
from terrafuse.simulate.mission.prior import FILE as PRIOR_FILE
from terrafuse.simulate.mission.recording import check_can_record, write_sensors
from terrafuse.simulate.mission.report import stage_table, write_html
from terrafuse.simulate.mission.studies import NEEDS, STUDIES, Needs
from terrafuse.simulate.mission.timeline import Timeline
from terrafuse.simulate.scenario import Loaded
from terrafuse.simulate.world import digest
from terrafuse.store.sqlite import SqliteStore, remove_store

RASTER, FILM, PAGE, REPORT = "map.tif", "film.gif", "report.html", "report.json"
TIMINGS = "timings"
WORKSHOP = ".simulate-"
MOST_CELLS = 2**28
"""Of the map, in the whole world: studies and measures look at all that is known at once."""

Progress = Callable[[Mission, float], None]
"""Called after each tick, with the share of the streets, or of free ground, that the station has mapped."""
Made = TypeVar("Made")


class Clock:
    """Seconds of each stage of a run, which it announces."""

    def __init__(self, stage: Stage | None) -> None:
        self.seconds: dict[str, float] = {}
        self._stage = stage

    def __call__(self, word: str, work: Callable[[], Made]) -> Made:
        if self._stage is not None:
            self._stage(word)
        started = time.perf_counter()
        made = work()
        self.seconds[word] = time.perf_counter() - started
        return made


def run(
    loaded: Loaded,
    out: Path,
    *,
    record: bool = False,
    threads: int = 1,
    overwrite: bool = False,
    progress: Progress | None = None,
    stage: Stage | None = None,
) -> dict[str, Any]:
    """Simulate a scenario and write all that comes of it into the folder `out`; returns the report (as in report.json).

    With `record`, each robot's log as well, NAME.mcap, and its sensor, NAME.sensor.yaml. All is written into a folder
    of its own in `out` first: a run that fails or is interrupted leaves nothing, and what an earlier one wrote goes
    when the new files are whole. Raises OutputError where `out` holds a map already, unless `overwrite`; InputError for
    what is wrong with the scenario, with the line.
    """
    _check_extras()
    if (out / STORE).exists() and not overwrite:
        raise OutputError(
            f"{out / STORE}: there is a map already; choose another --out, or replace it with --overwrite"
        )
    check_study(loaded)
    if record:
        check_can_record(loaded)
    check_parts(loaded)
    clock = Clock(stage)
    clock("world", lambda: check_size(loaded))
    with folder_for(out), _workshop(out) as work:
        store = SqliteStore.create(work / STORE, lattice_of(loaded), model_of(loaded))
        try:
            mission = clock("robots", lambda: Mission(loaded, store, work, record))
            left = _Left(mission)
            clock("simulate", lambda: left.run(threads, progress))
            report = _write(mission, left, work, record, clock)
            store.finish()
        except BaseException:
            store.close()
            raise
        _hand_over(work, out)
    return report


def check_study(loaded: Loaded) -> None:
    """Raise InputError for a study that there is none of, or that can't be made of such a map or world."""
    study, needs = loaded.scenario.study, NEEDS.get(loaded.scenario.study, Needs())
    if study not in STUDIES:
        raise loaded.error(("study",), f"study '{study}'; there are {', '.join(STUDIES)}")
    given = (("model", loaded.scenario.map.model, needs.models), ("world", loaded.scenario.world.kind, needs.worlds))
    for what, name, needed in given:
        if needed and name not in needed:
            raise loaded.error(
                ("study",), f"study '{study}' needs the {what} {' or '.join(needed)}, not {name}; give study: map"
            )


def check_size(loaded: Loaded) -> None:
    """Make the world. Raise InputError for more cells in it than a computer can look at."""
    west, south, east, north = loaded.world.bounds
    cells = (east - west) * (north - south) / loaded.scenario.map.resolution_m**2
    if cells > MOST_CELLS:
        least_m = loaded.scenario.map.resolution_m * math.sqrt(cells / MOST_CELLS)
        raise loaded.error(
            ("map", "resolution_m"),
            f"{cells:.2g} cells in a world of {east - west:.0f} × {north - south:.0f} m; give {least_m:.1g} m or more, "
            "or a smaller world",
        )


class _Left:
    """A mission and those who watch it."""

    def __init__(self, mission: Mission) -> None:
        self.mission = mission
        self.film, self.tracks, self.timeline = Film(mission), Tracks(mission), Timeline(mission)
        self.study = Guarded(STUDIES[mission.scenario.study](mission, self.timeline))

    def run(self, threads: int, progress: Progress | None) -> None:
        watchers: list[Watcher] = [self.film, self.tracks, self.timeline, *self.study.watchers]
        if progress is not None:
            watchers.append(lambda mission: progress(mission, self.film.share))
        self.mission.run(watchers, threads)
        self.film.end(self.mission)


def _write(mission: Mission, left: _Left, out: Path, record: bool, clock: Clock) -> dict[str, Any]:
    fused = Replica(store=mission.store)
    pictures = clock("pictures", lambda: write_pictures(mission, left.tracks.paths, out))
    clock("film", lambda: left.film.write(out / FILM))
    files = {"report": PAGE, "report_json": REPORT, "film": FILM, **pictures, "store": STORE}
    if "map" in pictures:
        clock("raster", lambda: write_cog(fused, out / RASTER))
        files["raster"] = RASTER
    files |= left.study.pictures(out)
    if mission.prior is not None:
        files["prior"] = PRIOR_FILE
    if record:
        files |= write_sensors(mission, out)
    report = clock("measures", lambda: _facts(mission, fused, left)) | {"files": files}
    report |= {TIMINGS: _timings(mission, left.study, clock.seconds), "study_failure": left.study.failure}
    report["tables"] += left.study.excuses()
    write_html(out / PAGE, report, out)
    with final(out / REPORT) as temporary:
        temporary.write_text(json.dumps(report, indent=1, allow_nan=False) + "\n")
    return report


def _facts(mission: Mission, fused: Replica, left: _Left) -> dict[str, Any]:
    """All that is the same for the same seed."""
    station = mission.station.replica
    replicas = {v.name: v.node.replica for v in mission.vehicles if v.node.replica is not None}
    digests = {name: replica.digest() for name, replica in ({STATION: station} | replicas).items()}
    return {
        "terrafuse": __version__,
        "scenario": {"name": mission.loaded.name, **mission.scenario.model_dump(mode="json")},
        "seed": mission.scenario.seed,
        "simulated_s": round(mission.now_s, 6),
        "world": {
            "digest": digest(mission.world),
            "bounds": [*mission.world.bounds],
            "houses": len(mission.world.houses),
        },
        **map_facts(fused),
        "global": {"factor": mission.scenario.map.global_factor, **map_facts(station), "digests": digests},
        "mapped_share": left.film.share,
        "robots": {vehicle.name: vehicle.facts() for vehicle in mission.vehicles},
        "station": mission.station.facts(),
        "radio": counts_of(mission.radio),
        "measures": {
            name: measures(seen, truth_under(mission.world, seen))
            for name, seen in (("map", without_prior(fused)), ("global", without_prior(station)))
        },
        "timeline": left.timeline.rows,
        "tables": left.study.tables(),
    }


def _timings(mission: Mission, study: Guarded, stages: dict[str, float]) -> dict[str, Any]:
    return {
        "stages_s": stages,
        "times_real_time": mission.now_s / stages["simulate"],
        "robots_s": {v.name: {**v.seconds, **v.mapper.seconds, **v.node.seconds} for v in mission.vehicles},
        "station_s": mission.station.seconds,
        "resident_bytes": peak_resident_bytes(),
        "tables": [*study.timed_tables(), stage_table(mission).as_json()],
    }


@contextmanager
def _workshop(out: Path) -> Iterator[Path]:
    """A folder in `out` that is gone when the block ends."""
    for leftover in out.glob(f"{WORKSHOP}*"):
        shutil.rmtree(leftover, ignore_errors=True)  # of a run that was killed
    work = Path(tempfile.mkdtemp(prefix=WORKSHOP, dir=out))
    try:
        yield work
    finally:
        shutil.rmtree(work, ignore_errors=True)


def _hand_over(work: Path, out: Path) -> None:
    """Put what was made in the place of what an earlier run left, all of it. Raises OutputError."""
    earlier, made = _files_of(out / REPORT), sorted(file.name for file in work.iterdir())
    try:
        remove_store(out / STORE)
        for name in made:
            os.replace(work / name, out / name)
        for name in earlier.difference(made):
            (out / name).unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(
            f"{out}: can't be written ({error.strerror}: {error.filename}); choose another --out"
        ) from error


def _files_of(report: Path) -> set[str]:
    """The files that a report lists, of those in its own folder."""
    try:
        files = json.loads(report.read_text(encoding="utf-8"))["files"]
        return {file for file in files.values() if Path(file).name == file}
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return set()  # there is none, or it is not ours


def _check_extras() -> None:
    """Say at the start, not after an hour, what can't be simulated or written."""
    for module, extra in (("embreex", "sim"), ("rasterio", "gis"), ("matplotlib", "plot"), ("PIL", "plot")):
        try:
            __import__(module)
        except ImportError as error:
            raise MissingExtra("terrafuse simulate", module, extra) from error
