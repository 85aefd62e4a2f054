"""A delta: the cells of one robot that changed since a revision, as absolute states. Applying one twice, late or out of
order is harmless: of two states of a cell, the one with the newer revision counts."""

from __future__ import annotations

from dataclasses import dataclass

from terrafuse.lattice import Lattice
from terrafuse.types import Array, Stamp, TileKey


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
        """Equal for a delta and its duplicate: a robot's cells at a revision are what they are."""
        return (
            self.robot,
            self.since,
            self.revision,
            " ".join("{},{},{}".format(*tile.key) for tile in self.tiles),
        )

    @property
    def cell_count(self) -> int:
        return sum(len(tile.at) for tile in self.tiles)
