"""A delta: the cells of one robot that changed since a revision, as absolute states. Applying one twice, late or out of
order is harmless: of two states of a cell, the one with the newer revision counts."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from terrafuse.errors import DeltaError
from terrafuse.lattice import MAX_CELL, Lattice
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
        return Lattice(self.resolution_m, self.tile_m, self.crs)


def map_id(model: str, lattice: Lattice) -> MapId:
    return MapId(model, lattice.resolution_m, lattice.tile_m, lattice.crs)


@dataclass(frozen=True, eq=False)
class TileCells:
    """Some cells of one tile: `at` (K,) int32 flat positions j·tile_cells + i, rising; `cells` (K,) model records."""

    key: TileKey
    at: Array
    cells: Array


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
    if not is_robot_name(delta.robot):
        raise DeltaError(f"robot {delta.robot!r}: a name has 1 to {MAX_NAME} printable characters")
    if not 0 <= delta.since <= delta.revision <= MAX_REVISION or not 0 <= delta.stamp_ns < 2**63:
        raise DeltaError(f"impossible revisions {delta.since} to {delta.revision} or stamp {delta.stamp_ns}")
    if any(one.key >= following.key for one, following in pairwise(delta.tiles)):
        raise DeltaError("tiles that do not rise")
    side = delta.map.lattice.tile_cells
    for tile in delta.tiles:
        _check_tile(tile, side, delta.revision)


def _check_tile(tile: TileCells, side: int, revision: int) -> None:
    where = f"tile {tuple(tile.key)}"
    if max(abs(tile.key.x), abs(tile.key.y)) * side > MAX_CELL or tile.key.level != 0:
        raise DeltaError(f"{where} is not on the lattice (levels other than 0 are not exchanged yet)")
    if len(tile.at) != len(tile.cells) or not len(tile.at):
        raise DeltaError(f"{where} has {len(tile.at)} positions for {len(tile.cells)} cells")
    if tile.at[0] < 0 or tile.at[-1] >= side * side or (np.diff(tile.at) <= 0).any():
        raise DeltaError(f"{where} has positions that do not rise within it")
    if (tile.cells["revision"] > revision).any() or (tile.cells["revision"] < 1).any():
        raise DeltaError(f"{where} has cells of revisions outside 1 to {revision}: newer than the delta, or none")
    if (tile.cells["stamp"] < 0).any():
        raise DeltaError(f"{where} has cells from before 1970")
