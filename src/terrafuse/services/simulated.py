"""Simulated robots as sources: `SCENARIO/ROBOT?robots=3&seed=1&duration_s=60` instead of a log.

`SCENARIO` is a shipped one's name, or a YAML file; without `/ROBOT` it is the robot of the node's own name.

The scenario runs as `terrafuse simulate` runs it, in the process of each robot that senses in it: the same seed makes
the same mission, so robots of several processes meet each other where they are.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from importlib import resources
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from terrafuse.errors import InputError
from terrafuse.logs import READERS
from terrafuse.logs.base import Log, Reader, Record, Source
from terrafuse.query import split_query
from terrafuse.types import Scan

if TYPE_CHECKING:
    from terrafuse.simulate.scenario import Loaded

LIBRARY = "terrafuse.simulate.scenario"
OPTIONS = {
    "robot": "whose scans",
    "robots": "so many robots of the scenario's first kind",
    "seed": "of the world and of all noise",
    "duration_s": "simulated seconds",
}


def source_text(text: str, robot: str) -> str:
    """What `SCENARIO/ROBOT` is as a log; `SCENARIO` alone is that of the robot which asks. Other texts stay.

    A path that exists is no scenario, but for a scenario's YAML file.
    """
    what, options = split_query(text)
    whole, (scenario, _, chosen) = _file_of(what), what.rpartition("/")
    file = whole or (None if Path(what).exists() else _file_of(scenario))
    if file is None:
        return text
    READERS.setdefault(READER.name, READER)
    rest = "".join(f"&{key}={value}" for key, value in options.items())
    return f"{file}?reader={READER.name}&robot={robot if whole else chosen}{rest}"


def _file_of(scenario: str) -> Path | None:
    """Of a shipped scenario's name, or a YAML file."""
    shipped = resources.files(LIBRARY) / "library" / f"{scenario}.yaml"
    candidates = [Path(str(shipped))] if scenario and "/" not in scenario and not Path(scenario).exists() else []
    candidates += [Path(scenario)] if scenario.endswith((".yaml", ".yml")) else []
    return next((path for path in candidates if path.is_file()), None)


def _open(source: Source) -> Log:
    from terrafuse.simulate.mission.starts import names_of
    from terrafuse.simulate.scenario import load_scenario, with_robots
    from terrafuse.simulate.scenario.read import changed

    options = source.options
    loaded = changed(
        load_scenario(source.path), seed=_number(options, "seed"), duration_s=_number(options, "duration_s")
    )
    if (count := _number(options, "robots")) is not None:
        loaded = with_robots(loaded, int(count))
    names = [name for name, _ in names_of(loaded)]
    robot = options.get("robot", "")
    if robot not in names:
        raise InputError(f"{source.path}: no robot '{robot}' in it; there are {', '.join(names)}")
    return Log(source.path, READER.name, partial(_scans, loaded, robot))


def _number(options: Mapping[str, str], key: str) -> float | None:
    given = options.get(key)
    try:
        value = None if given is None else float(given)
    except ValueError:
        raise InputError(f"?{key}={given}: give a number") from None
    return int(value) if value is not None and value.is_integer() else value


def _scans(loaded: Loaded, robot: str) -> Iterator[Record]:
    from terrafuse.simulate.mission.engine import Mission

    with TemporaryDirectory(prefix="terrafuse-") as folder:
        mission = Mission(loaded, folder=Path(folder))
        seen: list[Scan] = []
        for vehicle in mission.vehicles:
            if vehicle.name == robot:
                vehicle.on_scan.append(seen.append)
        for _ in mission.steps():
            yield from seen
            seen.clear()


READER = Reader("scenario", "a robot of a simulated scenario", lambda path: False, _open, OPTIONS)
