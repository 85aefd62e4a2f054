"""How far a map is from the truth: heights, obstacles, gaps, ghosts, and whether sure cells err less."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from terrafuse import views
from terrafuse.lattice import Lattice
from terrafuse.models.layers import layers_of
from terrafuse.prior import ROBOT as PRIOR
from terrafuse.replica import Replica
from terrafuse.simulate import truth
from terrafuse.simulate.world import World
from terrafuse.types import Array, Floats

BAND_M = (0.3, 1.8)
"""What stands at these heights above the ground is in a robot's way."""
GHOST_M = 0.5
"""What a map has higher than anything around the place truly is, is a ghost."""
OCCUPIED_FROM = 0.65
CONFIDENCE = "confidence"


@dataclass(frozen=True, eq=False)
class Truth:
    """The world at a lattice, over a window of cells; worked out where it is asked for."""

    world: World
    lattice: Lattice
    window: views.CellWindow

    @cached_property
    def height(self) -> Floats:
        return truth.height(self.world, self.lattice, self.window)

    @cached_property
    def houses(self) -> Array:
        return truth.footprints(self.world, self.lattice, self.window)

    @cached_property
    def streets(self) -> Array:
        return truth.streets(self.world, self.lattice, self.window)

    @cached_property
    def obstacles(self) -> Array:
        return truth.occupied(self.world, self.lattice, self.window, BAND_M)


def truth_of(world: World, lattice: Lattice) -> Truth:
    """The truth of all of a world."""
    return Truth(world, lattice, lattice.cell_window(world.bounds))


def truth_under(world: World, replica: Replica) -> Truth:
    """The truth where a map knows anything, and a cell around."""
    i0, j0, i1, j1 = views.known_window(replica) or (0, 0, 1, 1)
    return Truth(world, replica.lattice, (i0 - 1, j0 - 1, i1 + 1, j1 + 1))


def height_errors(replica: Replica, known: Truth) -> Floats:
    """(H, W): the map's height less the true one; NaN where the map has none."""
    layer = layers_of(replica.model)["height"]
    return views.mosaic(replica, [layer], known.window)[layer.name] - known.height


def error_facts(errors: Floats, where: Array | None = None) -> dict[str, Any]:
    """RMSE, bias, median of what is off, number of cells."""
    some = errors[np.isfinite(errors) if where is None else np.isfinite(errors) & where]
    if not len(some):
        return {"cells": 0, "rmse_m": None, "bias_m": None, "median_abs_m": None}
    return {
        "cells": len(some),
        "rmse_m": float(np.sqrt((some**2).mean())),
        "bias_m": float(some.mean()),
        "median_abs_m": float(np.median(np.abs(some))),
    }


def measures(replica: Replica, known: Truth) -> dict[str, Any]:
    """All that can be said of a map, whose robots' cells count and not the prior's; plain JSON."""
    layers = layers_of(replica.model)
    occupied = views.mosaic(replica, [replica.model.occupied], known.window)[replica.model.occupied.name]
    out: dict[str, Any] = {"obstacles": obstacle_facts(occupied, known.obstacles)}
    seen = np.isfinite(occupied)
    if known.streets.any():
        out["street_cells_seen"] = int((seen & known.streets).sum())
    if "height" in layers:
        errors = height_errors(replica, known)
        out["height"] = error_facts(errors)
        out["height_of_buildings"] = error_facts(errors, known.houses)
        out["height_of_streets"] = error_facts(errors, known.streets)
        out["ghost_cells"] = int(ghosts(errors, known.height).sum())
        if CONFIDENCE in layers:
            confidence = views.mosaic(replica, [layers[CONFIDENCE]], known.window)[CONFIDENCE]
            out["rmse_by_confidence_third_m"] = calibration(beyond(errors, known.height), confidence)
    return out


def obstacle_facts(occupied: Floats, true: Array) -> dict[str, int]:
    """Cells of obstacles that the map claims where none is within a cell, and that it calls free, with none within a
    cell, where one stands."""
    claimed = np.nan_to_num(occupied) >= OCCUPIED_FROM
    free = occupied < OCCUPIED_FROM
    return {
        "claimed": int(claimed.sum()),
        "false": int((claimed & ~wider(true)).sum()),
        "seen": int((true & np.isfinite(occupied)).sum()),
        "missed": int((true & free & ~wider(claimed)).sum()),
    }


def ghosts(errors: Floats, height: Floats) -> Array:
    """Cells that are higher in the map than anything stands within a cell of them."""
    highest = _highest(np.nan_to_num(height, nan=-np.inf))
    return np.asarray(np.nan_to_num(errors + height, nan=-np.inf) > highest + GHOST_M)


def beyond(errors: Floats, height: Floats) -> Floats:
    """(H, W): how far the map is above or below all that is truly within a cell of the place; 0 between. In a cell that
    a wall goes through, its top is as true as its foot."""
    claimed = errors + height
    high = _highest(np.nan_to_num(height, nan=-np.inf))
    low = -_highest(np.nan_to_num(-height, nan=-np.inf))
    return np.asarray(np.where(np.isfinite(claimed), claimed - np.clip(claimed, low, high), np.nan))


def calibration(errors: Floats, confidence: Floats) -> list[float]:
    """RMSE of the least sure third of the cells, the middle one, the surest."""
    both = np.isfinite(errors) & np.isfinite(confidence)
    order = np.argsort(confidence[both], kind="stable")
    return [float(np.sqrt((part**2).mean())) for part in np.array_split(errors[both][order], 3) if len(part)]


def without_prior(replica: Replica) -> Replica:
    """The same map of what robots saw alone."""
    return Replica(store=replica.store, without=[PRIOR])


def wider(mask: Array) -> Array:
    """And the eight cells around each."""
    return np.asarray(_highest(mask.astype(np.float64)) > 0)


def _highest(values: Floats) -> Floats:
    """(H, W): the largest of each cell and its eight neighbours."""
    padded = np.pad(values, 1, mode="edge")
    rows, columns = values.shape
    return np.asarray(np.max([padded[j : j + rows, i : i + columns] for j in range(3) for i in range(3)], axis=0))
