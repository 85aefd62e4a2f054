"""What a mapping run leaves behind: map.db, map.tif, map.png, report.html, report.json."""

from __future__ import annotations

import json
import os
import resource
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from terrafuse import __version__, views
from terrafuse.errors import MissingExtra, OutputError, TerrafuseError
from terrafuse.exchange.delta import map_id
from terrafuse.export.cog import write_cog
from terrafuse.export.files import final
from terrafuse.export.picture import robot_paths, write_picture
from terrafuse.export.report import write_report
from terrafuse.folders import folder_for
from terrafuse.mapping import Plan, Progress, RobotReport, map_logs, open_partial
from terrafuse.replica import Replica
from terrafuse.store.sqlite import SqliteStore, remove_store
from terrafuse.types import Floats

STORE, PARTIAL_STORE = "map.db", "map.partial.db"
FILES = {
    "store": STORE,
    "raster": "map.tif",
    "picture": "map.png",
    "report": "report.html",
    "report_json": "report.json",
}
GLOBAL_FILES = {"global_raster": "global.tif", "global_picture": "global.png"}
"""Beside those, where the settings ask for a coarser global map."""

Stage = Callable[[str], None]
"""Called with a word for what happens next."""


def run(
    plan: Plan, out: Path, *, overwrite: bool = False, progress: Progress | None = None, stage: Stage | None = None
) -> dict[str, Any]:
    """Map the plan's logs and write every result into the folder `out`; returns the report (as in report.json).

    The store grows under the name map.partial.db and becomes map.db when all else is written: a run that was cut short
    leaves a store that opens, and the same run started again goes on from it. Raises OutputError where `out` holds a
    map already, unless `overwrite`; the old map goes when the new one is whole.
    """
    _check_extras()
    if (out / STORE).exists() and not overwrite:
        raise OutputError(
            f"{out / STORE}: there is a map already; choose another --out, or replace it with --overwrite"
        )
    with folder_for(out):
        return _run(plan, out, overwrite, progress, stage)


def _run(plan: Plan, out: Path, overwrite: bool, progress: Progress | None, stage: Stage | None) -> dict[str, Any]:
    for leftover in out.glob(".*.partial*"):
        leftover.unlink()  # of a run that was killed while it wrote
    partial = out / PARTIAL_STORE
    store = open_partial(partial, plan, overwrite)
    try:
        started = time.perf_counter()
        robots = map_logs(plan, store, progress)
        seconds = {"map": time.perf_counter() - started}
        report = _write(plan, store, out, robots, seconds, stage or (lambda _: None))
        store.finish()
    except BaseException:
        _close_partial(store)
        raise
    remove_store(out / STORE)
    os.replace(partial, out / STORE)
    return report


def _write(
    plan: Plan,
    store: SqliteStore,
    out: Path,
    robots: Mapping[str, RobotReport],
    seconds: dict[str, float],
    stage: Stage,
) -> dict[str, Any]:
    replica = Replica(store=store)
    paths = robot_paths(replica)

    def timed(word: str, work: Callable[[], Any]) -> Any:
        stage(word)
        started = time.perf_counter()
        result = work()
        seconds[word] = time.perf_counter() - started
        return result

    timed("raster", lambda: write_cog(replica, out / FILES["raster"]))
    timed("picture", lambda: write_picture(replica, out / FILES["picture"], paths=paths))
    if plan.settings.global_factor > 1:
        coarse = Replica(store=store, factor=plan.settings.global_factor)
        timed("global map", lambda: _write_global(coarse, out, paths))
    report = timed("statistics", lambda: report_of(plan, store, replica, robots, seconds))
    write_report(out / FILES["report"], report, out / FILES["picture"])
    with final(out / FILES["report_json"]) as temporary:
        temporary.write_text(json.dumps(report, indent=1, allow_nan=False) + "\n")
    return dict(report)


def _write_global(replica: Replica, out: Path, paths: Mapping[str, Floats]) -> None:
    write_cog(replica, out / GLOBAL_FILES["global_raster"])
    write_picture(replica, out / GLOBAL_FILES["global_picture"], paths=paths)


def map_facts(replica: Replica) -> dict[str, Any]:
    """What a map is and how large: model, lattice, extent, digest, statistics of the layers. Plain JSON."""
    known, layers = views.statistics(replica)
    window = views.known_window(replica)
    return {
        "map": {
            **asdict(map_id(replica.model.name, replica.lattice)),
            "settings": replica.model.settings(),
            "digest": replica.digest(),
        },
        "cells": known,
        "tiles": len(replica.keys),
        "bounds": list(views.bounds_of(replica, window)) if window else None,
        "layers": {name: asdict(values) for name, values in layers.items()},
    }


def delta_bytes(store: SqliteStore) -> dict[str, int]:
    """Bytes of all deltas of each robot, as they would travel."""
    out = dict.fromkeys(store.robots(), 0)
    for entry in store.history():
        out[entry.robot] += entry.nbytes
    return out


def report_of(
    plan: Plan, store: SqliteStore, replica: Replica, robots: Mapping[str, RobotReport], seconds: dict[str, float]
) -> dict[str, Any]:
    """The report as plain JSON."""
    points = sum(robot.points - robot.resumed_points for robot in robots.values())
    return {
        "terrafuse": __version__,
        **map_facts(replica),
        "robots": {name: _robot(robot, name, store) for name, robot in robots.items()},
        "delta_bytes_per_robot": delta_bytes(store),
        "points_per_second": points / seconds["map"],
        "allocated_bytes": sum(robot.most_tile_bytes for robot in robots.values()),
        "resident_bytes": peak_resident_bytes(),
        "seconds": seconds,
        "settings": plan.settings.model_dump(mode="json"),
        **_global_facts(plan, store),
    }


def _global_facts(plan: Plan, store: SqliteStore) -> dict[str, Any]:
    """The files of the run, and what the coarser global map is, if there is one."""
    factor = plan.settings.global_factor
    if factor == 1:
        return {"files": FILES}
    facts = map_facts(Replica(store=store, factor=factor))
    return {"files": FILES | GLOBAL_FILES, "global": {"factor": factor, **facts}}


def _robot(robot: RobotReport, name: str, store: SqliteStore) -> dict[str, Any]:
    fresh = robot.scans - robot.resumed_scans
    return {
        **vars(robot),
        "skipped": dict(robot.skipped),
        "dropped": dict(robot.dropped),
        "scans_per_second": fresh / robot.wall_seconds,
        "points_per_second": (robot.points - robot.resumed_points) / robot.wall_seconds,
        "deltas": sum(entry.robot == name for entry in store.history()),
    }


def peak_resident_bytes() -> int:
    """The most memory that this process held, in bytes (getrusage counts kilobytes, on macOS bytes)."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


def _check_extras() -> None:
    """Say at the start, not after an hour, that the raster or the picture can't be written."""
    for module, extra in (("rasterio", "gis"), ("matplotlib", "plot")):
        try:
            __import__(module)
        except ImportError as error:
            raise MissingExtra("terrafuse map", module, extra) from error


def _close_partial(store: SqliteStore) -> None:
    """After a fault: keep what was mapped, leave nothing where nothing was."""
    try:
        empty = not store.keys()
    except TerrafuseError:
        empty = False
    store.close()
    if empty:
        remove_store(store.file)
