"""A raster as prior knowledge: a DEM, or bands named like the properties."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from terrafuse import crs as crs_
from terrafuse.errors import InputError
from terrafuse.grids import Grid, bounds_in, located, window_grid
from terrafuse.lattice import Lattice
from terrafuse.prior.source import PROPERTIES, Extent
from terrafuse.raster import HEIGHT_BANDS, Raster, band_names, read_raster
from terrafuse.types import Bounds, Floats, TileKey


@dataclass(frozen=True, eq=False)
class RasterPrior:
    """Bands of one file, by property; each cell takes the pixel in which its centre lies."""

    path: Path
    bands: Mapping[str, Raster]
    confidence: float

    @property
    def grid(self) -> Grid:
        return next(iter(self.bands.values())).grid

    @property
    def crs(self) -> str | None:
        return self.grid.crs

    def bounds(self) -> Bounds:
        return self.grid.bounds

    def placed(self, lattice: Lattice) -> PlacedRaster:
        try:
            bounds = bounds_in(self.grid, lattice.crs)
            window = lattice.cell_window(bounds)
        except InputError as error:
            raise InputError(f"prior map {self.path}: {error}") from error
        return PlacedRaster(self, lattice, Extent(f"prior map {self.path}", bounds, window))


@dataclass(frozen=True, eq=False)
class PlacedRaster:
    source: RasterPrior
    lattice: Lattice
    extent: Extent

    def extents(self) -> Sequence[Extent]:
        return [self.extent]

    def values(self, key: TileKey) -> Floats:
        """(P, T²), NaN where no pixel says anything."""
        side = self.lattice.tile_cells
        cells = window_grid(self.lattice, (key.x * side, key.y * side, (key.x + 1) * side, (key.y + 1) * side))
        row, column, inside = located(cells, self.source.grid)
        out = np.full((len(PROPERTIES), side, side), np.nan)
        for layer, name in zip(out, PROPERTIES, strict=True):
            if name in self.source.bands:
                layer[:] = np.where(inside, self.source.bands[name].values[row, column], np.nan)[::-1]
            elif name == "confidence":
                layer[~np.isnan(out[0])] = self.source.confidence
        return out.reshape(len(out), -1)


def open_raster(path: Path, confidence: float, options: Mapping[str, str]) -> RasterPrior:
    """Heights are the band that is asked for, or is named so, or the first of a file without other names."""
    names = band_names(path)
    bands = {name: name for name in list(PROPERTIES)[1:] if name in names}
    if options.get("band") or not bands or {"height_m", *HEIGHT_BANDS} & set(names):
        bands["height_m"] = options.get("band") or ("height_m" if "height_m" in names else "")
    rasters = {name: read_raster(path, band or None) for name, band in bands.items()}
    for name, raster in rasters.items():
        _check_values(path, name, raster)
    crs = options.get("crs")
    return RasterPrior(path, {name: _placed(raster, path, crs) for name, raster in rasters.items()}, confidence)


def _check_values(path: Path, name: str, raster: Raster) -> None:
    """Raise InputError that names band, value and pixel."""
    for first in range(0, len(raster.values), ROWS):
        rows = raster.values[first : first + ROWS]
        wrong = PROPERTIES[name].wrong(rows)
        if wrong.any():
            row, column = np.argwhere(wrong)[0].tolist()
            raise InputError(
                f"prior map {path}: band '{raster.band}', {name}, is {rows[row, column]:g} at row {first + row + 1}, "
                f"column {column + 1}; {PROPERTIES[name].remedy}"
            )


ROWS = 256
"""That are looked at at once."""


def _placed(raster: Raster, path: Path, crs: str | None) -> Raster:
    """The raster in the CRS that the user says it has, where the file says none."""
    if crs is None:
        return raster
    if raster.grid.crs is not None:
        raise InputError(f"prior map {path}: states its CRS, {raster.grid.crs[:40]}; leave ?crs={crs} out")
    try:
        known = crs_.short_text(crs_.known(crs))
    except InputError as error:
        raise InputError(f"prior map {path}: {error}") from error
    return replace(raster, grid=replace(raster.grid, crs=known))
