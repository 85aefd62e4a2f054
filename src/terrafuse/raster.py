"""A band of a raster file as an array and the grid that it lies on."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from terrafuse.errors import InputError, MissingExtra, TerrafuseError, shown
from terrafuse.grids import Grid
from terrafuse.types import Floats

MAX_CELLS = 3 * 10**8
LEAST_SIDE, FURTHEST = 1e-9, 1e9
"""Of pixels and coordinates, in degrees or metres."""
HEIGHT_BANDS = ("height", "z_mean", "elevation", "dem")
"""Names, in this order, of the band that is taken where none is asked for; else it is the first."""


@dataclass(frozen=True, eq=False)
class Raster:
    """`values` (H, W) float64 with the band's scale and offset applied, NaN where it has no data."""

    values: Floats
    grid: Grid
    band: str
    unit: str


def read_raster(file: Path | str, band: str | None = None, nodata: float | None = None) -> Raster:
    """A band (number from 1, or its description) of what GDAL opens. Raises InputError that names the file."""
    with _opened(file) as source:
        return _read(source, str(file), band, nodata)


def band_names(file: Path | str) -> list[str]:
    """The bands' descriptions, "" where there is none. Raises InputError that names the file."""
    with _opened(file) as source:
        return [name or "" for name in source.descriptions]


@contextmanager
def _opened(file: Path | str) -> Iterator[Any]:
    try:
        import rasterio
        from rasterio.errors import NotGeoreferencedWarning
    except ImportError as error:
        raise MissingExtra("a raster", "rasterio", "gis") from error
    if not _is_there(file):
        raise InputError(f"{shown(str(file))}: no such file")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", NotGeoreferencedWarning)
            source = rasterio.open(file)
        with source:
            yield source
    except NotGeoreferencedWarning as error:
        raise InputError(
            f"{file}: says nothing of where it lies; give a georeferenced raster (gdal_translate -a_ullr …), "
            "or, of a ROS map, the .yaml"
        ) from error
    except TerrafuseError:
        raise
    except Exception as error:  # GDAL's errors are of many kinds; a damaged header leads to any
        raise InputError(f"{file}: can't be read as a raster ({shown(str(error))}); is it a whole GeoTIFF?") from error


def _is_there(file: Path | str) -> bool:
    try:
        return Path(file).is_file()
    except (OSError, ValueError):  # too long a name, or none
        return False


def _read(source: Any, file: str, wanted: str | None, nodata: float | None) -> Raster:
    if source.width * source.height > MAX_CELLS:
        raise InputError(f"{file}: {source.width}×{source.height} pixels are too many; cut out a part, or coarsen it")
    number = _band(source, file, wanted)
    grid = _grid(source, file)
    raw = source.read(number, masked=True)
    if raw.dtype.kind not in "iuf":
        raise InputError(f"{file}: its values are of the kind {raw.dtype}; give a raster of real numbers")
    values = raw.astype(np.float64).filled(np.nan) * source.scales[number - 1] + source.offsets[number - 1]
    if nodata is not None:
        values[raw.data == nodata] = np.nan
    name = source.descriptions[number - 1] or f"band {number}"
    return Raster(values, grid, name, source.units[number - 1] or "m")


def _grid(source: Any, file: str) -> Grid:
    a, b, c, d, e, f = affine = tuple(source.transform)[:6]
    grid = Grid(source.height, source.width, (a, b, c, d, e, f), _crs(source))
    sides = all(LEAST_SIDE <= side <= FURTHEST for side in grid.sides_m)
    if not (sides and all(abs(edge) <= FURTHEST for edge in grid.bounds) and a * e != b * d):
        raise InputError(f"{file}: its transform {affine} gives its pixels no place; is it a whole GeoTIFF?")
    return grid


def _band(source: Any, file: str, wanted: str | None) -> int:
    names = [name or "" for name in source.descriptions]
    if wanted is None:
        found = [names.index(name) + 1 for name in HEIGHT_BANDS if name in names]
        return found[0] if found else 1
    if wanted in names:
        return names.index(wanted) + 1
    if wanted.isdigit() and 1 <= int(wanted) <= source.count:
        return int(wanted)
    known = ", ".join(f"{k} {name}".strip() for k, name in enumerate(names, 1))
    raise InputError(f"{file}: no band '{wanted}'; it has: {known}")


def _crs(source: Any) -> str | None:
    if source.crs is None:
        return None
    authority = source.crs.to_authority(confidence_threshold=100)
    return ":".join(authority) if authority else str(source.crs.to_wkt())
