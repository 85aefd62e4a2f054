"""A delta: the cells of one robot that changed since a revision, as absolute states. Applying one twice, late or out of
order is harmless: of two states of a cell, the one with the newer revision counts."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from terrafuse.errors import DeltaError
from terrafuse.kernels import content
from terrafuse.lattice import MAX_CELL, Lattice
from terrafuse.tile import opaque
from terrafuse.types import Array, Stamp, TileKey

MAX_NAME = 200
MAX_REVISION = 2**32 - 1


def is_robot_name(name: str) -> bool:
    return 0 < len(name) <= MAX_NAME and name.isprintable()


@dataclass(frozen=True)
class MapId:
    """Which map a delta belongs to. Contributions meet only where all of it is equal."""

    model: str
    resolution_m: float
    tile_m: float
    crs: str | None = None

    @property
    def lattice(self) -> Lattice:
        return _lattice(self.resolution_m, self.tile_m, self.crs)


@lru_cache(64)
def _lattice(resolution_m: float, tile_m: float, crs: str | None) -> Lattice:
    return Lattice(resolution_m, tile_m, crs)


def map_id(model: str, lattice: Lattice) -> MapId:
    return MapId(model, lattice.resolution_m, lattice.tile_m, lattice.crs)


@dataclass(frozen=True, eq=False)
class TileCells:
    """Some cells of one tile: `at` (K,) int32 flat positions j·tile_cells + i, rising; `cells` (K,) model records."""

    key: TileKey
    at: Array
    cells: Array

    @classmethod
    def with_newest(cls, key: TileKey, at: Array, cells: Array, newest: tuple[int, Stamp]) -> TileCells:
        """For who has just seen all cells."""
        tile = cls(key, at, cells)
        vars(tile)["newest"] = newest
        return tile

    @cached_property
    def newest(self) -> tuple[int, Stamp]:
        """The largest revision, and the largest stamp, of its cells."""
        revision, stamp = content.newest_of(self.cells["revision"], self.cells["stamp"])
        return int(revision), int(stamp)


@dataclass(frozen=True, eq=False)
class Delta:
    """What `robot` changed after revision `since`, up to `revision`; `stamp_ns` is that of its newest scan."""

    map: MapId
    robot: str
    since: int
    revision: int
    stamp_ns: Stamp
    tiles: tuple[TileCells, ...]

    @property
    def identity(self) -> tuple[str, int, int, str]:
        """Equal for a delta and its duplicate, and for nothing else."""
        content = hashlib.blake2b(digest_size=16)
        for tile in self.tiles:
            content.update(np.array([*tile.key, len(tile.at)], "<i8").tobytes())
            content.update(tile.at.tobytes())
            content.update(tile.cells.tobytes())
        return self.robot, self.since, self.revision, content.hexdigest()

    @property
    def cell_count(self) -> int:
        return sum(len(tile.at) for tile in self.tiles)


def check_content(delta: Delta) -> None:
    """Raise DeltaError for what no mapper makes: a message may say anything, and one bad cell would stay for good."""
    check_outline(delta)
    check_cells(delta)


def check_outline(delta: Delta) -> None:
    """`check_content`, of all but the cells."""
    if not is_robot_name(delta.robot):
        raise DeltaError(f"robot {delta.robot!r}: a name has 1 to {MAX_NAME} printable characters")
    if not 0 <= delta.since <= delta.revision <= MAX_REVISION or not 0 <= delta.stamp_ns < 2**63:
        raise DeltaError(f"impossible revisions {delta.since} to {delta.revision} or stamp {delta.stamp_ns}")
    most = MAX_CELL // delta.map.lattice.tile_cells
    before: TileKey | None = None
    for tile in delta.tiles:
        key = tile.key
        if before is not None and before >= key:
            raise DeltaError("tiles that do not rise")
        if not -most <= key.x <= most or not -most <= key.y <= most or key.level != 0:
            raise DeltaError(f"tile {tuple(key)} is not on the lattice (levels other than 0 are not exchanged yet)")
        before = key


def check_cells(delta: Delta) -> None:
    """`check_content`, of the cells. All at once: which tile is at fault is asked only where one is."""
    for tile in delta.tiles:
        if len(tile.at) != len(tile.cells) or not len(tile.at):
            raise DeltaError(f"tile {tuple(tile.key)} has {len(tile.at)} positions for {len(tile.cells)} cells")
    if delta.tiles and _flaw(*_together(delta.tiles), delta):
        for tile in delta.tiles:
            if flaw := _flaw(*_together([tile]), delta):
                raise DeltaError(f"tile {tuple(tile.key)} has {flaw}")


def together(cells: Sequence[Array]) -> Array:
    """Some tiles' cells, (K,) each, one after the other."""
    if len(cells) == 1:
        return cells[0]
    return np.concatenate([opaque(some) for some in cells]).view(cells[0].dtype)


def _together(tiles: Sequence[TileCells]) -> tuple[Array, Array, Array]:
    """Where tiles begin, and the positions and cells of all."""
    starts = np.cumsum([0, *(len(tile.at) for tile in tiles[:-1])])
    return starts, np.concatenate([tile.at for tile in tiles]), together([tile.cells for tile in tiles])


def _flaw(starts: Array, at: Array, cells: Array, delta: Delta) -> str | None:
    side = delta.map.lattice.tile_cells
    flaw = content.flaw_of(starts, at, cells["revision"], cells["stamp"], side * side, delta.revision)
    return {
        content.POSITIONS: "positions that do not rise within it",
        content.REVISIONS: f"cells of revisions outside 1 to {delta.revision}: newer than the delta, or none",
        content.STAMPS: "cells from before 1970",
    }.get(flaw)
