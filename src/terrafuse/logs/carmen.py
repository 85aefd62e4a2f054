"""CARMEN logs: FLASER and ROBOTLASER1 lines of 2D scans, each with the laser's own pose.

    FLASER n r1 … rn x y theta odom_x odom_y odom_theta ipc_stamp host logger_stamp
    ROBOTLASER1 type start fov step max_range accuracy remission n r1 … rn m e1 … em
        x y theta odom_x odom_y odom_theta tv rv forward_safety side_safety turn_axis
        ipc_stamp host logger_stamp

The first triple is the laser's pose, the second the robot's: they differ by the mounting offset. The stamp is
IPC's, which is absolute; the logger's counts from the start of the log.
"""

from __future__ import annotations

import bz2
import gzip
import math
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import IO

import numpy as np

from terrafuse.errors import LogError, PoseError
from terrafuse.logs.base import Log, Reader, Record, Source
from terrafuse.logs.options import NS, choice, listed, positive
from terrafuse.logs.stamps import seconds_to_ns
from terrafuse.types import Floats, NoReturns, Pose, Readings, Scan, Stamp

SUFFIXES = (".log", ".clf", ".log.gz", ".clf.gz", ".log.bz2", ".clf.bz2")
KEYWORDS = ("FLASER", "ROBOTLASER1", "ODOM", "PARAM", "RAWLASER1", "# CARMEN", "# message")
MESSAGES = ("FLASER", "ROBOTLASER1")

MAX_RANGE_M = 50.0
"""From here on readings say "no return" in the public logs: 50, 51.1x, 81.83, 81.91. Echoes stay below."""

BEAM_STEP_DEG = {180: 1.0, 181: 1.0, 360: 0.5, 361: 0.5}
"""FLASER does not state its angles. SICK's start at -90°, right; 180 and 360 beams lack the one at +90°."""


@dataclass(frozen=True)
class Line:
    """One scan line; `place` is file:line."""

    place: str
    words: list[str]

    @property
    def message(self) -> str:
        return self.words[0]


@dataclass(frozen=True)
class Beams:
    """What a scan line says of its beams. `angles_rad`: (N,), None where nothing tells them; `stated`: whether the line
    or the user does, instead of the table of usual lasers."""

    ranges_m: Floats
    angles_rad: Floats | None
    stated: bool
    max_range_m: float

    @property
    def directions(self) -> Floats | None:
        if self.angles_rad is None:
            return None
        return np.stack([np.cos(self.angles_rad), np.sin(self.angles_rad), np.zeros(len(self.angles_rad))], axis=1)


def matches(path: Path) -> bool:
    if not (path.is_file() and path.name.lower().endswith(SUFFIXES)):
        return False
    try:
        with _open_text(path) as lines:
            return any(line.startswith(KEYWORDS) for line in islice(lines, 500))
    except OSError:  # not the compression that the name says
        return False
    except (EOFError, zlib.error):  # it is, but damaged: to be said when it is opened
        return True


def open_carmen(source: Source) -> Log:
    limit_m = positive(source, "max_range_m", MAX_RANGE_M)
    fov_rad = _fov(source)
    index = _index(source.path)
    message = _message(source, {name for name, _ in index})
    stamps = _stamps(source, [end for name, end in index if name == message])

    def scans() -> Iterator[Record]:
        for stamp_ns, line in zip(stamps, _lines(source.path, message), strict=True):
            yield read_scan(line, stamp_ns, limit_m, fov_rad, source.aimed)

    return Log(source.path, READER.name, scans=scans, count=len(stamps))


def read_scan(line: Line, stamp_ns: Stamp, limit_m: float, fov_rad: float | None, aimed: bool) -> Scan:
    """The scan of one line: points at z = 0 in the laser's frame, x forward, y left.

    Readings that are 0, NaN, or at least `limit_m` or the line's own maximum are `no_returns`. They say nothing by
    themselves: in the public logs they come from glass and dark surfaces as well as from empty space. A line whose
    angles nothing tells has readings only, if it is `aimed` by others.
    """
    try:
        beams, pose = _fields(line, fov_rad, aimed)
    except (ValueError, IndexError) as error:
        raise LogError(f"{line.place}: not a whole {line.message} line ({error}); remove or repair it") from None
    ranges, directions = beams.ranges_m, beams.directions
    seen = (ranges > 0) & (ranges < min(limit_m, beams.max_range_m))  # NaN compares false
    readings = Readings(ranges, seen, directions if beams.stated else None)
    if directions is None:
        return Scan(stamp_ns, np.empty((0, 3)), _pose(pose, line), readings=readings)
    silent = NoReturns(directions[~seen], ranges[~seen])
    return Scan(
        stamp_ns, ranges[seen, None] * directions[seen], _pose(pose, line), no_returns=silent, readings=readings
    )


def _fields(line: Line, fov_rad: float | None, aimed: bool) -> tuple[Beams, Floats]:
    """The beams, and x y theta."""
    words = line.words
    if line.message == "FLASER":
        n = int(words[1])
        _check_length(words, 2 + n + 9)
        unknown = aimed and fov_rad is None and n not in BEAM_STEP_DEG
        angles = None if unknown else flaser_angles(n, line.place, fov_rad)
        return Beams(_floats(words[2 : 2 + n]), angles, fov_rad is not None, math.inf), _floats(words[2 + n : 5 + n])
    start, _, step, max_m = map(float, words[2:6])
    n = int(words[8])
    after = 9 + n + 1 + int(words[9 + n])
    _check_length(words, after + 14)
    angles = np.asarray(start + step * np.arange(n), np.float64)
    return Beams(_floats(words[9 : 9 + n]), angles, True, max_m), _floats(words[after : after + 3])


