"""How a central station allots streets to robots: open routes that together visit all places, the longest of them as
short as can be found (a min-max problem of several travelling salesmen)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from terrafuse.errors import InputError
from terrafuse.kernels.routes import improve
from terrafuse.navigate.street_net import street_distances, way, waypoints, with_lookouts
from terrafuse.types import Array, Floats

Visit = int | tuple[int, ...]
"""A node, or several of which one will do."""

ROUNDS = 3
STEPS, MOST_STEPS = 5_000, 600_000
"""In each round, for each visit; and at most."""
NEAREST = 12
FAR_MM = 10**12
"""What no way leads to is so far away: further than any way, and still to be counted."""
GAP_M = 20.0
FIRST_M = 15.0
"""Of a route: by then it has left its start."""
SEED = 0x9E3779B97F4A7C15


def patrol(
    nodes_m: Floats, edges: Array, starts: Sequence[int], sight_m: float, right_m: float = 0.0, gap_m: float = GAP_M
) -> list[Floats]:
    """Waypoints (K, 2) for each robot from its start node on, so far to the right of the centre lines. Together they
    see all streets, up to gaps of `gap_m`, if a robot sees `sight_m` along its street, and at a node along all of its.

    Edges (E, 2) join nodes (N, 2). Raises InputError without robots, and for nodes that no robot reaches.
    """
    places, pieces, lookouts = with_lookouts(np.asarray(nodes_m, np.float64), edges, sight_m, gap_m)
    distances, next_hop = street_distances(places, pieces)
    visits: list[Visit] = [*range(len(nodes_m)), *((int(a), int(b)) for a, b in lookouts)]
    routes = allot(distances, starts, visits)
    return [
        waypoints(places, way(next_hop, [start, *route]), right_m) for start, route in zip(starts, routes, strict=True)
    ]


def nearest_takes(routes: Sequence[Floats], starts: Sequence[int], places_m: Floats) -> list[Floats]:
    """The same routes, each of those from one start node to the robot that stands nearest to its first leg, so that
    nobody has to pass the others. `places_m` (robots, 2)."""
    out = list(routes)
    for start in sorted(set(starts)):
        robots = [robot for robot, own in enumerate(starts) if own == start]
        first = np.array([along(routes[robot], FIRST_M) for robot in robots])
        apart = np.linalg.norm(places_m[robots][:, None] - first, axis=2)
        for _ in robots:
            row, column = np.unravel_index(int(apart.argmin()), apart.shape)
            out[robots[row]] = routes[robots[column]]
            apart[row], apart[:, column] = np.inf, np.inf
    return out


def along(route_m: Floats, way_m: float) -> Floats:
    """(2,): where a route (K, 2) has come to after so much of its way, or ends."""
    legs_m = np.linalg.norm(np.diff(route_m, axis=0), axis=1)
    reached_m = np.concatenate([[0.0], np.cumsum(legs_m)])
    return np.array([np.interp(way_m, reached_m, column) for column in route_m.T])


def allot(distances: Floats, starts: Sequence[int], visits: Sequence[Visit]) -> list[list[int]]:
    """For each robot the nodes that it visits, in order: for each of `visits` one, in one robot's route. A route names
    the robot's start only where that is to be visited; that of a robot too many is empty.

    `distances` (N, N) in metres, the same both ways. Of the same input the same routes, on any machine. Raises
    InputError without robots, and for visits that no robot can make.
    """
    choices = [visit if isinstance(visit, tuple) else (visit,) for visit in dict.fromkeys(visits)]
    _check(distances, starts, choices)
    options = [int(node) for nodes in (starts, *choices) for node in nodes]
    slots = np.repeat(np.arange(len(starts) + len(choices)), [1] * len(starts) + [len(nodes) for nodes in choices])
    lengths = np.rint(np.minimum(distances[np.ix_(options, options)] * 1000, FAR_MM)).astype(np.int64)
    routes = _best(lengths, slots, len(starts))
    return [[options[option] for option in route[1:]] for route in routes]


def _check(distances: Floats, starts: Sequence[int], choices: Sequence[tuple[int, ...]]) -> None:
    if not len(starts):
        raise InputError("routes for no robots: give at least one start")
    named = sorted({*starts, *(node for nodes in choices for node in nodes)})
    if outside := [node for node in named if not 0 <= node < len(distances)]:
        raise InputError(f"nodes {outside} of a net of {len(distances)}: give numbers from 0")
    reached = np.isfinite(distances[list(starts)].min(axis=0))
    if lost := [nodes for nodes in choices if not reached[list(nodes)].any()]:
        names = ", ".join(" or ".join(map(str, nodes)) or "none" for nodes in lost)
        raise InputError(f"no street leads from where robots start to nodes {names}: leave them out, or join them")


def _best(lengths: Array, slots: Array, robots: int) -> list[list[int]]:
    """Of several rounds, the routes whose longest is the shortest; then whose second longest is, and so on."""
    routes, near = _first(lengths, slots, robots), _near(lengths, slots, robots)
    if not near.shape[1]:
        return routes
    steps = min(STEPS * (int(slots[-1]) + 1), MOST_STEPS)
    found = [improve(lengths, near, slots, routes, steps, SEED + number) for number in range(ROUNDS)]
    return min(found, key=lambda routes: sorted((_length(lengths, route) for route in routes), reverse=True))


def _length(lengths: Array, route: list[int]) -> int:
    return int(lengths[route[:-1], route[1:]].sum())


def _first(lengths: Array, slots: Array, robots: int) -> list[list[int]]:
    """Each visit to a robot that starts next to it, to the one that has fewest."""
    routes = [[robot] for robot in range(robots)]
    for slot in range(robots, int(slots[-1]) + 1):
        options = np.flatnonzero(slots == slot)
        _, _, robot, option = min(
            (int(lengths[robot, option]), len(routes[robot]), robot, int(option))
            for robot in range(robots)
            for option in options
        )
        routes[robot].append(option)
    return routes


def _near(lengths: Array, slots: Array, robots: int) -> Array:
    """(options, n) the nearest options of other slots, no starts."""
    others = np.where(slots[:, None] == slots[robots:], 2 * FAR_MM, lengths[:, robots:])
    count = min(NEAREST, int((others < 2 * FAR_MM).sum(axis=1).min()))
    return np.asarray(robots + np.argsort(others, axis=1, kind="stable")[:, :count])


def least_longest_m(distances: Floats, starts: Sequence[int], visits: Sequence[int]) -> float:
    """No allotment has a longest route shorter than this: the way to the farthest visit, or an equal share of the
    least tree that joins all visits to starts."""
    nodes = sorted({*visits} - {*starts})
    if not nodes:
        return 0.0
    near = distances[np.ix_(list(starts), nodes)].min(axis=0)
    return max(float(near.max()), _tree_m(distances[np.ix_(nodes, nodes)], near) / len(starts))


def _tree_m(distances: Floats, near: Floats) -> float:
    """Prim's spanning tree, grown from what is so near to each node."""
    left, total = np.ones(len(near), bool), 0.0
    while left.any():
        node = int(np.where(left, near, np.inf).argmin())
        total += float(near[node])
        left[node] = False
        near = np.minimum(near, distances[node])
    return total
