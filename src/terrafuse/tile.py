"""A robot's own tile: its cell records, their revision, and what changed since."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from terrafuse.types import Array

CACHE_LINE = 64


def aligned_zeros(count: int, dtype: np.dtype[Any]) -> Array:
    """`np.zeros` that starts on a cache line, so that a 64-byte record touches one. Untouched pages take no memory."""
    raw = np.zeros(count * dtype.itemsize + CACHE_LINE, np.uint8)
    start = -raw.ctypes.data % CACHE_LINE
    return raw[start : start + count * dtype.itemsize].view(dtype)


class Tile(Protocol):
    """One tile of one robot's own map, in whatever layout its model likes; it speaks in the model's cell records.

    Positions are flat, j·tile_cells + i.
    """

    revision: int
    """Of the last scan that touched it."""

    def merge(self, at: Array, patch: Array, stamp_ns: int, revision: int) -> None:
        """Take in a patch's records at distinct positions. `revision` is larger than any before."""

    def changed(self, since: int) -> tuple[Array, Array]:
        """(positions rising, cells) of what changed after revision `since`.

        Cheap where `since` grows from call to call, as it does for whoever follows the map.
        """

    def put(self, at: Array, cells: Array) -> None:
        """Set the cells at these positions: how a tile comes back from a store."""

    @property
    def nbytes(self) -> int:
        """Bytes allocated."""


class DenseTile:
    """The plain layout: one record a cell. `merge_into(cells, at, patch, stamp_ns, revision)` is the model's rule."""

    def __init__(self, side: int, dtype: np.dtype[Any], merge_into: Any) -> None:
        self.revision = 0
        self.cells = np.zeros(side * side, dtype)
        self._merge_into = merge_into

    def merge(self, at: Array, patch: Array, stamp_ns: int, revision: int) -> None:
        self._merge_into(self.cells, at, patch, stamp_ns, revision)
        self.revision = revision

    def changed(self, since: int) -> tuple[Array, Array]:
        at = np.flatnonzero(self.cells["revision"] > since).astype(np.int32)
        return at, self.cells[at]

    def put(self, at: Array, cells: Array) -> None:
        self.cells[at] = cells
        self.revision = max(self.revision, int(cells["revision"].max(initial=0)))

    @property
    def nbytes(self) -> int:
        return int(self.cells.nbytes)
