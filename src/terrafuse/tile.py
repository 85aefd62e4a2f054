"""A robot's own tile: its cell records, their revision, and what changed since."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from terrafuse.types import Array

CACHE_LINE = 64


def aligned_zeros(count: int, dtype: np.dtype[Any]) -> Array:
    """`np.zeros` that starts on a cache line, so that a 64-byte record touches one. Untouched pages take no memory."""
    raw = np.zeros(count * dtype.itemsize + CACHE_LINE, np.uint8)
    start = -raw.ctypes.data % CACHE_LINE
    return raw[start : start + count * dtype.itemsize].view(dtype)


def opaque(records: Array) -> Array:
    """The same records as mere bytes: NumPy copies those at once, records field by field and 8 times as slow."""
    return records.view(np.dtype((np.void, records.dtype.itemsize)))


class Tile(Protocol):
    """One tile of one robot's own map, in whatever layout its model likes; it speaks in the model's cell records.

    Positions are flat, j·tile_cells + i.
    """

    revision: int
    """Of the last scan that touched it."""

    def changed(self, since: int) -> tuple[Array, Array]:
        """(positions rising, cells) of what changed after revision `since`.

        Cheap where `since` grows from call to call, as it does for whoever follows the map.
        """

    def surface(self) -> Array:
        """Every cell, (T²,), as far as the model's `coarsen` looks at it. Read-only: it may be the tile's memory."""

    def put(self, at: Array, cells: Array) -> None:
        """Set the cells at these positions: how a tile comes back from a store."""

    @property
    def nbytes(self) -> int:
        """Bytes allocated."""


Take = Callable[[Array, Array, Array, int, int], None]
"""`take(cells, at, patch, stamp_ns, revision)`: a model's merge of a patch (K,) into cells (T²,), in place. It sets the
stamp and the revision of the cells that it changes."""


class RecordTile:
    """A tile as one array of the model's cell records: what a model needs that has no layout of its own."""

    def __init__(self, side: int, cell: np.dtype[Any], take: Take) -> None:
        self.revision = 0
        self._cells = aligned_zeros(side * side, cell)
        self._take = take

    def merge(self, at: Array, patch: Array, stamp_ns: int, revision: int) -> None:
        """Take in a patch's records (K,) at distinct positions (K,)."""
        self._take(self._cells, at, patch, stamp_ns, revision)
        self.revision = revision

    def changed(self, since: int) -> tuple[Array, Array]:
        at = np.flatnonzero(self._cells["revision"] > since).astype(np.int32)
        return at, opaque(self._cells)[at].view(self._cells.dtype)

    def surface(self) -> Array:
        return self._cells

    def put(self, at: Array, cells: Array) -> None:
        opaque(self._cells)[at] = opaque(np.ascontiguousarray(cells))
        self.revision = max(self.revision, int(cells["revision"].max(initial=0)))

    @property
    def nbytes(self) -> int:
        return int(self._cells.nbytes)
