"""A raster as prior knowledge: a DEM, or bands named like the properties."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from terrafuse import crs as crs_
from terrafuse.errors import InputError
from terrafuse.grids import bounds_in, transformed, window_grid
from terrafuse.lattice import Lattice
from terrafuse.prior.source import PROPERTIES
from terrafuse.raster import Raster, band_names, read_raster
from terrafuse.types import Bounds, Floats, TileKey


@dataclass(frozen=True, eq=False)
class RasterPrior:
    """Bands of one file, by property; each cell takes the pixel in which its centre lies."""

    bands: Mapping[str, Raster]
    confidence: float

    @property
    def crs(self) -> str | None:
        return next(iter(self.bands.values())).grid.crs

    def bounds(self, crs: str | None) -> Bounds:
        return bounds_in(next(iter(self.bands.values())).grid, crs)

    def values(self, key: TileKey, lattice: Lattice) -> Mapping[str, Floats]:
        side = lattice.tile_cells
        cells = window_grid(lattice, (key.x * side, key.y * side, (key.x + 1) * side, (key.y + 1) * side))
        grid = next(iter(self.bands.values())).grid
        x, y = transformed(*cells.centres(0, side), lattice.crs, grid.crs)
        row, column, inside = grid.locate(x, y)
        out = {
            name: np.where(inside, band.values[row, column], np.nan)[::-1].reshape(-1)
            for name, band in self.bands.items()
        }
        if "height_m" in out and "confidence" not in out:
            out["confidence"] = np.where(np.isnan(out["height_m"]), np.nan, self.confidence)
        return out


def open_raster(path: Path, confidence: float, options: Mapping[str, str]) -> RasterPrior:
    """Heights are the band that is asked for, or is named so, or the first of a file without other names."""
    names = band_names(path)
    bands = {name: name for name in PROPERTIES[1:] if name in names}
    if options.get("band") or not bands or {"height", "height_m", "z_mean", "elevation", "dem"} & set(names):
        bands["height_m"] = options.get("band") or ("height_m" if "height_m" in names else "")
    rasters = {name: read_raster(path, band or None) for name, band in bands.items()}
    for name, raster in rasters.items():
        if np.isinf(raster.values).any():
            raise InputError(f"prior map {path}: the band '{raster.band}' for {name} holds infinite values")
    return RasterPrior(
        {name: _placed(raster, path, options.get("crs")) for name, raster in rasters.items()}, confidence
    )


def _placed(raster: Raster, path: Path, crs: str | None) -> Raster:
    """The raster in the CRS that the user says it has, where the file says none."""
    if crs is None:
        return raster
    if raster.grid.crs is not None:
        raise InputError(f"prior map {path}: states its CRS, {raster.grid.crs}; leave ?crs={crs} out")
    return replace(raster, grid=replace(raster.grid, crs=crs_.short_text(crs_.known(crs))))
