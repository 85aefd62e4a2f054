"""A replica: contributions in, the global map out.

The global map is a function of the contributions that a replica holds and of nothing else, so two replicas that hold
the same ones hold the same map, byte for byte.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterable
from typing import TYPE_CHECKING

import numpy as np

from terrafuse.errors import InputError
from terrafuse.exchange.delta import Delta, TileCells
from terrafuse.exchange.erased import erased
from terrafuse.lattice import Lattice
from terrafuse.models import make_model
from terrafuse.models.base import Model, Reading, fold
from terrafuse.store.base import Store
from terrafuse.store.memory import MemoryStore
from terrafuse.tile import opaque
from terrafuse.types import Array, Bounds, TileKey

if TYPE_CHECKING:
    import xarray

CACHED_TILES = 16


class Replica:
    """The fold of a store's contributions; in memory unless a `store` is given.

    `only` and `without` leave robots out of the map. With a `factor`, it is the global map at a coarser level: each
    robot's contribution is coarsened by it, as the robot itself would report it, and these are folded.
    """

    def __init__(
        self,
        lattice: Lattice | None = None,
        model: Model | None = None,
        *,
        store: Store | None = None,
        only: Collection[str] | None = None,
        without: Collection[str] = (),
        factor: int = 1,
    ) -> None:
        if store is None:
            if lattice is None:
                raise ValueError("give a lattice, or a store that has one")
            store = MemoryStore(lattice, model or make_model("elevation"))
        self.store: Store = store
        self.lattice = store.map.lattice.coarser(factor)
        self.model = store.model
        self._factor = factor
        self._only, self._without = only, frozenset(without)
        self._cache: dict[TileKey, Array] = {}
        self._erased: dict[TileKey, Array] = {}
        """Of tiles in the cache, which cells some robot reported once and does not any more."""
        self._version = store.version()

    def apply(self, delta: Delta) -> bool:
        """Take a robot's delta in; False if it was here already. Order, repetition and delay make no difference.

        Raises DeltaError for a delta of another map; nothing is then changed.
        """
        return self.store.accept(delta)

    @property
    def robots(self) -> list[str]:
        """The robots whose contributions make this map, sorted."""
        chosen = [name for name in self.store.robots() if self._only is None or name in self._only]
        return [name for name in chosen if name not in self._without]

    @property
    def reading(self) -> Reading:
        """What layers are read with: this lattice, and the newest stamp that any robot of the map reported."""
        return Reading(self.lattice, max(map(self.store.stamp, self.robots), default=0))

    @property
    def keys(self) -> list[TileKey]:
        """The tiles that somebody reported, sorted."""
        return self.store.keys()

    def cells(self, key: TileKey) -> Array:
        """The global cells of a tile, (T, T) records, [j, i]; unknown where nobody reported. Read-only.

        A known cell's revision is 1, whatever its robots' ones are.
        """
        version = self.store.version()
        if version != self._version:
            # whoever wrote: the map is what the store holds now
            self._cache.clear()
            self._erased.clear()
            self._version = version
        if key not in self._cache:
            while len(self._cache) >= CACHED_TILES:
                oldest = next(iter(self._cache))
                self._cache.pop(oldest)
                self._erased.pop(oldest, None)
            self._cache[key] = self._fold(key)
        return self._cache[key]

    def erased(self, key: TileKey) -> Array:
        """(K,) flat positions, rising, of a tile's cells that some robot reported and does not any more: unknown,
        unless another robot knows them."""
        self.cells(key)
        return self._erased.get(key, np.empty(0, np.int64))

    def _fold(self, key: TileKey) -> Array:
        side = self.lattice.tile_cells
        held = [part for name in self.robots if (part := self._load(name, key)) is not None]
        fused = np.zeros(side * side, self.model.cell)
        if len(held) == 1:
            opaque(fused)[held[0].at] = opaque(held[0].cells)
        elif held:
            seen = np.zeros(side * side, bool)
            for part in held:
                seen[part.at] = True
            somewhere = np.flatnonzero(seen)
            stack = [np.zeros(len(somewhere), self.model.cell) for _ in held]
            for cells, part in zip(stack, held, strict=True):
                opaque(cells)[np.searchsorted(somewhere, part.at)] = opaque(part.cells)
            opaque(fused)[somewhere] = opaque(fold(self.model, stack, self.lattice))
        # A revision counts one robot's scans: where evidence just adds, who saw what must not show in the map.
        fused["revision"] = np.minimum(fused["revision"], 1)
        fused.flags.writeable = False
        return fused.reshape(side, side)

    def _load(self, robot: str, key: TileKey) -> TileCells | None:
        """The robot's contribution to a tile, at this replica's level."""
        part = self.store.load(robot, key)
        if part is not None and (gone := erased(part.cells)).any():
            self._erased[key] = np.union1d(self._erased.get(key, np.empty(0, np.int64)), part.at[gone])
            part = TileCells(key, part.at[~gone], opaque(part.cells)[~gone].view(part.cells.dtype))
        if part is None or self._factor == 1:
            return part
        side = self.store.map.lattice.tile_cells
        fine = np.zeros(side * side, self.model.cell)
        opaque(fine)[part.at] = opaque(part.cells)
        coarse = self.model.coarsen(fine.reshape(side, side), self._factor).reshape(-1)
        at = np.flatnonzero(self.model.known(coarse)).astype(np.int32)
        return TileCells(key, at, opaque(coarse)[at].view(self.model.cell))

    def layer(self, name: str, bounds: Bounds | tuple[float, float, float, float] | None = None) -> xarray.DataArray:
        """A layer of the global map within (west, south, east, north) metres, or all of it, as an xarray.DataArray.

        Dimensions (y, x), y falling (north-up); coordinates are cell centres; unknown is NaN; the CRS is in the
        coordinate `spatial_ref` (CF grid mapping, as rioxarray and GDAL read it). Raises InputError for a layer that
        the model does not have, LatticeError for bounds without a cell.
        """
        from terrafuse.export.array import data_array

        return data_array(self, name, Bounds(*bounds) if bounds is not None else None)

    def digest(self) -> str:
        """SHA-256 of the global map's cells: equal at every node that holds the same contributions."""
        total = hashlib.sha256()
        for key in self.keys:
            cells = self.cells(key).reshape(-1)
            at = np.flatnonzero(self.model.known(cells))
            if len(at):
                total.update(np.array([*key, len(at)], "<i8").tobytes())
                total.update(at.astype("<i4").tobytes())
                total.update(cells[at].tobytes())
        return total.hexdigest()


def check_robots(store: Store, names: Iterable[str]) -> None:
    """Raise InputError for a robot that never reported to this store."""
    known = store.robots()
    for name in names:
        if name not in known:
            raise InputError(f"no robot '{name}' in this store; it has: {', '.join(known) or 'none'}")
