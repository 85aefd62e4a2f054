"""Ranges and poses as a table: what a ring of sonars heard, where the robot was, a scan a line.

    stamp_s,x_m,y_m,yaw_rad,r0_m,r1_m,…
    12.25,1.5,-0.5,1.5708,0.84,inf,…

Columns in any order, each with its unit; others are not looked at. The pose is the base's, in the plane; yaw is
anticlockwise from the x axis. Where the beams look the table does not say: that is the description's part.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from terrafuse.errors import LogError
from terrafuse.logs.base import Log, Reader, Record, Source
from terrafuse.logs.options import listed
from terrafuse.logs.stamps import seconds_to_ns
from terrafuse.types import Pose, Readings, Scan, Stamp

LENGTHS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}
ANGLES = {"rad": 1.0, "deg": math.pi / 180}
STAMPS: dict[str, Callable[[str], Stamp]] = {"s": seconds_to_ns, "ns": int}
"""From text, so that they lose no digit."""
POSE = {"x": LENGTHS, "y": LENGTHS, "yaw": ANGLES}


@dataclass(frozen=True)
class Column:
    """Where it stands in a line, and what its numbers count."""

    at: int
    name: str
    unit: str


@dataclass(frozen=True)
class Layout:
    header_line: int
    delimiter: str
    width: int
    stamp: Column
    pose: tuple[Column, ...]
    ranges: tuple[Column, ...]


def matches(path: Path) -> bool:
    """A .csv whose header names a stamp, a yaw and a first range, with a unit or without."""
    if not (path.is_file() and path.suffix.lower() == ".csv"):
        return False
    found = _header(path)
    return found is not None and {"stamp", "yaw", "r0"} <= {_split(name)[0] for name in found[2]}


def open_ranges(source: Source) -> Log:
    layout = layout_of(source.path)
    if not source.aimed:
        raise LogError(
            f"{source.path}: {len(layout.ranges)} ranges a line, and nothing says where they look: describe the "
            "sensor with its 'ring' or 'beams': --sensor FILE, or a preset such as --sensor nomad_200_sonar"
        )
    total = sum(1 for _ in _lines(source.path, layout))
    return Log(source.path, READER.name, scans=lambda: _read(source.path, layout), count=total)


def layout_of(path: Path) -> Layout:
    """Which column is what. Raises LogError naming the line and what it lacks."""
    found = _header(path)
    if found is None:
        raise LogError(f"{path}: holds no line; give a header and a line a scan, as in docs/sensors.md")
    line, delimiter, names = found
    where = f"{path}:{line}"
    stamp = _column("stamp", STAMPS, names, where)
    pose = tuple(_column(name, units, names, where) for name, units in POSE.items())
    return Layout(line, delimiter, len(names), stamp, pose, _ranges(names, where))


def _ranges(names: Sequence[str], where: str) -> tuple[Column, ...]:
    """r0, r1, … without a gap."""
    numbers = {int(base[1:]) for base, _ in map(_split, names) if base[:1] == "r" and base[1:].isdecimal()}
    return tuple(_column(f"r{number}", LENGTHS, names, where) for number in range(max(numbers, default=0) + 1))


def _column(base: str, units: Collection[str], names: Sequence[str], where: str) -> Column:
    found = [(at, name) for at, name in enumerate(names) if _split(name)[0] == base]
    wanted = " or ".join(f"{base}_{unit}" for unit in units)
    if not found:
        raise LogError(f"{where}: no column {wanted}; it has {listed(names)}")
    if len(found) > 1:
        raise LogError(f"{where}: columns {listed(name for _, name in found)} are one and the same; keep one")
    at, name = found[0]
    unit = _split(name)[1]
    if unit not in units:
        raise LogError(f"{where}: column '{name}' has {f'a unit {unit}' if unit else 'no unit'}; name it {wanted}")
    return Column(at, name, unit)


def _split(name: str) -> tuple[str, str]:
    """r12_mm → r12, mm."""
    base, _, unit = name.partition("_")
    return base, unit


def _header(path: Path) -> tuple[int, str, list[str]] | None:
    """Line, delimiter and names of the first line that is neither empty nor a comment."""
    with path.open(encoding="utf-8-sig", errors="replace") as lines:
        for number, line in enumerate(lines, 1):
            text = line.partition("#")[0].strip()
            if text:
                delimiter = next((mark for mark in ",;\t" if mark in text), ",")
                return number, delimiter, [name.strip().strip("\"'").lower() for name in text.split(delimiter)]
    return None


def _lines(path: Path, layout: Layout) -> Iterator[tuple[str, list[str]]]:
    """file:line and the words of each line after the header."""
    with path.open(encoding="utf-8-sig", errors="replace") as lines:
        for number, line in enumerate(lines, 1):
            text = line.partition("#")[0]
            if number > layout.header_line and text.strip():
                yield f"{path}:{number}", [word.strip() for word in text.split(layout.delimiter)]


def _read(path: Path, layout: Layout) -> Iterator[Record]:
    for place, words in _lines(path, layout):
        if len(words) != layout.width:
            raise LogError(f"{place}: {len(words)} values, the header has {layout.width}; repair or remove the line")
        ranges_m = np.array([_range_m(words, column, place) for column in layout.ranges])
        readings = Readings(ranges_m, np.ones(len(ranges_m), bool))
        yield Scan(
            _stamp(words, layout.stamp, place), np.empty((0, 3)), _pose(words, layout.pose, place), readings=readings
        )


def _stamp(words: Sequence[str], column: Column, place: str) -> Stamp:
    try:
        return STAMPS[column.unit](words[column.at])
    except ValueError as error:
        raise LogError(f"{place}: {column.name}: {error}") from None


def _pose(words: Sequence[str], columns: Sequence[Column], place: str) -> Pose:
    x, y, yaw = (_number(words, column, POSE[base], place) for column, base in zip(columns, POSE, strict=True))
    if not all(map(math.isfinite, (x, y, yaw))):
        given = listed(f"{column.name} {words[column.at]}" for column in columns)
        raise LogError(f"{place}: the pose {given} is not finite; repair or remove the line")
    return Pose.from_quaternion((x, y, 0.0), (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)))


def _range_m(words: Sequence[str], column: Column, place: str) -> float:
    """Nothing at all is no reading, like nan."""
    return _number(words, column, LENGTHS, place) if words[column.at] else math.nan


def _number(words: Sequence[str], column: Column, units: Mapping[str, float], place: str) -> float:
    try:
        return float(words[column.at]) * units[column.unit]
    except ValueError:
        raise LogError(f"{place}: {column.name} is '{words[column.at]}', no number") from None


READER = Reader(
    name="ranges",
    summary=".csv of a sonar ring's ranges and the robot's poses: stamp_s,x_m,y_m,yaw_rad,r0_m,r1_m,…",
    matches=matches,
    open=open_ranges,
)
