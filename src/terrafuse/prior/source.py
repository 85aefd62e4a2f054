"""What a file of prior knowledge gives, and which values it may have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from terrafuse.kernels.evidence import MAX_Z_M
from terrafuse.lattice import Lattice
from terrafuse.types import Array, Bounds, Floats, TileKey

CellWindow = tuple[int, int, int, int]
"""(i0, j0, i1, j1), half open."""


@dataclass(frozen=True)
class Property:
    """What a property may be: whole numbers only, or all between `low` and `high`."""

    low: float
    high: float
    whole: bool
    remedy: str

    def wrong(self, values: Floats | float) -> Array:
        """Where values (any shape) are none of these; NaN is none given."""
        right = (self.low <= np.asarray(values)) & (np.asarray(values) <= self.high)
        if self.whole:
            right &= np.floor(values) == values
        return np.asarray(~right & ~np.isnan(values))


PROPERTIES: Mapping[str, Property] = {
    "height_m": Property(-MAX_Z_M, MAX_Z_M, False, f"give metres within ±{MAX_Z_M:.0f}; what is unknown has no height"),
    "confidence": Property(0, 1, False, "give a number from 0 to 1"),
    "gps_quality": Property(0, 2, True, "give 0 none, 1 single or 2 differential"),
    "communications": Property(0, 1, True, "give 0 none or 1 there is a link"),
}


@dataclass(frozen=True)
class Extent:
    """Where a part of a file lies: `what` names file and part; `bounds` are the map's."""

    what: str
    bounds: Bounds
    window: CellWindow
    """The cells that it may reach; may be empty."""


class Placed(Protocol):
    """A file's knowledge laid upon a lattice."""

    def extents(self) -> Sequence[Extent]: ...

    def values(self, key: TileKey) -> Floats:
        """(P, T²) of PROPERTIES in their order, at the centres of a tile's cells, NaN where the file says nothing."""


class PriorSource(Protocol):
    @property
    def crs(self) -> str | None:
        """That of its coordinates; None: it states none, and they are taken to be the map's."""

    def bounds(self) -> Bounds:
        """In its own CRS."""

    def placed(self, lattice: Lattice) -> Placed:
        """Raises InputError, with the file's name, for what has no place there."""
