"""How a central station allots streets to robots: open routes that together visit places, the longest as short as can
be found. A net of streets is places `nodes_m` (N, 2) and `edges` (E, 2), which of them a straight piece joins."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from terrafuse.errors import InputError
from terrafuse.types import Array, Floats


def street_distances(nodes_m: Floats, edges: Array) -> tuple[Floats, Array]:
    """(metres along the streets (N, N), inf where none leads; next node (N, N) on the way from a row's to a column's).

    The next node is the node itself on the diagonal, -1 where no way leads.
    """
    count = len(nodes_m)
    distances = np.where(np.eye(count, dtype=bool), 0.0, np.inf)
    next_hop = np.where(np.eye(count, dtype=bool), np.arange(count), -1)
    for a, b in np.asarray(edges).reshape(-1, 2).tolist():
        length = float(np.sqrt(((nodes_m[a] - nodes_m[b]) ** 2).sum()))
        if length < distances[a, b]:
            distances[a, b] = distances[b, a] = length
            next_hop[a, b], next_hop[b, a] = b, a
    for k in range(count):
        through = distances[:, k, None] + distances[k]
        shorter = through < distances
        distances = np.where(shorter, through, distances)
        next_hop = np.where(shorter, next_hop[:, k, None], next_hop)
    return distances, next_hop


def allot(distances: Floats, starts: Sequence[int], visits: Sequence[int]) -> list[list[int]]:
    """For each robot the nodes that it visits, in order: each of `visits` once, in one robot's route. It begins at its
    start, which its route names only where that is to be visited; a robot too many has an empty route.

    Raises InputError without robots, and for nodes that no robot reaches.
    """
    wanted = sorted(set(visits))
    _check(distances, starts, wanted)
    routes: list[list[int]] = [[] for _ in starts]
    lengths = [0.0 for _ in starts]
    # The farthest first: who is near them is then clear.
    for node in sorted(wanted, key=lambda n: (-float(distances[list(starts), n].min()), n)):
        _, robot, at, length = min(
            (max(length, 0.0), robot, at, length)
            for robot, start in enumerate(starts)
            for at, length in _insertions(distances, start, routes[robot], lengths[robot], node)
        )
        routes[robot].insert(at, node)
        lengths[robot] = length
    return routes


def _check(distances: Floats, starts: Sequence[int], visits: Sequence[int]) -> None:
    if not len(starts):
        raise InputError("routes for no robots: give at least one start")
    if outside := [n for n in (*starts, *visits) if not 0 <= n < len(distances)]:
        raise InputError(f"nodes {outside} of a net of {len(distances)}: give numbers from 0")
    if lost := [n for n in visits if not np.isfinite(distances[list(starts), n]).any()]:
        raise InputError(f"no street leads from the robots' starts to nodes {lost}: leave them out, or join them")


def _insertions(distances: Floats, start: int, route: list[int], length: float, node: int) -> list[tuple[int, float]]:
    """(where, the length then) of putting a node into a route."""
    stops = [start, *route]
    out = []
    for at, before in enumerate(stops):
        extra = distances[before, node]
        if at < len(route):
            extra = extra + distances[node, route[at]] - distances[before, route[at]]
        out.append((at, float(length + extra)))
    return out


def route_length(distances: Floats, start: int, route: Sequence[int]) -> float:
    """Metres from the start along a route."""
    stops = [start, *route]
    return float(distances[stops[:-1], stops[1:]].sum())


def way(next_hop: Array, stops: Sequence[int]) -> list[int]:
    """All nodes on the way from stop to stop, each passage once: `[start, *route]` for a robot's."""
    out = [int(stops[0])]
    for stop in stops[1:]:
        while out[-1] != stop:
            out.append(int(next_hop[out[-1], stop]))
    return out


def waypoints(nodes_m: Floats, nodes: Sequence[int], right_m: float = 0.0) -> Floats:
    """(K, 2) metres along a way through these nodes, so far to the right of the streets' centre lines."""
    places = np.asarray(nodes_m, np.float64)[list(nodes)]
    if len(places) < 2 or right_m == 0:
        return places
    legs = np.diff(places, axis=0)
    ahead = legs / np.sqrt((legs**2).sum(axis=1))[:, None]
    right = right_m * np.stack([ahead[:, 1], -ahead[:, 0]], axis=1)
    out = [places[0] + right[0]]
    for here, before, after in zip(places[1:-1], right[:-1], right[1:], strict=True):
        shared = 1 + float(before @ after) / right_m**2
        # Where a way turns back, it goes around the node.
        out += [here + before, here + after] if shared < 0.1 else [here + (before + after) / shared]
    return np.array([*out, places[-1] + right[-1]])


def patrol(nodes_m: Floats, edges: Array, starts: Sequence[int], sight_m: float, right_m: float = 0.0) -> list[Floats]:
    """Waypoints (K, 2) for each robot, from its start on: together they see all streets, of which a robot sees the
    parts up to `sight_m` ahead and, at a node, aside."""
    distances, next_hop = street_distances(nodes_m, edges)
    routes = allot(distances, starts, range(len(nodes_m)))
    return [
        waypoints(nodes_m, way(next_hop, [start, *route]), right_m) for start, route in zip(starts, routes, strict=True)
    ]


def least_longest_m(distances: Floats, starts: Sequence[int], visits: Sequence[int]) -> float:
    """No allotment has a longest route shorter than this: the spanning tree of starts and visits, in k equal parts; or
    the way to the farthest visit."""
    nodes = sorted({*visits} - {*starts})
    if not nodes:
        return 0.0
    near = distances[np.ix_(list(starts), nodes)].min(axis=0)
    return max(float(near.max()), _tree_m(distances[np.ix_(nodes, nodes)], near) / len(starts))


def _tree_m(distances: Floats, joined: Floats) -> float:
    """Prim's spanning tree, grown from what is `joined` so far from each node."""
    near, total = joined.copy(), 0.0
    left = np.ones(len(near), bool)
    while left.any():
        node = int(np.where(left, near, np.inf).argmin())
        total += float(near[node])
        left[node] = False
        near = np.minimum(near, distances[node])
    return total
