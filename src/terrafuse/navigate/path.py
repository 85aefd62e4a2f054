"""A path in the world, and whether a map that has changed since still lets it through."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from terrafuse.kernels.sight import crossed
from terrafuse.navigate.costs import FREE, CostMap
from terrafuse.types import Array, Floats


@dataclass(frozen=True, eq=False)
class Path:
    """A way from the centre of the start's cell to that of the goal's, straight from waypoint to waypoint."""

    waypoints_m: Floats
    """(K, 2) east and north."""
    cells: Array
    """(N, 2) lattice cells (i, j) that it crosses, in order, each beside the one before or across a corner."""
    length_m: float
    cost_m: float
    """As many metres of free ground would cost the same."""
    unknown_m: float
    """How much of it leads through what nobody has seen."""
    expanded: int
    """Cells that the search took."""


def path_of(corners: Array, costs: CostMap, expanded: int) -> Path:
    """The path with these corners (K, 2), cells of the window."""
    cells, lengths = crossed(corners)
    i, j = cells.T
    r = costs.lattice.resolution_m
    return Path(
        waypoints_m=costs.centres(corners),
        cells=cells + np.array([costs.i0, costs.j0]),
        length_m=float(lengths.sum()) * r,
        cost_m=float((costs.costs[j, i] * lengths).sum()) * r / FREE,
        unknown_m=float(lengths[costs.unknown[j, i]].sum()) * r,
        expanded=expanded,
    )


def turns(way: Array) -> Array:
    """Of a way (N, 2) of single steps, the cells in which it begins, turns and ends."""
    steps = np.diff(way, axis=0)
    inner = 1 + np.flatnonzero((steps[1:] != steps[:-1]).any(axis=1))
    return np.asarray(way[np.unique([0, *inner, len(way) - 1])])


def first_blocked(path: Path, costs: CostMap, since: int = 0) -> int | None:
    """The first of `path.cells[since:]` that can't be entered, or not without cutting a corner; None if all can.

    It looks at the path's cells only, so that costs of a small window around the robot will do: of cells outside it
    nothing is said.
    """
    way = path.cells[since:] - np.array([costs.i0, costs.j0])
    before = np.concatenate([way[:1], way[:-1]])
    # Of a straight step, the cells beside it are its own two.
    places = (way, np.column_stack([way[:, 0], before[:, 1]]), np.column_stack([before[:, 0], way[:, 1]]))
    blocked = np.flatnonzero(np.any([_closed(costs.costs, cells) for cells in places], axis=0))
    return since + int(blocked[0]) if len(blocked) else None


def still_good(path: Path, costs: CostMap, since: int = 0) -> bool:
    """Whether nothing blocks the rest of a path."""
    return first_blocked(path, costs, since) is None


def _closed(costs: Array, cells: Array) -> Array:
    """Which of the cells (N, 2) lie in the window and can't be entered."""
    i, j = cells.T
    inside = (i >= 0) & (j >= 0) & (i < costs.shape[1]) & (j < costs.shape[0])
    out = np.zeros(len(cells), bool)
    out[inside] = costs[j[inside], i[inside]] <= 0
    return out
