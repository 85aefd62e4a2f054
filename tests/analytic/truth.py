"""How far a map is from the analytic world."""

from __future__ import annotations

import math

import numpy as np

from terrafuse.errors import InputError
from terrafuse.replica import Replica
from terrafuse.testing.analytic.scene import Scene, covered, truth
from terrafuse.testing.analytic.world import SCENE
from terrafuse.types import Array, Floats
from terrafuse.views import chosen_layers, mosaic, window_of

GHOST_M = 0.1
"""Open ground that the map has higher than this above the truth is a ghost."""
CLOSE_M = 0.05
WALL_M = 0.3
"""A cell on a wall that the map has lower than this above its foot has lost the wall."""
SPREAD_M = 0.06
"""Three sigma of the range: so far beside a wall do points of it lie."""


def compare(replica: Replica, scene: Scene = SCENE) -> dict[str, int | float]:
    """The map's `height` against the truth of what stands for good, over the observed cells.

    Errors are of the cells that lie wholly on the ground or wholly on a box's top; those on walls, which have no one
    height, are counted apart. Metres and plain numbers. Raises InputError for a map that shows nothing of the scene.
    """
    window = window_of(replica, None)
    lattice = replica.lattice
    height = mosaic(replica, chosen_layers(replica, ["height"]), window)["height"]
    margin_m = lattice.resolution_m * math.sqrt(0.5) + SPREAD_M
    known, near = ~np.isnan(height), covered(scene, lattice, window, margin_m)
    on_wall = known & near & ~covered(scene, lattice, window, -margin_m)
    error = height - truth(scene, lattice, window)
    foot = truth(Scene(scene.ground), lattice, window)
    return {
        "cells": int(known.sum()),
        **_errors(error[known & ~on_wall]),
        "ghost_cells": int((error[known & ~near] > GHOST_M).sum()),
        **_walls(height[on_wall] - foot[on_wall]),
    }


def _errors(error: Floats) -> dict[str, int | float]:
    if not len(error):
        raise InputError("the map shows no cell of the scene but walls; is it a map of this scene?")
    size = np.abs(error)
    return {
        "flat_cells": len(size),
        "median_error_m": float(np.median(size)),
        "rmse_m": float(np.sqrt(np.mean(size**2))),
        "error_95_m": float(np.percentile(size, 95)),
        "within_5_cm": float(np.mean(size <= CLOSE_M)),
    }


def _walls(above_foot: Array) -> dict[str, int | float]:
    return {"wall_cells": len(above_foot), "wall_cells_up": int((above_foot > WALL_M).sum())}
