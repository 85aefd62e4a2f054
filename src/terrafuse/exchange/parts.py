"""Deltas out of deltas and stores: what is newer than a revision, what changed first."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from terrafuse.exchange.delta import Delta, TileCells
from terrafuse.store.base import Store
from terrafuse.tile import opaque
from terrafuse.types import Array


def delta_since(store: Store, robot: str, since: int = 0) -> Delta:
    """What a store holds of a robot that is newer than revision `since`: for passing on what others report."""
    keys = sorted(key for key, revision in store.revisions(robot).items() if revision > since)
    held = (store.load(robot, key) for key in keys)
    tiles = tuple(newer(tile, since) for tile in held if tile is not None)
    return Delta(store.map, robot, since, store.revision(robot), store.stamp(robot), tiles)


def newer(tile: TileCells, since: int) -> TileCells:
    """Of a tile's cells those that changed after revision `since`, copied."""
    return _some(tile, tile.cells["revision"] > since)


def oldest(delta: Delta, most_cells: int) -> Delta:
    """The part of a delta that changed first: as many revisions as have at most so many cells, but one at least.

    Who holds all up to `since` and takes it in holds all up to its `revision`: the delta since that is what is left.
    """
    if delta.cell_count <= most_cells:
        return delta
    revisions = np.sort(np.concatenate([tile.cells["revision"] for tile in delta.tiles]))
    whole = np.searchsorted(revisions, revisions[most_cells]) or np.searchsorted(revisions, revisions[0], "right")
    until = int(revisions[whole - 1])
    if until == revisions[-1]:
        return delta
    some = (_some(tile, tile.cells["revision"] <= until) for tile in delta.tiles)
    tiles = tuple(tile for tile in some if len(tile.at))
    stamp_ns = max(int(tile.cells["stamp"].max()) for tile in tiles)
    return replace(delta, revision=until, stamp_ns=min(stamp_ns, delta.stamp_ns), tiles=tiles)


def _some(tile: TileCells, chosen: Array) -> TileCells:
    return TileCells(tile.key, tile.at[chosen], opaque(tile.cells)[chosen].view(tile.cells.dtype))
