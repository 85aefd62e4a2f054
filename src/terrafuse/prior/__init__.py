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
from terrafuse.prior.place import check_extents, check_frame, tiles
from terrafuse.prior.polygons import open_polygons
from terrafuse.prior.raster import open_raster
from terrafuse.prior.source import PROPERTIES, Placed, PriorSource
from terrafuse.query import split_query
from terrafuse.types import Array, Floats, Stamp, TileKey

ROBOT = "prior"
CONFIDENCE = 0.1
"""Of heights that come without one: a glance from the far end of a lidar's range is surer."""

CONFIDENCE_ROW = list(PROPERTIES).index("confidence")
BATCH_CELLS = 2**20
"""About as many cells go into one delta: some 50 MB of memory."""

RASTERS, POLYGONS = (".tif", ".tiff", ".hgt", ".asc", ".img", ".vrt"), (".geojson", ".json")
OPTIONS = {
    "confidence": f"of heights that come without one, 0 to 1 (default {CONFIDENCE})",
    "crs": "of a file that states none (default: the map's)",
    "band": "of a raster: the band that holds heights, by number or name",
}

Opener = Callable[[Path, float, Mapping[str, str]], PriorSource]

Progress = Callable[[int, int, int], None]
"""Called for each tile: tiles so far, tiles in all, cells so far."""


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

    def deltas(self, lattice: Lattice, model: Model, progress: Progress | None = None) -> Iterator[Delta]:
        """The contribution to a map, in deltas that each hold tiles of their own. Raises InputError, before the first,
        for a model that takes none and for files that say nothing of this map or reach too far over it."""
        records, placed = _taker(model).prior, self.placed(lattice)
        keys = sorted({key for one in placed for key in tiles(one, lattice)}, key=lambda key: (key.y, key.x))
        batch: list[TileCells] = []
        cells = waiting = 0
        for number, key in enumerate(keys, 1):
            tile = _tile_cells(key, _values(key, placed), records)
            cells, waiting = cells + len(tile.at), waiting + len(tile.at)
            if len(tile.at):
                batch.append(tile)
            if waiting >= BATCH_CELLS or (batch and number == len(keys)):
                yield Delta(
                    map_id(model.name, lattice), ROBOT, 0, 1, 0, tuple(sorted(batch, key=lambda tile: tile.key))
                )
                batch, waiting = [], 0
            if progress is not None:
                progress(number, len(keys), cells)

    def placed(self, lattice: Lattice, beginnings: Mapping[str, tuple[float, float]] | None = None) -> list[Placed]:
        """Each file laid upon the map. Raises InputError for what has no place there, gives no cell, or would make a
        map too large, also together with the places (east, north) where robots begin, by name."""
        for source, path in zip(self.sources, self.paths, strict=True):
            check_frame(source, path, lattice)
        out = [source.placed(lattice) for source in self.sources]
        check_extents([extent for one in out for extent in one.extents()], lattice, beginnings or {})
        for one, path in zip(out, self.paths, strict=True):
            if all(np.isnan(one.values(key)).all() for key in tiles(one, lattice)):
                raise InputError(f"prior map {path}: gives no cell of this map: it holds nothing, or less than a cell")
        return out


def _values(key: TileKey, placed: Sequence[Placed]) -> Floats:
    """(P, T²) of what several files say of a tile: of each property, the last one that says it."""
    out = placed[0].values(key)
    for one in placed[1:]:
        values = one.values(key)
        np.copyto(out, values, where=~np.isnan(values))
    return out


def _tile_cells(key: TileKey, values: Floats, records: Callable[..., Array]) -> TileCells:
    given = ~np.isnan(values)
    given[CONFIDENCE_ROW] = False
    at = np.flatnonzero(given.any(axis=0)).astype(np.int32)
    some = dict(zip(PROPERTIES, values[:, at], strict=True))
    return TileCells(key, at, records(**some | {"confidence": np.nan_to_num(some["confidence"])}))


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


__all__ = [
    "CONFIDENCE",
    "OPTIONS",
    "ROBOT",
    "Placed",
    "Prior",
    "PriorSource",
    "TakesPrior",
    "check_model",
    "open_prior",
]
