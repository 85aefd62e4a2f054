"""A layer as an xarray.DataArray."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from terrafuse import crs, views
from terrafuse.errors import MissingExtra
from terrafuse.lattice import Lattice
from terrafuse.replica import Replica
from terrafuse.types import Bounds, Floats

if TYPE_CHECKING:
    import xarray


def centres(lattice: Lattice, window: views.CellWindow) -> tuple[Floats, Floats]:
    """(x rising, y falling) of the cell centres of a window, metres: the axes of a north-up raster."""
    i0, j0, i1, j1 = window
    return lattice.cell_centre(np.arange(i0, i1)), lattice.cell_centre(np.arange(j1 - 1, j0 - 1, -1))


def data_array(replica: Replica, name: str, bounds: Bounds | None = None) -> xarray.DataArray:
    """A layer, float64, over the bounds or all that is known; see `Replica.layer`."""
    try:
        import xarray
    except ImportError as error:
        raise MissingExtra("a layer as an array with coordinates", "xarray", "gis") from error
    (layer,) = views.chosen_layers(replica, [name])
    window = views.window_of(replica, bounds)
    x, y = centres(replica.lattice, window)
    coordinates: dict[str, Any] = {
        "y": ("y", y, _axis("y", "north", replica.lattice)),
        "x": ("x", x, _axis("x", "east", replica.lattice)),
    }
    attributes = {"units": layer.unit, "long_name": layer.description}
    if replica.lattice.crs is not None:
        coordinates["spatial_ref"] = ((), 0, _spatial_reference(replica, window))
        attributes["grid_mapping"] = "spatial_ref"
    values = views.mosaic(replica, [layer], window)[name][::-1]
    return xarray.DataArray(values, coordinates, ("y", "x"), name, attributes)


def _axis(axis: str, direction: str, lattice: Lattice) -> dict[str, str]:
    attributes = {"units": "m", "axis": axis.upper(), "long_name": direction}
    if lattice.crs is not None:
        attributes["standard_name"] = f"projection_{axis}_coordinate"
    return attributes


def _spatial_reference(replica: Replica, window: views.CellWindow) -> dict[str, Any]:
    """CF's grid mapping attributes, with the WKT and the transform under the names that GDAL reads."""
    attributes = crs.parse(str(replica.lattice.crs)).to_cf()
    bounds, r = views.bounds_of(replica, window), replica.lattice.resolution_m
    attributes["spatial_ref"] = attributes["crs_wkt"]
    attributes["GeoTransform"] = " ".join(map(repr, (bounds.west, r, 0.0, bounds.north, 0.0, -r)))
    return attributes
