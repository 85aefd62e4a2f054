"""The settings of a mapping run: one tree, units in the names, checked where they come in."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from terrafuse.errors import InputError


class MapSettings(BaseModel):
    """What `terrafuse map` is told, beyond which logs."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    model: str = "elevation"
    model_settings: dict[str, Any] = Field(default_factory=dict)
    resolution_m: float = Field(0.1, gt=0)
    tile_m: float | None = Field(None, gt=0)
    """None: 40 m, or 100 cells where these are larger than 0.5 m."""
    crs: str | None = None
    """CRS of the map; None takes the logs' own, or a local metric frame."""
    origin_m: tuple[float, float] | None = None
    """East and north, in the CRS, of the origin of logs that are not georeferenced."""
    window: str = "tiles3x3"
    """A name of `terrafuse.window.WINDOWS`, with options as in `radius?range_m=8&speed_mps=0.3`."""
    sensors: dict[str, str] = Field(default_factory=dict)
    """By robot, what describes its sensor: a preset's name or a YAML file. Robots without one go by their log."""
    prior: tuple[str, ...] = ()
    """Files of what is known beforehand, each `FILE?key=value…`; see `terrafuse.prior`."""
    global_factor: int = Field(1, ge=1)
    """Cells along the side of a cell of the coarser global map; 1 makes none."""
    commit_scans: int = Field(25, ge=1)
    """Scans between two commits: what a crash can cost."""


def map_settings(**values: Any) -> MapSettings:
    """MapSettings of what is not None; raises InputError that names the setting."""
    try:
        return MapSettings(**{name: value for name, value in values.items() if value is not None})
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise InputError(f"{where} = {first['input']!r}: {first['msg'].lower()}") from error
