"""python -m bench.plan [--json FILE] [--side N] [--reference-problems N]

Planning: cells taken a second, and the time of whole plans. On the benchmark maps of movingai.com (needs
TERRAFUSE_RECORDINGS) all problems, the longest of each map, and some of them by the reference in Python; on an invented
field of rough ground with obstacles also what comes before a plan: the distances to obstacles and the costs.
"""

from __future__ import annotations

import os
import platform
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from tests.navigate.movingai import Problem, scenarios

from bench.__main__ import best
from bench.report import parser, tell
from terrafuse.kernels.astar import cheapest_way_reference
from terrafuse.kernels.distance import squared_distance
from terrafuse.navigate import Robot, plan
from terrafuse.navigate.costs import priced
from terrafuse.types import Array

ROBOT = Robot(radius_m=0.2)
RESOLUTION_M = 0.1


def benchmark(costs: Array, problems: list[Problem], by_reference: int) -> dict[str, Any]:
    """All problems of a map; then, spread over them, some by the reference and by us."""
    started = perf_counter()
    plans = [plan(costs, problem.start, problem.goal) for problem in problems]
    seconds = perf_counter() - started
    longest = max(problems, key=lambda problem: problem.length)
    some = problems[:: max(1, len(problems) // by_reference)][:by_reference]
    return {
        "problems": len(problems),
        "cells": costs.size,
        "seconds": round(seconds, 3),
        "million_cells_taken_per_second": round(sum(p.expanded for p in plans) / seconds / 1e6, 2),
        "largest_error_of_length": max(abs(p.cost - q.length) for p, q in zip(plans, problems, strict=True)),
        "longest": longest_one(costs, longest),
        "reference / ours": round(ratio(costs, some), 1),
    }


def longest_one(costs: Array, problem: Problem) -> dict[str, Any]:
    found = plan(costs, problem.start, problem.goal)
    seconds = best(lambda: plan(costs, problem.start, problem.goal))
    return {"length": problem.length, "cells_taken": found.expanded, "milliseconds": round(1e3 * seconds, 3)}


def ratio(costs: Array, problems: list[Problem]) -> float:
    """How much longer the reference takes."""

    def theirs() -> None:
        for problem in problems:
            cheapest_way_reference(costs, problem.start, problem.goal)

    def ours() -> None:
        for problem in problems:
            plan(costs, problem.start, problem.goal)

    return best(theirs, 1) / best(ours)


def field(side: int) -> Array:
    """How surely each cell is occupied: rough ground with discs on it, the same for the same side."""
    rng = np.random.default_rng(0)
    occupied = rng.uniform(0.0, 0.4, (side, side))
    j, i = np.ogrid[-20:21, -20:21]
    for x, y, radius in zip(
        *rng.integers(21, side - 21, (2, side * side // 4000)), rng.uniform(2, 20, side**2), strict=False
    ):
        part = occupied[y - 20 : y + 21, x - 20 : x + 21]
        part[i * i + j * j <= radius * radius] = 1.0
    return occupied


def rough(side: int) -> dict[str, Any]:
    """From corner to corner of the field."""
    occupied = field(side)
    obstacle = occupied >= ROBOT.occupied_from
    costs = priced(occupied, None, ROBOT, RESOLUTION_M)
    start, goal = ((int(i), int(j)) for j, i in np.argwhere(costs > 0)[[0, -1]])
    found = plan(costs, start, goal)
    seconds = {
        "distances": best(lambda: squared_distance(obstacle)),
        "costs, distances included": best(lambda: priced(occupied, None, ROBOT, RESOLUTION_M)),
        "plan": best(lambda: plan(costs, start, goal)),
    }
    return {
        "cells": side * side,
        "cells_taken": found.expanded,
        "million_cells_taken_per_second": round(found.expanded / seconds["plan"] / 1e6, 2),
        "milliseconds": {name: round(1e3 * taken, 1) for name, taken in seconds.items()},
    }


def measure(side: int, by_reference: int) -> dict[str, Any]:
    figures: dict[str, Any] = {
        "machine": f"{platform.machine()}, Python {platform.python_version()}, NumPy {np.__version__}",
        "field": rough(side),
    }
    recordings = os.environ.get("TERRAFUSE_RECORDINGS")
    for name, costs, problems in scenarios(Path(recordings)) if recordings else ():
        figures[name] = benchmark(costs, problems, by_reference)
    return figures


def main() -> None:
    arguments_of = parser(__doc__)
    arguments_of.add_argument("--side", type=int, default=2000, help="cells along a side of the field, at least 100")
    arguments_of.add_argument("--reference-problems", type=int, default=20, help="of each map, solved in Python too")
    arguments = arguments_of.parse_args()
    tell(measure(arguments.side, arguments.reference_problems), arguments.json)


if __name__ == "__main__":
    main()
