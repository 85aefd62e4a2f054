"""What CRS a LAS header states. Three records may say it, and each is left empty or broken by some writer."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from terrafuse.errors import LogError
from terrafuse.logs.metric_crs import NO_CRS, MetricCrs, metric, parsed

LASF, LIBLAS, WKT_RECORD, GEOKEY_RECORD = "LASF_Projection", "liblas", 2112, 34735

MODEL_TYPE, GEOGRAPHIC_CRS, PROJECTED_CRS, LINEAR_UNIT, VERTICAL_UNIT = 1024, 2048, 3072, 3076, 4099
"""GeoTIFF keys (OGC 19-008r4)."""

GEOGRAPHIC_MODEL = 2
METRES_PER_UNIT = {9001: 1.0, 9002: 0.3048, 9003: 1200 / 3937}
EPSG_CODES = range(1024, 32767)
"""Other values of a CRS key mean "user-defined"."""


def crs_of(header: Any, path: Path, override: str | None) -> MetricCrs:
    """The header's CRS in metres; `override` counts instead where given.

    Order: WKT, GeoTIFF keys with an EPSG code, libLAS' copy in WKT. None of them readable is no CRS, unless
    the keys state a unit other than the metre: then LogError, since the coordinates would be scaled wrongly.
    """
    if override is not None:
        crs = parsed(override)
        if crs is None:
            raise LogError(f"{path}: ?crs={override} is not a CRS that PROJ knows; give EPSG:n or WKT")
        return metric(crs, path)
    records = [*header.vlrs, *(header.evlrs or [])]
    keys = _geokeys(records)
    for text in (*_texts(records, LASF), _epsg(keys), *_texts(records, LIBLAS)):
        crs = parsed(text)
        if crs is not None:
            return _with_vertical_unit(metric(crs, path), keys, from_keys=text == _epsg(keys))
    if keys.get(LINEAR_UNIT, 9001) != 9001:
        raise LogError(
            f"{path}: its CRS is user-defined and not in metres (GeoTIFF unit {keys[LINEAR_UNIT]}), "
            "but no record spells it out; say ?crs=EPSG:n, or give its WKT"
        )
    return NO_CRS


def _texts(records: list[Any], user_id: str) -> Iterator[str]:
    for record in records:
        if record.user_id == user_id and record.record_id == WKT_RECORD:
            yield record.record_data_bytes().decode("utf-8", "replace").rstrip("\0")


def _geokeys(records: list[Any]) -> dict[int, int]:
    """The keys whose value stands in the directory itself: all those that are codes."""
    return {
        key.id: key.value_offset
        for record in records
        if record.user_id == LASF and record.record_id == GEOKEY_RECORD
        for key in record.geo_keys
        if key.tiff_tag_location == 0
    }


def _epsg(keys: dict[int, int]) -> str:
    """`EPSG:n`, empty where user-defined. The geographic key of a projected CRS is only its datum."""
    key = GEOGRAPHIC_CRS if keys.get(MODEL_TYPE) == GEOGRAPHIC_MODEL else PROJECTED_CRS
    return f"EPSG:{keys[key]}" if keys.get(key) in EPSG_CODES else ""


def _with_vertical_unit(crs: MetricCrs, keys: dict[int, int], from_keys: bool) -> MetricCrs:
    unit = METRES_PER_UNIT.get(keys.get(VERTICAL_UNIT, 0))
    return replace(crs, metres_per_z=unit) if from_keys and unit else crs
