"""How the map grows: shares of the streets that are mapped, and heights against the truth, as time goes by."""

from __future__ import annotations

from typing import Any

import numpy as np

from terrafuse import views
from terrafuse.models.layers import layers_of
from terrafuse.simulate import truth
from terrafuse.simulate.mission.engine import Mission
from terrafuse.simulate.mission.measures import Truth, error_facts, without_prior
from terrafuse.types import Array, Floats

RARELY = 6
"""The station's map is looked at for so many rows once: it is folded for that."""
HOUSE_SHARE = 0.5
"""A coarse cell is a building's if so much of it is."""


class Timeline:
    """A watcher: a row each `frame_s`, of plain numbers by name.

    Each sixth row has what is at the station, too, and heights where the model has them; unless `at_station` is False.
    """

    def __init__(self, mission: Mission, at_station: bool = True) -> None:
        self._asks_station = at_station
        self.rows: list[dict[str, Any]] = []
        self._next_s = 0.0
        lattice = mission.coarse_lattice
        self._window = lattice.cell_window(mission.world.bounds)
        self._streets = truth.streets(mission.world, lattice, self._window)
        self._has_heights = "height" in layers_of(mission.model)
        if self._has_heights:
            self._height, self._houses = coarse_truth(mission, self._window)

    def __call__(self, mission: Mission) -> None:
        if mission.now_s + 1e-9 < self._next_s:
            return
        self._next_s += mission.scenario.frame_s
        row: dict[str, Any] = {
            "time_s": round(mission.now_s, 3),
            "mapped_share": self._share(self._by_robots(mission)),
        }
        if self._asks_station and len(self.rows) % RARELY == 0:
            row["mapped_share_at_station"] = self._share(self._at_station(mission))
            row |= self._heights(mission)
        self.rows.append(row)
        stop = mission.scenario.stop_mapped_share
        if stop is not None and row["mapped_share"] >= stop:
            mission.stop()

    def reached_s(self, share: float) -> float | None:
        """The first time at which robots together had mapped so much of the streets."""
        return next((float(row["time_s"]) for row in self.rows if row["mapped_share"] >= share), None)

    def _share(self, seen: Array) -> float:
        return float((seen & self._streets).sum() / max(self._streets.sum(), 1))

    def _by_robots(self, mission: Mission) -> Array:
        """Coarse cells that any robot has on its own map, reported or not."""
        i0, j0, i1, j1 = self._window
        out = np.zeros((j1 - j0, i1 - i0), bool)
        side = mission.coarse_lattice.tile_cells
        for vehicle in mission.vehicles:
            for tile in vehicle.node.own.delta(0).tiles:
                j, i = np.divmod(tile.at, side)
                i, j = i + tile.key.x * side - i0, j + tile.key.y * side - j0
                inside = (i >= 0) & (j >= 0) & (i < out.shape[1]) & (j < out.shape[0])
                out[j[inside], i[inside]] = True
        return out

    def _at_station(self, mission: Mission) -> Array:
        replica = without_prior(mission.station.replica)
        cells = views.cells_in(replica, self._window, frozenset(replica.keys))
        return np.asarray(replica.model.known(cells))

    def _heights(self, mission: Mission) -> dict[str, Any]:
        """RMSE over building cells of the station's map: of all that it has, the prior's too, and of what was seen."""
        if not self._has_heights or not self._houses.any():
            return {}
        out: dict[str, Any] = {}
        for name, replica in (("map", mission.station.replica), ("seen", without_prior(mission.station.replica))):
            layer = layers_of(replica.model)["height"]
            errors = views.mosaic(replica, [layer], self._window)[layer.name] - self._height
            facts = error_facts(errors, self._houses)
            out |= {f"building_rmse_{name}_m": facts["rmse_m"], f"building_cells_{name}": facts["cells"]}
        return out


def coarse_truth(mission: Mission, window: views.CellWindow) -> tuple[Floats, Array]:
    """Mean true height of each coarse cell, and which are a building's."""
    k = mission.scenario.map.global_factor
    known = Truth(mission.world, mission.lattice, finer(window, k))
    return blocks(known.height, k).mean(axis=(1, 3)), blocks(known.houses, k).mean(axis=(1, 3)) >= HOUSE_SHARE


def finer(window: views.CellWindow, k: int) -> views.CellWindow:
    """The same window in cells a k-th as large."""
    i0, j0, i1, j1 = window
    return i0 * k, j0 * k, i1 * k, j1 * k


def blocks(values: Array, k: int) -> Array:
    """(H, W) values as (H/k, k, W/k, k): of each coarse cell those within."""
    rows, columns = values.shape
    return values.reshape(rows // k, k, columns // k, k)
