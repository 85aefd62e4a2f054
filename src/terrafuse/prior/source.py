"""What a file of prior knowledge gives."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from terrafuse.lattice import Lattice
from terrafuse.types import Bounds, Floats, TileKey

PROPERTIES = ("height_m", "confidence", "gps_quality", "communications")


class PriorSource(Protocol):
    @property
    def crs(self) -> str | None:
        """That of its coordinates; None: it states none, and they are taken to be the map's."""

    def bounds(self, crs: str | None) -> Bounds:
        """In this CRS; None is taken to be the file's own."""

    def values(self, key: TileKey, lattice: Lattice) -> Mapping[str, Floats]:
        """Some of PROPERTIES at the centres of a tile's cells, (T²,) flat, NaN where the file says nothing."""
