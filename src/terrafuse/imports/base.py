"""What an importer is asked for and what it gives."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from terrafuse.exchange.delta import Delta
from terrafuse.lattice import Lattice
from terrafuse.models.base import Model
from terrafuse.types import Stamp


@dataclass(frozen=True)
class Wishes:
    """How a file is to be taken in. None leaves it to the file."""

    robot: str = "import"
    """As whose contribution."""
    stamp_ns: Stamp = 0
    """When its cells were last seen: 1970 is older than any scan."""
    crs: str | None = None
    """What its coordinates are in; for a raster of another CRS, with `resample`, what to bring it to."""
    tile_m: float | None = None
    resample: bool = False
    """Whether it may be brought to the lattice by nearest neighbours where it does not lie on it."""
    resolution_m: float | None = None
    """Cells to resample to."""
    band: str | None = None
    """Of a raster: number from 1, or description."""
    nodata: float | None = None
    """Of a raster that does not say which value means unknown."""


@dataclass(frozen=True, eq=False)
class Contribution:
    """A file as one robot's contribution. `deltas` may be read once."""

    lattice: Lattice
    model: Model
    deltas: Iterator[Delta]
    notes: Mapping[str, Any] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    """What was done to it, for people."""


Take = Callable[[Path, Wishes], Contribution]


@dataclass(frozen=True)
class Importer:
    suffixes: tuple[str, ...]
    summary: str
    take: Take
