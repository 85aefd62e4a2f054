"""Cells that are unknown again: all zero, but for the revision that made them so.

A contribution only ever gains cells, for what is not told of stays as it was. So a robot whose corrected poses leave
nothing of a cell tells of it as *erased*: a record like any other to stores, deltas and summaries, of which the newer
revision counts; who reads a map drops it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from terrafuse.exchange.delta import TileCells
from terrafuse.tile import opaque
from terrafuse.types import Array, TileKey


def erased(cells: Array) -> Array:
    """Which of (K,) cells of a contribution are, as booleans."""
    candidates = cells["stamp"] == 0
    if candidates.any():
        at = np.flatnonzero(candidates)
        bare = opaque(cells)[at].view(cells.dtype)
        bare["revision"] = 0
        candidates[at] = ~bare.view(np.uint8).reshape(len(at), -1).any(axis=1) & (cells["revision"][at] > 0)
    return np.asarray(candidates)


def observed(tile: TileCells) -> TileCells:
    """A tile without them."""
    gone = erased(tile.cells)
    if not gone.any():
        return tile
    return TileCells(tile.key, tile.at[~gone], opaque(tile.cells)[~gone].view(tile.cells.dtype))


def erasing(key: TileKey, at: Array, revision: int, cell: np.dtype[Any]) -> TileCells:
    """The cells at these positions (K,), erased by this revision."""
    cells = np.zeros(len(at), cell)
    cells["revision"] = revision
    return TileCells(key, at.astype(np.int32), cells)
