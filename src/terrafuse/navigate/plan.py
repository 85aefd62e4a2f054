"""The cheapest way from a place to another, or why there is none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from terrafuse.errors import InputError, NoPath
from terrafuse.kernels.astar import MAX_CELLS, STRAIGHT, cheapest_way
from terrafuse.kernels.sight import shortcuts
from terrafuse.navigate.costs import FREE, OBSTACLE, TOO_NEAR, UNKNOWN, CostMap, cost_map
from terrafuse.navigate.path import Path, path_of, turns
from terrafuse.navigate.robot import Robot
from terrafuse.replica import Replica
from terrafuse.types import Array, Bounds

Cell = tuple[int, int]
"""(i, j): a column and a row of costs [j, i]."""
Place = tuple[float, float]
"""East and north, metres."""
FARTHEST_M = 1e9
ROUNDING = 1e-9
"""How much more a straight line may cost than the way that it replaces, as a share."""

WHY = {
    OBSTACLE: ("obstacle", "lies in an obstacle to the robot"),
    TOO_NEAR: ("too_near", "is nearer to an obstacle than the robot's radius_m"),
    UNKNOWN: ("unknown", "is where nobody has seen anything, and the robot may not go there"),
}


@dataclass(frozen=True, eq=False)
class Plan:
    """The cheapest way over a grid."""

    cells: Array
    """(N, 2) as i, j, from start to goal, each a neighbour of the one before, by a side or a corner."""
    cost: float
    """In sides of free cells."""
    expanded: int
    """Cells that the search took."""


def plan(costs: Array, start: Cell, goal: Cell) -> Plan:
    """The cheapest way over costs (H, W) int16, [j, i]; see `CostMap` for what they mean. Raises NoPath.

    A step from a cell to a neighbour costs the mean of the two, times √2 if it is diagonal; that needs both cells
    beside it to be free. Of ways that cost the same, the one that the order of the search prefers: always the same.
    """
    if costs.dtype != np.int16 or costs.ndim != 2 or not 0 < costs.size <= MAX_CELLS:
        raise InputError(
            f"costs of shape {costs.shape} and type {costs.dtype}; give int16 in two dimensions, not empty"
        )
    return _plan(costs, start, goal, (start, goal), lambda cell: cell)


def plan_path(
    replica: Replica,
    start_m: Place,
    goal_m: Place,
    robot: Robot,
    bounds: Bounds | None = None,
    any_angle: bool = False,
) -> Path:
    """The robot's cheapest way over the map, from and to (east, north) metres, within bounds or all that is known.

    With `any_angle`, straight lines replace parts of it where they cost no more. Raises NoPath, and InputError as
    `cost_map`.
    """
    return path_between(cost_map(replica, robot, bounds), start_m, goal_m, any_angle)


def path_between(costs: CostMap, start_m: Place, goal_m: Place, any_angle: bool = False) -> Path:
    """`plan_path` over costs that are there already: to plan again, or to several goals."""

    def place(cell: Cell) -> Place:
        east_m, north_m = costs.centres(np.array([cell]))[0].round(6).tolist()
        return east_m, north_m

    if not all(abs(coordinate_m) < FARTHEST_M for coordinate_m in (*start_m, *goal_m)):
        raise InputError(f"from {start_m} to {goal_m}: give places on Earth, east and north in metres")
    start, goal = costs.cell_at(*start_m), costs.cell_at(*goal_m)
    found = _plan(costs.costs, start, goal, (start_m, goal_m), place)
    corners = found.cells[shortcuts(costs.costs, found.cells, ROUNDING)] if any_angle else turns(found.cells)
    return path_of(corners, costs, found.expanded)


def _plan(costs: Array, start: Cell, goal: Cell, ends: tuple[Place, Place], place: Callable[[Cell], Place]) -> Plan:
    """`ends` and `place` are where complaints say that start, goal and other cells are."""
    for which, cell, end in zip(("start", "goal"), (start, goal), ends, strict=True):
        _check_end(costs, which, cell, end, place)
    cells, cost, expanded = cheapest_way(costs, start, goal)
    if cost < 0:
        i, j = cells[-1].tolist()
        nearest = place((i, j))
        raise NoPath(
            f"no way leads from {_text(ends[0])} to {_text(ends[1])}; "
            f"of what can be reached, {_text(nearest)} is nearest to the goal",
            reason="not_connected",
            nearest=nearest,
        )
    return Plan(cells, cost / (2 * STRAIGHT * FREE), expanded)


def _check_end(costs: Array, which: str, cell: Cell, end: Place, place: Callable[[Cell], Place]) -> None:
    height, width = costs.shape
    if not (0 <= cell[0] < width and 0 <= cell[1] < height):
        first, last = _text(place((0, 0))), _text(place((width - 1, height - 1)))
        raise NoPath(
            f"the {which} {_text(end)} lies outside the map, whose cells go from {first} to {last}; "
            "choose another, or give bounds that hold it",
            reason="outside",
            end=which,
        )
    cost = int(costs[cell[1], cell[0]])
    if cost <= 0:
        reason, words = WHY[cost]
        free = nearest_free(costs, cell)
        remedy = f"the nearest place for it is {_text(place(free))}" if free else "there is no place for it on this map"
        facts = {"nearest": place(free)} if free else {}
        raise NoPath(f"the {which} {_text(end)} {words}; {remedy}", reason=reason, end=which, **facts)


def _text(place: Place) -> str:
    return ",".join(f"{round(coordinate, 3):.12g}" for coordinate in place)


def nearest_free(costs: Array, cell: Cell) -> Cell | None:
    """The nearest cell that can be entered; of several the southernmost, then westernmost; None if there is none."""
    j, i = np.nonzero(costs > 0)
    if not len(i):
        return None
    at = int(np.argmin((i - cell[0]) ** 2 + (j - cell[1]) ** 2))
    return int(i[at]), int(j[at])
