"""GeoJSON polygons as prior knowledge: houses of a known height, places without a link.

Each feature is a Polygon or MultiPolygon with some of the properties `height_m`, `confidence`, `gps_quality` and
`communications`. A cell belongs to a polygon in which its centre lies; of several, the last in the file counts.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from terrafuse import crs as crs_
from terrafuse.errors import InputError, shown
from terrafuse.lattice import Lattice
from terrafuse.prior.burnt import PlacedPolygons, lay
from terrafuse.prior.source import PROPERTIES
from terrafuse.types import Bounds, Floats

NOTHING = "give height_m, gps_quality or communications as a property"


@dataclass(frozen=True, eq=False)
class Feature:
    """Polygons, each a list of rings (N, 2), the outer one first; and what is known of them."""

    polygons: tuple[tuple[Floats, ...], ...]
    values: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class PolygonPrior:
    path: Path
    features: tuple[Feature, ...]
    crs: str | None

    def bounds(self) -> Bounds:
        rings = [ring for feature in self.features for polygon in feature.polygons for ring in polygon]
        low, high = np.min([r.min(axis=0) for r in rings], axis=0), np.max([r.max(axis=0) for r in rings], axis=0)
        return Bounds(*low.tolist(), *high.tolist())

    def placed(self, lattice: Lattice) -> PlacedPolygons:
        polygons = [feature.polygons for feature in self.features]
        values = np.array([[feature.values.get(name, np.nan) for name in PROPERTIES] for feature in self.features])
        return lay(polygons, values, self.crs, lattice, f"prior map {self.path}: feature")


def open_polygons(path: Path, confidence: float, options: Mapping[str, str]) -> PolygonPrior:
    """Heights without a confidence of their own get `confidence`. Raises InputError that names the feature."""
    content = _content(path)
    features = tuple(
        _feature(feature, f"prior map {path}: feature {number}", confidence)
        for number, feature in enumerate(content["features"], 1)
    )
    if not features:
        raise InputError(f"prior map {path}: holds no feature")
    return PolygonPrior(path, features, _crs(path, options.get("crs"), content))


def _content(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, OSError, RecursionError) as error:
        raise InputError(f"prior map {path}: can't be read as GeoJSON: {shown(str(error))}") from error
    if not isinstance(content, dict) or not isinstance(content.get("features"), list):
        raise InputError(f"prior map {path}: is no GeoJSON FeatureCollection; it needs a list of 'features'")
    return content


def _crs(path: Path, said: str | None, content: Mapping[str, Any]) -> str | None:
    try:
        stated = said or _stated_crs(content)
        return None if stated is None else crs_.short_text(crs_.known(stated))
    except InputError as error:
        raise InputError(f"prior map {path}: {error}") from error


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
        raise InputError(f"{where}: a {shown(str(kind))}; prior knowledge comes on a Polygon or MultiPolygon")
    values = {name: _number(given[name], name, where) for name in PROPERTIES if given.get(name) is not None}
    if not values.keys() - {"confidence"}:
        raise InputError(f"{where}: says nothing; {NOTHING}")
    if "height_m" in values:
        values.setdefault("confidence", confidence)
    return Feature(_polygons([coordinates] if kind == "Polygon" else coordinates, where), values)


def _number(value: Any, name: str, where: str) -> float:
    number = isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300
    if not number or PROPERTIES[name].wrong(float(value)):
        raise InputError(f"{where}: {name} is {shown(repr(value))}; {PROPERTIES[name].remedy}")
    return float(value)


def _polygons(coordinates: Any, where: str) -> tuple[tuple[Floats, ...], ...]:
    try:
        out = tuple(tuple(_ring(ring) for ring in polygon) for polygon in coordinates)
    except (TypeError, ValueError, LookupError):
        raise InputError(f"{where}: its coordinates are no rings of [x, y]") from None
    rings = [ring for polygon in out for ring in polygon]
    if not out or not all(out) or any(ring.ndim != 2 or len(ring) < 4 or not np.isfinite(ring).all() for ring in rings):
        raise InputError(f"{where}: a ring needs at least 4 finite points [x, y], the last like the first")
    return out


def _ring(points: Any) -> Floats:
    """(N, 2). Raises TypeError, ValueError or LookupError for what are no numbers."""
    ring = np.array([point[:2] for point in points])
    if ring.dtype.kind not in "iuf":  # text, truth, whole numbers of hundreds of digits
        raise TypeError
    return ring.astype(np.float64)