def _check_length(words: list[str], expected: int) -> None:
    if len(words) < expected:
        raise ValueError(f"{len(words)} words, {expected} expected")


def flaser_angles(beams: int, place: str, fov_rad: float | None) -> Floats:
    """Angles from right to left, radians, 0 ahead. Raises LogError for a number of beams not in the table."""
    if fov_rad is not None:
        return np.linspace(-fov_rad / 2, fov_rad / 2, beams)
    if beams not in BEAM_STEP_DEG:
        known = listed(BEAM_STEP_DEG)
        raise LogError(
            f"{place}: {beams} beams, and an FLASER line does not state its field of view (known are {known}); "
            "give ?fov_deg=, the angle between first and last beam, or describe the sensor with its ring"
        )
    angles: Floats = np.deg2rad(-90.0 + BEAM_STEP_DEG[beams] * np.arange(beams))
    return angles


def _floats(words: list[str]) -> Floats:
    return np.array(words, np.float64)


def _pose(x_y_theta: Floats, line: Line) -> Pose:
    if not np.isfinite(x_y_theta).all():
        raise PoseError(f"{line.place}: the laser's pose {x_y_theta.tolist()} is not finite; remove this line")
    x, y, theta = x_y_theta
    return Pose.from_quaternion((x, y, 0.0), (0.0, 0.0, math.sin(theta / 2), math.cos(theta / 2)))


def _fov(source: Source) -> float | None:
    return math.radians(positive(source, "fov_deg", 180.0)) if "fov_deg" in source.options else None


def _index(path: Path) -> list[tuple[str, Line]]:
    """Message and last words of every scan line, from one pass: what is checked before any scan is read."""
    return [(line.message, Line(line.place, line.words[-3:])) for line in _lines(path, *MESSAGES)]


def _message(source: Source, found: set[str]) -> str:
    """Which message to read: newer logs hold each scan under both names, and both would count it twice."""
    if not found:
        raise LogError(f"{source.path}: no {' or '.join(MESSAGES)} line; only these hold scans with poses")
    if "message" not in source.options and len(found) > 1:
        raise LogError(
            f"{source.path}: holds both FLASER and ROBOTLASER1 scans; say ?message=FLASER or ?message=ROBOTLASER1"
        )
    return choice(source, "message", sorted(found), min(found))


def _stamps(source: Source, ends: list[Line]) -> list[Stamp]:
    if choice(source, "stamps", ("log", "index"), "log") == "index":
        if "rate_hz" not in source.options:
            raise LogError(f"{source.path}: ?stamps=index needs the scans a second: ?stamps=index&rate_hz=5")
        period = NS / positive(source, "rate_hz", 1.0)
        return [round(number * period) for number in range(len(ends))]
    if "rate_hz" in source.options:
        raise LogError(f"{source.path}: ?rate_hz only counts with ?stamps=index")
    stamps = [_stamp(line) for line in ends]
    _check_clock(source.path, stamps)
    return stamps


def _stamp(end: Line) -> Stamp:
    try:
        return seconds_to_ns(end.words[0])
    except ValueError as error:
        raise LogError(f"{end.place}: not a whole scan line (its stamp: {error}); remove or repair it") from None


def _check_clock(path: Path, stamps: list[Stamp]) -> None:
    """Corrected logs were printed with six digits: all scans at 1.13486e+09. Such stamps order nothing."""
    distinct = len(set(stamps))
    if distinct * 2 < len(stamps):
        raise LogError(
            f"{path}: the clock stands still, {distinct} different stamps in {len(stamps)} scans; "
            "say ?stamps=index&rate_hz=5 to number them"
        )


def _lines(path: Path, *messages: str) -> Iterator[Line]:
    wanted = tuple(f"{message} " for message in messages)
    with _open_text(path) as lines:
        for number, line in enumerate(lines, 1):
            if line.startswith(wanted):
                yield Line(f"{path}:{number}", line.split())


def _open_text(path: Path) -> IO[str]:
    openers = {".gz": gzip.open, ".bz2": bz2.open}
    opener = openers.get(path.suffix.lower(), open)
    return opener(path, "rt", encoding="latin-1")  # type: ignore[operator,no-any-return]


READER = Reader(
    name="carmen",
    summary="CARMEN 2D laser log, .log or .clf, plain, .gz or .bz2, with FLASER or ROBOTLASER1 lines",
    matches=matches,
    open=open_carmen,
    options={
        "max_range_m": f"readings from here on are no return (default {MAX_RANGE_M:g}: the lowest sentinel)",
        "fov_deg": "angle from first to last beam of FLASER lines (default: as the described sensor has, else by "
        "180, 181, 360 or 361 beams)",
        "message": "FLASER | ROBOTLASER1, where a log holds both",
        "stamps": "log (default) | index: number the scans, for logs whose clock is of no use; needs rate_hz",
        "rate_hz": "scans a second for ?stamps=index",
    },
)
