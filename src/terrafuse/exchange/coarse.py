"""A robot's own map at a coarser lattice, as what it reports: the *patrol* paper's low-resolution map (LLRM)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from terrafuse.exchange.delta import Delta, MapId, TileCells, map_id
from terrafuse.exchange.parts import delta_since, newer
from terrafuse.tile import opaque
from terrafuse.types import Array, Stamp, TileKey

if TYPE_CHECKING:
    from terrafuse.mapper import Mapper

__all__ = ["CoarseContribution", "delta_since"]


class CoarseContribution:
    """What `mapper` holds, coarsened by `factor`: a coarse cell is the model's `coarsen` of k×k of the robot's cells.

    A replica on `map.lattice` that took its deltas in holds what `Replica(store of the fine contributions,
    factor=factor)` holds, cell for cell, revisions aside. Raises LatticeError for a factor that doesn't divide a tile.

    `once`: by tile, flat positions of coarse cells that may have been reported in an earlier life; those that are
    unknown are reported as erased (`exchange.erased`).
    """

    def __init__(self, mapper: Mapper, factor: int, once: Mapping[TileKey, Array] | None = None) -> None:
        self.robot = mapper.robot
        self.map: MapId = map_id(mapper.model.name, mapper.lattice.coarser(factor))
        self.revision = 0
        """The mapper's, as of the last `update`."""
        self.stamp_ns: Stamp = 0
        """That of the mapper's newest scan, likewise."""
        self._mapper = mapper
        self._factor = factor
        self._once = once or {}
        self._tiles: dict[TileKey, Array] = {}
        self._revisions: dict[TileKey, int] = {}

    def update(self) -> int:
        """Take in what the mapper changed since the last call; returns how many coarse cells that changed.

        These get the mapper's revision. Others keep theirs, so that what looks the same is not sent again.
        """
        touched = self._mapper.touched(self.revision)
        self.revision, self.stamp_ns = self._mapper.revision, self._mapper.stamp_ns
        return sum(self._update(key) for key in touched)

    def _update(self, key: TileKey) -> int:
        model = self._mapper.model
        coarse = self._mapper.coarse(key, self._factor).reshape(-1)
        if (held := self._tiles.get(key)) is None:
            held = self._tiles[key] = np.zeros(len(coarse), model.cell)
        known = model.known(coarse)
        told = known | (held["revision"] > 0)
        if key in self._once:
            told[self._once[key]] = True
        opaque(coarse)[~known] = np.zeros((), opaque(coarse).dtype)
        coarse["revision"] = held["revision"]
        at = np.flatnonzero(told & ((opaque(coarse) != opaque(held)) | (held["revision"] == 0)))
        if len(at):
            opaque(held)[at] = opaque(coarse)[at]
            held["revision"][at] = self._revisions[key] = self.revision
        return len(at)

    def delta(self, since: int = 0) -> Delta:
        """The coarse cells that changed after revision `since`, as absolute states, as of the last `update`."""
        keys = sorted(key for key, revision in self._revisions.items() if revision > since)
        tiles = tuple(newer(TileCells(key, *_held(self._tiles[key])), since) for key in keys)
        return Delta(self.map, self.robot, since, self.revision, self.stamp_ns, tiles)


def _held(dense: Array) -> tuple[Array, Array]:
    return np.arange(len(dense), dtype=np.int32), dense
