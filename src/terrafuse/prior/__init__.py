"""What is known of a place before any robot saw it: one more contribution to the map, of the robot `prior`.

It comes from rasters and from polygons, and fuses like any other, with its own low confidence. Where several files say
something of a cell, the last one counts, each property by itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from terrafuse.errors import InputError
from terrafuse.exchange.delta import Delta, TileCells, map_id
from terrafuse.lattice import Lattice
from terrafuse.models.base import Model
from terrafuse.prior.polygons import open_polygons
from terrafuse.prior.raster import open_raster
from terrafuse.prior.source import PROPERTIES, PriorSource
from terrafuse.query import split_query
from terrafuse.types import Array, Bounds, Floats, Stamp, TileKey

ROBOT = "prior"
CONFIDENCE = 0.1
"""Of heights that come without one: a glance from the far end of a lidar's range is surer."""

MAX_CELLS = 2 * 10**8
"""Within a file's bounds: 20 by 10 km of 1 m cells. Ten million take about half a minute."""

RASTERS, POLYGONS = (".tif", ".tiff", ".hgt", ".asc", ".img", ".vrt"), (".geojson", ".json")
OPTIONS = {
    "confidence": f"of heights that come without one, 0 to 1 (default {CONFIDENCE})",
    "crs": "of a file that states none (default: the map's)",
    "band": "of a raster: the band that holds heights, by number or name",
}
DEGREES = Bounds(-180.0, -90.0, 180.0, 90.0)


Opener = Callable[[Path, float, Mapping[str, str]], PriorSource]


class TakesPrior(Protocol):
    """A model that can be told what is known beforehand."""

    def prior(
        self, height_m: Floats, confidence: Floats, gps_quality: Floats, communications: Floats, stamp_ns: Stamp = 0
    ) -> Array: ...


@dataclass(frozen=True)
class Prior:
    """Opened and checked files, in the order in which they were given."""

    sources: tuple[PriorSource, ...]
    paths: tuple[Path, ...]

    def deltas(self, lattice: Lattice, model: Model) -> Iterator[Delta]:
        """The contribution to a map, a delta for each line of tiles. Raises InputError for a model that takes none."""
        records = _taker(model).prior
        for source, path in zip(self.sources, self.paths, strict=True):
            _check_place(source, path, lattice)
        lines: dict[int, list[TileKey]] = {}
        for key in sorted({key for source in self.sources for key in _tiles(source, lattice)}):
            lines.setdefault(key.y, []).append(key)
        said: set[PriorSource] = set()
        for keys in lines.values():
            tiles = [_tile_cells(key, self._values(key, lattice, said), records) for key in keys]
            known = tuple(tile for tile in tiles if len(tile.at))
            if known:
                yield Delta(map_id(model.name, lattice), ROBOT, 0, 1, 0, known)
        for source, path in zip(self.sources, self.paths, strict=True):
            if source not in said:
                raise InputError(f"prior map {path}: gives no cell of this map: it holds nothing, or less than a cell")

    def _values(self, key: TileKey, lattice: Lattice, said: set[PriorSource]) -> dict[str, Floats]:
        """Each property over a tile, (T²,), NaN where no file says anything; those that do are added to `said`."""
        out = {name: np.full(lattice.tile_cells**2, np.nan) for name in PROPERTIES}
        for source in self.sources:
            for name, values in source.values(key, lattice).items():
                given = ~np.isnan(values)
                if given.any():
                    said.add(source)
                out[name][given] = values[given]
        return out


def open_prior(texts: Sequence[str]) -> Prior:
    """Open `FILE?key=value…`, each a raster or GeoJSON polygons. Raises InputError that names the file."""
    opened = [_open(text) for text in texts]
    return Prior(tuple(source for source, _ in opened), tuple(path for _, path in opened))


def check_model(model: Model) -> None:
    """Raise InputError for a model that takes no prior map."""
    _taker(model)


def _taker(model: Model) -> TakesPrior:
    if not hasattr(model, "prior"):
        raise InputError(f"the cell model '{model.name}' takes no prior map; use --model terrain, or leave --prior out")
    return model  # type: ignore[return-value]


def _open(text: str) -> tuple[PriorSource, Path]:
    name, options = split_query(text)
    path = Path(name)
    if not path.is_file():
        raise InputError(f"prior map {path}: no such file")
    opener, takes = _opener(path)
    for key in options:
        if key not in takes:
            raise InputError(f"prior map {path}: such a file has no option '{key}'; there are: {', '.join(takes)}")
    return opener(path, _confidence(path, options), options), path


def _opener(path: Path) -> tuple[Opener, tuple[str, ...]]:
    """What opens such a file, and the options that it takes."""
    if path.suffix.lower() in RASTERS:
        return open_raster, ("confidence", "crs", "band")
    if path.suffix.lower() in POLYGONS:
        return open_polygons, ("confidence", "crs")
    known = ", ".join(RASTERS + POLYGONS)
    raise InputError(f"prior map {path}: neither a raster nor GeoJSON polygons by its ending; known are {known}")


def _confidence(path: Path, options: Mapping[str, str]) -> float:
    text = options.get("confidence", str(CONFIDENCE))
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value <= 1:
        raise InputError(f"prior map {path}: confidence={text}: give a number over 0 and up to 1")
    return value


def _check_place(source: PriorSource, path: Path, lattice: Lattice) -> None:
    """Raise InputError for coordinates that must be degrees, in a map of metres, of a file that doesn't say so."""
    if lattice.crs is None and source.crs is not None:
        raise InputError(
            f"prior map {path}: is in {source.crs[:40]}, and the map in a frame of its own; "
            "say where that lies: --crs EPSG:… --origin EAST,NORTH"
        )
    if lattice.crs is None or source.crs is not None:
        return
    west, south, east, north = source.bounds(None)
    if west >= DEGREES.west and south >= DEGREES.south and east <= DEGREES.east and north <= DEGREES.north:
        raise InputError(
            f"prior map {path}: lies nowhere near the places of {lattice.crs}: its coordinates, {west:g} to {east:g} "
            f"and {south:g} to {north:g}, look like degrees and it states no CRS; say so by {path.name}?crs=EPSG:4326"
        )


def _tiles(source: PriorSource, lattice: Lattice) -> Iterator[TileKey]:
    """The tiles that the source's bounds meet."""
    i0, j0, i1, j1 = lattice.cell_window(source.bounds(lattice.crs))
    if (i1 - i0) * (j1 - j0) > MAX_CELLS:
        raise InputError(
            f"a prior map of {(i1 - i0) * (j1 - j0):.2g} cells of {lattice.resolution_m:g} m: at most {MAX_CELLS:.0e}; "
            "cut out the part around the robots, or use larger cells"
        )
    side = lattice.tile_cells
    for y in range(j0 // side, (j1 - 1) // side + 1):
        for x in range(i0 // side, (i1 - 1) // side + 1):
            yield TileKey(x, y)


def _tile_cells(key: TileKey, values: Mapping[str, Floats], records: Callable[..., Array]) -> TileCells:
    given = np.zeros(len(values["height_m"]), bool)
    for name in ("height_m", "gps_quality", "communications"):
        given |= ~np.isnan(values[name])
    at = np.flatnonzero(given).astype(np.int32)
    some = {name: array[at] for name, array in values.items()}
    return TileCells(key, at, records(**some | {"confidence": np.nan_to_num(some["confidence"])}))


__all__ = ["CONFIDENCE", "OPTIONS", "ROBOT", "Prior", "PriorSource", "TakesPrior", "check_model", "open_prior"]
