"""Which coordinate reference system a map is in."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from terrafuse.errors import InputError, MissingExtra

if TYPE_CHECKING:
    import pyproj


def known(text: str) -> pyproj.CRS:
    """A CRS from EPSG:n, WKT or PROJ text; raises InputError for one that pyproj does not know."""
    try:
        import pyproj
    except ImportError as error:
        raise MissingExtra(f"the CRS {text}", "pyproj", "gis") from error
    try:
        return pyproj.CRS.from_user_input(text)
    except pyproj.exceptions.CRSError as error:
        raise InputError(f"CRS '{text}' is not known; give a code like EPSG:32632, or WKT") from error


def parse(text: str) -> pyproj.CRS:
    """The CRS of a map; raises InputError unless it is projected and metric."""
    crs = known(text)
    if not crs.is_projected or any(abs(axis.unit_conversion_factor - 1) > 1e-12 for axis in crs.axis_info[:2]):
        raise InputError(f"CRS '{text}' ({crs.name}) does not count metres; choose a projected one, like a UTM zone")
    return crs


def canonical(text: str) -> str:
    """EPSG:n where the CRS is exactly that, else WKT: equal CRSs become equal text, and lattices meet."""
    return short_text(parse(text))


def short_text(crs: pyproj.CRS) -> str:
    """EPSG:n where it is exactly that, else WKT."""
    authority = crs.to_authority(min_confidence=100)
    return ":".join(authority) if authority else str(crs.to_wkt())


def common(wanted: str | None, stated: Mapping[str, str | None]) -> str | None:
    """The one CRS of a map, canonical: the one that was asked for, which every log that states one (by its name) must
    be in. Raises InputError where they differ."""
    chosen = canonical(wanted) if wanted else None
    because = "--crs"
    for name, text in stated.items():
        if text is None:
            continue
        own = canonical(text)
        if chosen is not None and own != chosen:
            raise InputError(
                f"mixed CRS: {name} is in {parse(own).name}, {because} in {parse(chosen).name}; "
                "bring the logs to one CRS first, or map them apart"
            )
        if chosen is None:
            chosen, because = own, name
    return chosen
