"""A store in memory: for replicas that need no disk, and for tests."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Hashable, Iterable
from contextlib import AbstractContextManager, nullcontext

import numpy as np

from terrafuse.exchange.delta import Delta, MapId, TileCells, map_id
from terrafuse.lattice import Lattice
from terrafuse.models.base import Model
from terrafuse.store.base import HistoryEntry, PathPoint, check_delta, identity_of, newest, sparse
from terrafuse.types import Array, Stamp, TileKey

MOST_HISTORY = 1 << 14


class MemoryStore:
    """Contributions as dense tiles; history keeps what the newest MOST_HISTORY entries say, not the cells."""

    def __init__(self, lattice: Lattice, model: Model) -> None:
        self._map = map_id(model.name, lattice)
        self._model = model
        self._tiles: dict[str, dict[TileKey, Array]] = {}
        self._paths: dict[str, dict[int, PathPoint]] = {}
        self._history: OrderedDict[tuple[str, int, int, str], HistoryEntry] = OrderedDict()
        self._accepted = 0
        self._newest: dict[str, tuple[int, Stamp]] = {}
        self._levels: dict[str, int] = {}

    @property
    def map(self) -> MapId:
        return self._map

    @property
    def model(self) -> Model:
        return self._model

    def accept(self, delta: Delta, path: Iterable[PathPoint] = (), message: bytes | None = None) -> bool:
        check_delta(delta, self._map, self._model, message)
        identity = identity_of(delta, message)
        if identity in self._history:
            return False
        tiles = self._tiles.setdefault(delta.robot, {})
        side = self._map.lattice.tile_cells
        for tile in delta.tiles:
            if tile.key not in tiles:
                tiles[tile.key] = np.zeros(side * side, self._model.cell)
            newest(tiles[tile.key], tile.at, tile.cells)
        for point in path:
            self._paths.setdefault(delta.robot, {}).setdefault(point.stamp_ns, point)
        revision, stamp_ns = self._newest.get(delta.robot, (0, 0))
        self._newest[delta.robot] = max(revision, delta.revision), max(stamp_ns, delta.stamp_ns)
        if delta.since < delta.revision:
            self._levels[delta.robot] = max(self.level(delta.robot), delta.revision)
        self._accepted += 1
        self._history[identity] = HistoryEntry(
            self._accepted,
            delta.robot,
            delta.since,
            delta.revision,
            delta.stamp_ns,
            time.time_ns(),
            delta.cell_count,
            sum(tile.cells.nbytes for tile in delta.tiles),
        )
        if len(self._history) > MOST_HISTORY:
            self._history.popitem(last=False)
        return True

    def together(self) -> AbstractContextManager[None]:
        return nullcontext()

    def version(self) -> Hashable:
        return self._accepted

    def robots(self) -> list[str]:
        return sorted(self._tiles)

    def keys(self) -> list[TileKey]:
        return sorted({key for tiles in self._tiles.values() for key in tiles})

    def revision(self, robot: str) -> int:
        return self._newest.get(robot, (0, 0))[0]

    def level(self, robot: str) -> int:
        return self._levels.get(robot, 0)

    def stamp(self, robot: str) -> Stamp:
        return self._newest.get(robot, (0, 0))[1]

    def revisions(self, robot: str) -> dict[TileKey, int]:
        return {key: int(cells["revision"].max()) for key, cells in self._tiles.get(robot, {}).items()}

    def load(self, robot: str, key: TileKey) -> TileCells | None:
        dense = self._tiles.get(robot, {}).get(key)
        return None if dense is None else TileCells(key, *sparse(dense))

    def poses(self, robot: str) -> list[PathPoint]:
        return [point for _, point in sorted(self._paths.get(robot, {}).items())]

    def history(self) -> list[HistoryEntry]:
        return list(self._history.values())
