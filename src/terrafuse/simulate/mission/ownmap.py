"""What a robot plans on: its own map as it is now, with what was known beforehand, over the others' coarse map.

Its own map and the prior say where it can't go. The global map is too coarse for that, a house's edge closes 5 m of
street; it says which ways are dear.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np

from terrafuse import views
from terrafuse.exchange.delta import MapId, TileCells, map_id
from terrafuse.mapper import Mapper
from terrafuse.models.base import Model
from terrafuse.navigate import Robot
from terrafuse.navigate.costs import CostMap, cost_map
from terrafuse.replica import Replica
from terrafuse.store.base import Store
from terrafuse.types import Array, Bounds, Stamp, TileKey

GLOBAL_FROM = 0.65
"""Coarse cells that are occupied so surely are dear."""
GLOBAL_PRICE = 2.0
"""Times what they would cost."""


class LiveStore:
    """What mappers hold now, and the prior, as a store that a replica can read. Nothing is copied but what is asked."""

    def __init__(self, mappers: Sequence[Mapper], prior: Store | None = None) -> None:
        self._mappers = {mapper.robot: mapper for mapper in mappers}
        self._prior = prior
        self._keys: dict[str, tuple[int, frozenset[TileKey]]] = {}
        self.map: MapId = map_id(mappers[0].model.name, mappers[0].lattice)
        self.model: Model = mappers[0].model

    def version(self) -> Hashable:
        return tuple(mapper.revision for mapper in self._mappers.values())

    def robots(self) -> list[str]:
        return sorted([*self._mappers, *(self._prior.robots() if self._prior else [])])

    def keys(self) -> list[TileKey]:
        several = [mapper.keys for mapper in self._mappers.values()]
        return sorted({*chain.from_iterable(several), *(self._prior.keys() if self._prior else [])})

    def stamp(self, robot: str) -> Stamp:
        return self._mappers[robot].stamp_ns if robot in self._mappers else 0

    def load(self, robot: str, key: TileKey) -> TileCells | None:
        if robot not in self._mappers:
            return self._prior.load(robot, key) if self._prior else None
        mapper = self._mappers[robot]
        if key not in self._touched(robot):
            return None
        return mapper.contribution(key)

    def _touched(self, robot: str) -> frozenset[TileKey]:
        """The mapper's tiles; sorted out once a revision."""
        revision = self._mappers[robot].revision
        if self._keys.get(robot, (-1, frozenset()))[0] != revision:
            self._keys[robot] = (revision, frozenset(self._mappers[robot].keys))
        return self._keys[robot][1]


def live(mappers: Sequence[Mapper], prior: Store | None = None, factor: int = 1) -> Replica:
    """The map that these mappers and the prior make together, at each moment, coarsened by `factor`."""
    return Replica(store=LiveStore(mappers, prior), factor=factor)  # type: ignore[arg-type]


class OwnMap:
    """Made of a robot's mapper, of the prior's store and of its replica of the global map; each may lack."""

    def __init__(self, mapper: Mapper, prior: Store | None = None, world_map: Replica | None = None) -> None:
        self._replica = live([mapper], prior)
        self._global = world_map

    def costs(self, robot: Robot, bounds: Bounds) -> CostMap:
        """Costs within bounds. What neither it nor the prior knows is priced by the robot's `unknown`."""
        costs = cost_map(self._replica, robot, bounds)
        return costs if self._global is None else _priced(costs, self._global)

    def known_share(self, bounds: Bounds) -> float:
        """Of the ground within bounds, what is on the global map, or where there is none, on its own."""
        replica = self._replica if self._global is None else self._global
        layer = replica.model.occupied
        window = replica.lattice.cell_window(bounds)
        return float(np.isfinite(views.mosaic(replica, [layer], window)[layer.name]).mean())


def _priced(costs: CostMap, world_map: Replica) -> CostMap:
    """Dearer where the global map knows of obstacles that the own map does not know."""
    rows, columns = costs.costs.shape
    factor = round(world_map.lattice.resolution_m * costs.lattice.cells_per_m)
    i, j = ((first + np.arange(count)) // factor for first, count in ((costs.i0, columns), (costs.j0, rows)))
    window = (int(i[0]), int(j[0]), int(i[-1]) + 1, int(j[-1]) + 1)
    layer = world_map.model.occupied
    occupied = views.mosaic(world_map, [layer], window)[layer.name]
    dear = (occupied >= GLOBAL_FROM)[np.ix_(j - j[0], i - i[0])] & costs.unknown & (costs.costs > 0)
    return replace(costs, costs=_times(costs.costs, dear))


def _times(costs: Array, dear: Array) -> Array:
    out = costs.astype(np.int32)
    out[dear] = (GLOBAL_PRICE * out[dear]).astype(np.int32)
    return np.minimum(out, np.iinfo(np.int16).max).astype(np.int16)
