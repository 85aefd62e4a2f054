"""Whether robots can get where their scenario sends them, asked of the truth before anything moves."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from terrafuse.errors import NoPath
from terrafuse.kernels.distance import squared_distance
from terrafuse.lattice import Lattice
from terrafuse.navigate.costs import FREE, OBSTACLE, TOO_NEAR
from terrafuse.navigate.plan import plan
from terrafuse.simulate import truth
from terrafuse.simulate.mission.measures import BAND_M
from terrafuse.simulate.world import World
from terrafuse.types import Array, Floats

CELL_M = 0.25
MOST_CELLS = 2**24
"""Larger worlds are looked at in larger cells."""
Place = tuple[float, float]


class Reach:
    """Ways of a round robot among what stands for good."""

    def __init__(self, world: World, radius_m: float, most_cells: int = MOST_CELLS) -> None:
        west, south, east, north = world.bounds
        cells = (east - west) * (north - south) / CELL_M**2
        side_m = CELL_M * 2 ** max(math.ceil(math.log2(cells / most_cells) / 2), 0)
        self._lattice = Lattice(side_m, side_m)
        self._window = self._lattice.cell_window(world.bounds)
        occupied = truth.occupied(world, self._lattice, self._window, BAND_M)
        height = truth.ground(world, self._lattice, self._window)
        # From a cell's middle to an obstacle's edge.
        near = np.sqrt(squared_distance(occupied)) * side_m - side_m / 2 < radius_m
        costs = np.where(near, TOO_NEAR, FREE)
        self._costs = np.where(occupied | np.isnan(height), OBSTACLE, costs).astype(np.int16)

    def free_places(self, near: Place | None) -> Floats:
        """(N, 2): middles of the cells that a robot can get to from the one that is nearest to a place; None: of the
        largest part of the world that hangs together."""
        parts = _parts(self._costs == FREE)
        if not parts:
            return np.empty((0, 2))
        here = max(parts, key=len) if near is None else min(parts, key=lambda cells: self._off_m(cells, near))
        return self._middles_m(here)

    def _off_m(self, cells: Array, place: Place) -> float:
        return float(np.hypot(*(self._middles_m(cells) - place).T).min())

    def _middles_m(self, cells: Array) -> Floats:
        return np.asarray(self._lattice.cell_centre(cells[:, ::-1] + self._window[:2]))

    def why_not(self, start: Place, goal: Place) -> str | None:
        """What is wrong with a goal, or None. The start counts as free."""
        (i, j), (k, m) = (self._cell(place) for place in (start, goal))
        rows, columns = self._costs.shape
        if not (0 <= k < columns and 0 <= m < rows):
            return "lies off the world"
        costs = self._costs.copy()
        costs[j, i] = FREE
        try:
            plan(costs, (i, j), (k, m))
        except NoPath as error:
            return WHY.get(str(error.facts.get("reason")), str(error))
        return None

    def _cell(self, place: Place) -> tuple[int, int]:
        i, j = (math.floor(coordinate * self._lattice.cells_per_m) for coordinate in place)
        return i - self._window[0], j - self._window[1]


def _parts(free: Array) -> list[Array]:
    """The parts that hang together by their sides, each as (K, 2) rows and columns."""
    rest = {(int(j), int(i)) for j, i in np.argwhere(free)}
    out = []
    while rest:
        part = [rest.pop()]
        for j, i in part:
            beside = {(j, i - 1), (j, i + 1), (j - 1, i), (j + 1, i)} & rest
            rest -= beside
            part += sorted(beside)
        out.append(np.array(sorted(part)))
    return sorted(out, key=lambda cells: tuple(cells[0]))


WHY = {
    "obstacle": "lies in something that stands there",
    "too_near": "is nearer to something that stands there than the robot is wide",
    "not_connected": "can't be reached: no way leads there that is as wide as the robot",
}


def first_unreachable(reach: Reach, start: Place, goals: Sequence[Place]) -> tuple[int, str] | None:
    """(number, why not) of the first of the goals, one after the other, that no way leads to."""
    here = start
    for number, goal in enumerate(goals):
        if (why := reach.why_not(here, goal)) is not None:
            return number, why
        here = goal
    return None
