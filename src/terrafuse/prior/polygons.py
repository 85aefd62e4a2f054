"""GeoJSON polygons as prior knowledge: houses of a known height, places without a link.

Each feature is a Polygon or MultiPolygon with some of the properties `height_m`, `confidence`, `gps_quality` and
`communications`. A cell belongs to a polygon in which its centre lies; of several, the last in the file counts.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from terrafuse import crs as crs_
from terrafuse.errors import InputError, MissingExtra
from terrafuse.grids import Grid, bounds_in, transformed, window_grid
from terrafuse.lattice import Lattice
from terrafuse.prior.source import PROPERTIES
from terrafuse.types import Array, Bounds, Floats, TileKey


@dataclass(frozen=True, eq=False)
class Feature:
    """Polygons, each a list of rings (N, 2), the outer one first; and what is known of them."""

    polygons: tuple[tuple[Floats, ...], ...]
    values: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class PolygonPrior:
    features: tuple[Feature, ...]
    crs: str | None

    def bounds(self, crs: str | None) -> Bounds:
        rings = [ring for feature in self.features for polygon in feature.polygons for ring in polygon]
        low, high = np.min([r.min(axis=0) for r in rings], axis=0), np.max([r.max(axis=0) for r in rings], axis=0)
        wide, tall = high - low
        return bounds_in(Grid(1, 1, (wide, 0.0, low[0], 0.0, -tall, high[1]), self.crs), crs)

    def values(self, key: TileKey, lattice: Lattice) -> Mapping[str, Floats]:
        return {name: self._burnt(name, key, lattice) for name in PROPERTIES}

    def _burnt(self, name: str, key: TileKey, lattice: Lattice) -> Floats:
        """A property over a tile, (T²,)."""
        side = lattice.tile_cells
        features = [feature for feature in self.features if name in feature.values]
        number = self._numbers(features, key, lattice)
        table = np.array([math.nan, *(feature.values[name] for feature in features)])
        return np.asarray(table[number][::-1].reshape(side * side))

    def _numbers(self, features: list[Feature], key: TileKey, lattice: Lattice) -> Array:
        """(T, T), row 0 in the north: which feature, from 1, each cell's centre lies in; 0 for none."""
        try:
            from rasterio.features import rasterize
            from rasterio.transform import Affine
        except ImportError as error:
            raise MissingExtra("a prior map of polygons", "rasterio", "gis") from error
        side = lattice.tile_cells
        grid = window_grid(lattice, (key.x * side, key.y * side, (key.x + 1) * side, (key.y + 1) * side))
        shapes = [(self._shape(feature, lattice.crs), number) for number, feature in enumerate(features, 1)]
        if not shapes:
            return np.zeros((side, side), np.int32)
        return np.asarray(rasterize(shapes, (side, side), transform=Affine(*grid.affine), dtype="int32"))

    def _shape(self, feature: Feature, crs: str | None) -> dict[str, Any]:
        """The geometry in another CRS."""
        polygons = [
            [np.stack(transformed(ring[:, 0], ring[:, 1], self.crs, crs), axis=1).tolist() for ring in polygon]
            for polygon in feature.polygons
        ]
        return {"type": "MultiPolygon", "coordinates": polygons}


def open_polygons(path: Path, confidence: float, options: Mapping[str, str]) -> PolygonPrior:
    """Heights without a confidence of their own get `confidence`. Raises InputError that names the feature."""
    content = _content(path)
    features = tuple(
        _feature(feature, f"prior map {path}: feature {number}", confidence)
        for number, feature in enumerate(content["features"], 1)
    )
    if not features:
        raise InputError(f"prior map {path}: holds no feature")
    stated = options.get("crs") or _stated_crs(content)
    return PolygonPrior(features, None if stated is None else crs_.short_text(crs_.known(stated)))


def _content(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, OSError, RecursionError) as error:
        raise InputError(f"prior map {path}: can't be read as GeoJSON: {error}") from error
    if not isinstance(content, dict) or not isinstance(content.get("features"), list):
        raise InputError(f"prior map {path}: is no GeoJSON FeatureCollection; it needs a list of 'features'")
    return content


def _stated_crs(content: Mapping[str, Any]) -> str | None:
    """The CRS by GeoJSON 2008's member, which GIS programs still write for other than longitude and latitude."""
    member = content.get("crs") or {}
    try:
        name = (member.get("properties") or {}).get("name")
    except AttributeError:
        name = member
    if name is not None and not isinstance(name, str):
        raise InputError(
            f"the 'crs' member {member!r:.60} names no CRS; write {{'properties': {{'name': 'EPSG:32632'}}}}"
        )
    return name


def _feature(feature: Any, where: str, confidence: float) -> Feature:
    try:
        kind, coordinates = feature["geometry"]["type"], feature["geometry"]["coordinates"]
        given = dict(feature.get("properties") or {})
    except (TypeError, ValueError, KeyError, AttributeError):
        raise InputError(f"{where}: needs a geometry with a type and coordinates, and properties by name") from None
    if kind not in ("Polygon", "MultiPolygon"):
        raise InputError(f"{where}: a {kind}; prior knowledge comes on a Polygon or MultiPolygon")
    values = {name: _number(given[name], name, where) for name in PROPERTIES if given.get(name) is not None}
    if not values.keys() - {"confidence"}:
        raise InputError(f"{where}: says nothing; give height_m, gps_quality or communications as a property")
    if "height_m" in values:
        values.setdefault("confidence", confidence)
    return Feature(_polygons([coordinates] if kind == "Polygon" else coordinates, where), values)


def _number(value: Any, name: str, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e9:
        raise InputError(f"{where}: {name} is {value!r}; give a number")
    return float(value)


def _polygons(coordinates: Any, where: str) -> tuple[tuple[Floats, ...], ...]:
    try:
        out = tuple(tuple(np.array([p[:2] for p in ring], np.float64) for ring in polygon) for polygon in coordinates)
    except (TypeError, ValueError, IndexError):
        raise InputError(f"{where}: its coordinates are no rings of [x, y]") from None
    rings = [ring for polygon in out for ring in polygon]
    if not rings or any(ring.ndim != 2 or ring.shape[0] < 4 or not np.isfinite(ring).all() for ring in rings):
        raise InputError(f"{where}: a ring needs at least 4 finite points [x, y], the last like the first")
    return out
