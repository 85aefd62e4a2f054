"""The global map as what a station reports to robots: the fold of all contributions, in a channel of its own.

folded = GlobalMap("station", Replica(store=fine.store))
fine = Channel("fine", store, relay=True, on_change=folded.changed)
station = Courier(link, [fine, Channel("global", own=folded, near=True)])
...
folded.update(station.areas)
station.tick(now_ns)

A robot takes it into a store of its own, `Channel("global", store, near=True)`, beside its map, and reports nothing of
it. `Replica(store=store)` is then, where the robot is interested, the station's map byte for byte.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable

import numpy as np

from terrafuse.exchange.area import meets
from terrafuse.exchange.delta import Delta, TileCells, map_id
from terrafuse.exchange.parts import newer
from terrafuse.replica import Replica
from terrafuse.tile import opaque
from terrafuse.types import Array, Bounds, TileKey

MOST_TILES = 1024
"""In which nobody is interested any more."""


class GlobalMap:
    """A `Source`: global cells, each with the number of the update that changed it last. `robot` is the node's name.

    A cell that became unknown, since a robot's poses were corrected, is told as erased (`exchange.erased`): those that
    this told before, and, after a new start, all that some robot told of and does not any more.
    """

    def __init__(self, robot: str, replica: Replica) -> None:
        self.robot = robot
        self.revision = 0
        self._replica = replica
        self._tiles: dict[TileKey, TileCells] = {}
        self._revisions: dict[TileKey, int] = {}
        self._stale: set[TileKey] = set(replica.keys)

    def changed(self, robot: str, keys: Iterable[TileKey]) -> None:
        """Somebody's contribution to these tiles changed."""
        self._stale.update(keys)

    def update(self, areas: Collection[Bounds] | None = None) -> int:
        """Fold what changed, in tiles that meet one of these areas, or all; returns how many cells that changed."""
        tile_m = self._replica.lattice.tile_m
        due = sorted(key for key in self._stale if areas is None or any(meets(key, tile_m, area) for area in areas))
        self._stale.difference_update(due)
        self._make_room(areas)
        return sum(self._fold(key) for key in due)

    def _make_room(self, areas: Collection[Bounds] | None) -> None:
        """Forget tiles that nobody is interested in by now, where there are many: they are folded again, and told anew,
        when somebody is."""
        if areas is None or len(self._tiles) <= MOST_TILES:
            return
        tile_m = self._replica.lattice.tile_m
        idle = [key for key in self._tiles if not any(meets(key, tile_m, area) for area in areas)]
        self._stale.update(idle)
        for key in idle:
            del self._tiles[key], self._revisions[key]

    def delta(self, since: int) -> Delta:
        keys = sorted(key for key, revision in self._revisions.items() if revision > since)
        tiles = tuple(newer(self._tiles[key], since) for key in keys)
        map_ = map_id(self._replica.model.name, self._replica.lattice)
        return Delta(map_, self.robot, since, self.revision, self._replica.reading.now_ns, tiles)

    def _fold(self, key: TileKey) -> int:
        cells, held = self._replica.cells(key).reshape(-1), self._tiles.get(key)
        known = self._replica.model.known(cells)
        told = known.copy()
        told[self._replica.erased(key)] = True
        if held is not None:
            told[held.at] = True
        at = np.flatnonzero(told).astype(np.int32)
        fresh = opaque(cells)[at].view(cells.dtype)
        opaque(fresh)[~known[at]] = np.zeros((), opaque(fresh).dtype)
        fresh["revision"] = self.revision + 1
        changed = self._take_over(fresh, at, held)
        if changed:
            self.revision += 1
            self._revisions[key] = self.revision
            self._tiles[key] = TileCells(key, at, fresh)
        return changed

    def _take_over(self, fresh: Array, at: Array, held: TileCells | None) -> int:
        """Give cells that are as they were the revision that they had; how many others there are."""
        if held is None or not len(held.at):
            return len(at)
        where = np.searchsorted(held.at, at).clip(max=len(held.at) - 1)
        before = opaque(held.cells)[where].view(fresh.dtype)
        same = (held.at[where] == at) & (opaque(before) == opaque(_with(fresh, before["revision"])))
        fresh["revision"][same] = before["revision"][same]
        return int((~same).sum())


def _with(cells: Array, revisions: Array) -> Array:
    copy = opaque(cells).copy().view(cells.dtype)
    copy["revision"] = revisions
    return copy
