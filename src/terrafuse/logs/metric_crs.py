"""CRSs in feet → the same projection in metres, since lattices are metric."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from terrafuse.errors import LogError
from terrafuse.logs.libraries import library


@dataclass(frozen=True)
class MetricCrs:
    """`text` is `EPSG:n` where that says it exactly, else WKT. The factors take the file's numbers to metres."""

    text: str | None
    metres_per_xy: float
    metres_per_z: float


NO_CRS = MetricCrs(None, 1.0, 1.0)
"""A file without a CRS: its coordinates count as metres in a local frame."""


def parsed(text: str) -> Any:
    """A pyproj CRS, or None where the text is empty or broken: many writers leave an empty record."""
    pyproj = library("pyproj", "a CRS", "las")
    try:
        return pyproj.CRS.from_user_input(text) if text.strip("\0 \n") else None
    except pyproj.exceptions.CRSError:
        return None


def metric(crs: Any, where: object) -> MetricCrs:
    """The metric form of a pyproj CRS. Raises LogError, naming `where`, for degrees or geocentric ones."""
    horizontal, vertical = _parts(crs)
    if not horizontal.is_projected:
        raise LogError(
            f"{where}: its CRS '{crs.name}' is in {horizontal.axis_info[0].unit_name}, not projected; "
            "project the file to metres first (pdal translate IN OUT reprojection "
            "--filters.reprojection.out_srs=EPSG:…), or, if the header is wrong, say ?crs=EPSG:n"
        )
    per_xy = float(horizontal.axis_info[0].unit_conversion_factor)
    # without a vertical CRS heights are in the horizontal unit: the convention of State Plane tiles
    per_z = float(vertical.axis_info[0].unit_conversion_factor) if vertical else per_xy
    if per_xy == per_z == 1.0:
        return MetricCrs(text_of(crs), 1.0, 1.0)
    return MetricCrs(text_of(_in_metres(horizontal) if per_xy != 1.0 else horizontal), per_xy, per_z)


def text_of(crs: Any) -> str:
    authority = crs.to_authority(auth_name="EPSG", min_confidence=100)
    return f"EPSG:{authority[1]}" if authority else str(crs.to_wkt())


def _parts(crs: Any) -> tuple[Any, Any]:
    """Horizontal and vertical CRS (or None), out of compound and bound (TOWGS84) wrappings."""
    if crs.is_compound:
        horizontal, vertical = crs.sub_crs_list
        return _parts(horizontal)[0], vertical.source_crs if vertical.is_bound else vertical
    return (crs.source_crs, None) if crs.is_bound else (crs, None)


def _in_metres(crs: Any) -> Any:
    """Edited as PROJJSON: a PROJ string would lose the datum (NAD83(HARN) → "unknown")."""
    pyproj = library("pyproj", "a CRS in feet", "las")
    form = crs.to_json_dict()
    form.pop("id", None)
    form["name"] = f"{crs.name} (metres)"
    for axis in form["coordinate_system"]["axis"]:
        axis["unit"] = "metre"
    for parameter in form["conversion"]["parameters"]:
        unit = parameter["unit"]
        if isinstance(unit, dict) and unit["type"] == "LinearUnit":  # false easting and northing
            parameter["value"] *= unit["conversion_factor"]
            parameter["unit"] = "metre"
    form["conversion"].pop("id", None)
    return pyproj.CRS.from_json_dict(form)
