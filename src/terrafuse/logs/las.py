"""Airborne LAS and LAZ: each file is one scan, already in the world's frame.

Feet become metres, for x, y and z, and so does the CRS: autzen's "NAD_1983_HARN_Lambert_Conformal_Conic" in
feet is given as the same projection "… (metres)". Points flagged "withheld" are left out, as the LAS
specification asks.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from terrafuse.errors import LogError
from terrafuse.logs.base import Log, Reader, Record, Source
from terrafuse.logs.las_crs import crs_of
from terrafuse.logs.las_size import check_sizes
from terrafuse.logs.libraries import library
from terrafuse.logs.metric_crs import MetricCrs
from terrafuse.logs.options import NS, listed, whole_numbers
from terrafuse.logs.stamps import natural_order
from terrafuse.types import Floats, Pose, Scan, Stamp

SUFFIXES = (".las", ".laz")
OTHER_SUFFIXES = (".pcd", ".ply", ".npy", ".bin", ".xyz", ".csv", ".tum")
CHUNK_POINTS = 1_000_000

GPS_EPOCH_S = 315_964_800
ADJUSTED_S = 1_000_000_000
"""LAS' "adjusted standard GPS time" is seconds since 1980-01-06 less 10⁹."""

LEAP_DAYS = [
    *((1981, 7), (1982, 7), (1983, 7), (1985, 7), (1988, 1), (1990, 1), (1991, 1), (1992, 7), (1993, 7)),
    *((1994, 7), (1996, 1), (1997, 7), (1999, 1), (2006, 1), (2009, 1), (2012, 7), (2015, 7), (2017, 1)),
]
"""Year and month from whose first day on GPS runs one more second ahead of UTC (IERS Bulletin C)."""


@dataclass(frozen=True)
class Tile:
    """One file, with what its header says."""

    path: Path
    crs: MetricCrs


def matches(path: Path) -> bool:
    """A file, or a folder: a licence or a note may lie beside, but no other point files or trajectory."""
    if path.is_file():
        return path.suffix.lower() in SUFFIXES
    files = [file for file in path.iterdir() if file.is_file()]
    mixed = any(file.suffix.lower() in OTHER_SUFFIXES or file.name == "trajectory.txt" for file in files)
    return not mixed and any(file.suffix.lower() in SUFFIXES for file in files)


def open_las(source: Source) -> Log:
    laspy = library("laspy", "LAS", "las")
    library("pyproj", "LAS", "las")
    classes = whole_numbers(source, "class")
    tiles = [_tile(laspy, source, path) for path in _files(source.path)]
    crs = _one_crs(source.path, tiles)
    if len(tiles) > 1:  # a pass over the times only where there is an order to find
        tiles.sort(key=lambda tile: _stamp_of_file(laspy, tile.path))

    def scans() -> Iterator[Record]:
        for tile in tiles:
            las = laspy.read(tile.path)
            points = read_points(las, classes)
            points *= (tile.crs.metres_per_xy, tile.crs.metres_per_xy, tile.crs.metres_per_z)
            yield Scan(_stamp(las.header, [las]), points, Pose.identity())

    return Log(source.path, READER.name, scans=scans, count=len(tiles), crs=crs, georeferenced=True)


def read_points(las: Any, classes: list[int] | None = None) -> Floats:
    """(N, 3) float64 in the file's unit: all points that are not withheld, or only those of the classes."""
    keep = np.asarray(las.withheld) == 0
    if classes is not None:
        keep &= np.isin(np.asarray(las.classification), classes)
    points: Floats = las.xyz[keep]
    return points


def _files(path: Path) -> list[Path]:
    if path.is_file():
        return [path]
    return sorted((file for file in path.iterdir() if file.suffix.lower() in SUFFIXES), key=natural_order) or _none(
        path
    )


def _none(path: Path) -> list[Path]:
    raise LogError(f"{path}: no .las or .laz file in this folder")


def _tile(laspy: Any, source: Source, path: Path) -> Tile:
    check_sizes(path)
    with laspy.open(path) as reader:
        return Tile(path, crs_of(reader.header, path, source.options.get("crs")))


def _one_crs(path: Path, tiles: list[Tile]) -> str | None:
    by_crs = {tile.crs: tile.path.name for tile in tiles}
    if len(by_crs) > 1:
        example = "; ".join(f"{name}: {crs.text and crs.text[:60]}" for crs, name in by_crs.items())
        raise LogError(f"{path}: the files differ in CRS or unit ({example}); open them one by one, or say ?crs=EPSG:n")
    return tiles[0].crs.text


def _stamp_of_file(laspy: Any, path: Path) -> Stamp:
    with laspy.open(path) as reader:
        return _stamp(reader.header, reader.chunk_iterator(CHUNK_POINTS))


def _stamp(header: Any, chunks: Iterable[Any]) -> Stamp:
    """Time of the earliest point where the file has absolute times, else the day it was made, else 0."""
    absolute = int(header.global_encoding.gps_time_type) == 1 and "gps_time" in header.point_format.dimension_names
    if absolute and header.point_count:
        return gps_to_unix_ns(min(float(np.min(chunk.gps_time)) for chunk in chunks))
    day = header.creation_date
    return 0 if day is None else _midnight_s(day.year, day.month, day.day) * NS


def gps_to_unix_ns(adjusted_s: float) -> Stamp:
    """Adjusted standard GPS seconds → UTC; GPS has no leap seconds, so it is ahead by those since 1980."""
    whole, part = divmod(adjusted_s, 1)  # apart, since a float of nanoseconds since 1970 is only good to 256
    gps_s = int(whole) + ADJUSTED_S + GPS_EPOCH_S
    starts = [_midnight_s(year, month, 1) + ahead for ahead, (year, month) in enumerate(LEAP_DAYS, 1)]
    leaps = sum(gps_s >= start for start in starts)
    return (gps_s - leaps) * NS + round(part * NS)


def _midnight_s(year: int, month: int, day: int) -> int:
    return int(datetime(year, month, day, tzinfo=UTC).timestamp())


READER = Reader(
    name="las",
    summary=f"airborne .las or .laz, or a folder of only these ({listed(SUFFIXES)}), in world coordinates",
    matches=matches,
    open=open_las,
    options={
        "class": "comma list of the classes to keep, as 2 for ground (default: all)",
        "crs": "EPSG:n or WKT that counts instead of the header's",
    },
)
