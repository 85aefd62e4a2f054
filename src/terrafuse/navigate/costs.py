"""A map as a robot's costs: what can't be entered, and what each metre of the rest costs it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from terrafuse import views
from terrafuse.errors import InputError
from terrafuse.kernels.distance import squared_distance
from terrafuse.lattice import Lattice
from terrafuse.models.layers import layers_of
from terrafuse.navigate.robot import Robot
from terrafuse.replica import Replica
from terrafuse.types import Array, Bounds, Floats

FREE = 100
"""Cost of a cell of free ground, in any direction: prices count in hundredths."""
OBSTACLE, UNKNOWN, TOO_NEAR = 0, -1, -2
"""Costs of cells that the robot's centre can't enter: obstacles, what nobody saw (where that is forbidden), and what is
nearer to an obstacle than the robot is wide."""

MAX_CELLS = 2**26
"""Of a plan's window. At about 30 bytes a cell: 2 GB."""
STRIP = 256
"""Rows that are priced at once, which bounds what arithmetic on whole arrays takes on top."""
AT_LEAST = 1e-9
"""A robot fits where there is as much room as it needs, whatever rounding says."""


@dataclass(frozen=True, eq=False)
class CostMap:
    """`costs` (H, W) int16, [j, i], are those of the cells from (i0, j0) of the lattice on.

    Over 0 a cell can be entered and a metre in it costs costs/FREE metres of free ground; else it says why not.
    """

    costs: Array
    unknown: Array
    """(H, W) bool: which cells nobody saw, whatever they cost."""
    lattice: Lattice
    i0: int
    j0: int

    def cell_at(self, east_m: float, north_m: float) -> tuple[int, int]:
        """(i, j) in this window of the cell that holds a place; it may lie outside."""
        i, j = (math.floor(coordinate_m * self.lattice.cells_per_m) for coordinate_m in (east_m, north_m))
        return i - self.i0, j - self.j0

    def centres(self, cells: Array) -> Floats:
        """East and north, (N, 2) metres, of cells (N, 2) of this window."""
        return np.asarray(self.lattice.cell_centre(cells + np.array([self.i0, self.j0])))


def cost_map(replica: Replica, robot: Robot, bounds: Bounds | None = None) -> CostMap:
    """The robot's costs within bounds, or of all that is known; obstacles beyond the edge count too.

    Raises InputError for an empty map, for too many cells, and for a robot with a `max_slope` on a map that knows
    no slopes.
    """
    window = views.window_of(replica, bounds)
    r = replica.lattice.resolution_m
    around = math.ceil((robot.radius_m + robot.keep_away_m) / r) + 1
    i0, j0, i1, j1 = wider = window[0] - around, window[1] - around, window[2] + around, window[3] + around
    if (i1 - i0) * (j1 - j0) > MAX_CELLS:
        raise InputError(
            f"a plan over {i1 - i0}×{j1 - j0} cells would take too much memory; give bounds of at most "
            f"{math.isqrt(MAX_CELLS) * r:g} × {math.isqrt(MAX_CELLS) * r:g} m around the way"
        )
    layer = replica.model.occupied
    occupied = views.mosaic(replica, [layer], wider)[layer.name]
    slope = None if robot.max_slope is None else _slope(replica, occupied, wider)
    costs = priced(occupied, slope, robot, r)
    inside = slice(around, -around), slice(around, -around)
    return CostMap(costs[inside].copy(), np.isnan(occupied[inside]), replica.lattice, *window[:2])


def _slope(replica: Replica, occupied: Floats, window: views.CellWindow) -> Floats:
    """How steep the ground is: by its gradients, or no steeper than what makes it so rough; NaN where unknown."""
    model, layers = replica.model, layers_of(replica.model)
    if {"gradient_x", "gradient_y"} <= layers.keys():
        values = views.mosaic(replica, [layers["gradient_x"], layers["gradient_y"]], window)
        return np.hypot(values["gradient_x"], values["gradient_y"])
    if "impassable_roughness" in model.settings():
        return np.asarray(np.sqrt(model.settings()["impassable_roughness"] * occupied))  # of a² + b² + χ²
    raise InputError(f"the model '{model.name}' knows no slopes; leave the robot's max_slope out")


def priced(occupied: Floats, slope: Floats | None, robot: Robot, resolution_m: float) -> Array:
    """Costs (H, W) int16 of cells that are so surely occupied, 0 to 1, NaN unknown, and so steep.

    A cell is too near where the centre of an obstacle is nearer than the robot's radius and half a cell. Else a metre
    costs 1 + occupied_price · max(0, 2p/occupied_from - 1) (unknown: unknown_price, or 1) + keep_away_price · n, where
    n falls from 1, where the robot just fits, to 0, keep_away_m further away.
    """
    obstacle = occupied >= robot.occupied_from
    if slope is not None and robot.max_slope is not None:
        obstacle |= slope > robot.max_slope
    square = squared_distance(obstacle)
    costs = np.empty(occupied.shape, np.int16)
    for first in range(0, len(costs), STRIP):
        rows = slice(first, first + STRIP)
        gap_m = np.sqrt(square[rows]) * resolution_m - 0.5 * resolution_m - robot.radius_m
        price = _ground(occupied[rows], robot) + robot.keep_away_price * _nearness(gap_m, robot)
        costs[rows] = np.rint(FREE * price)
        if robot.unknown == "forbid":
            costs[rows][np.isnan(occupied[rows])] = UNKNOWN
        costs[rows][gap_m < -AT_LEAST] = TOO_NEAR
    costs[obstacle] = OBSTACLE
    return costs


def _ground(occupied: Floats, robot: Robot) -> Floats:
    # From half of the threshold on: else ground seen once or twice would be dearer than what nobody saw.
    known = 1.0 + robot.occupied_price * np.clip(2.0 * occupied / robot.occupied_from - 1.0, 0.0, 1.0)
    return np.where(np.isnan(occupied), robot.unknown_price if robot.unknown == "avoid" else 1.0, known)


def _nearness(gap_m: Floats, robot: Robot) -> Floats:
    if robot.keep_away_m == 0:
        return np.zeros_like(gap_m)
    return np.asarray(np.clip(1.0 - gap_m / robot.keep_away_m, 0.0, 1.0))
