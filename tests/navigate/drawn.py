"""Maps and costs drawn with letters, rows from the north."""

from __future__ import annotations

import numpy as np

from terrafuse.exchange.delta import Delta, TileCells, map_id
from terrafuse.kernels.occupancy import CELL
from terrafuse.lattice import Lattice
from terrafuse.models import make_model
from terrafuse.replica import Replica
from terrafuse.types import Array, TileKey

SURE = 100_000
"""Ticks of log-odds: read as p = 0.9933 or 0.0067, the model's limits."""


def letters(drawing: str) -> Array:
    """(H, W) letters, [j, i]."""
    return np.array([list(line) for line in drawing.split()][::-1])


def costs(drawing: str) -> Array:
    """# is an obstacle, ? unknown and forbidden, a digit so many times free ground, . free ground."""
    prices = {"#": 0, "?": -1, ".": 100} | {str(k): 100 * k for k in range(1, 10)}
    return np.vectorize(prices.__getitem__, otypes=[np.int16])(letters(drawing))


def occupancy_map(drawing: str, resolution_m: float = 1.0, crs: str | None = None) -> Replica:
    """# is occupied, . free, ? unknown; the south-western cell is (0, 0)."""
    drawn = letters(drawing)
    lattice, model = Lattice(resolution_m, 40 * resolution_m, crs), make_model("occupancy")
    replica = Replica(lattice, model)
    replica.apply(reported(drawn, lattice, revision=1))
    return replica


def reported(drawn: Array, lattice: Lattice, revision: int) -> Delta:
    """What a robot reports that now sees this, in one tile."""
    j, i = np.nonzero(drawn != "?")
    cells = np.zeros(len(i), CELL)
    cells["sum"] = np.where(drawn[j, i] == "#", SURE, -SURE)
    cells["stamp"], cells["updates"], cells["revision"] = revision, 1, revision
    tile = TileCells(TileKey(0, 0), (j * lattice.tile_cells + i).astype(np.int32), cells)
    return Delta(map_id("occupancy", lattice), "r1", revision - 1, revision, revision, (tile,))
