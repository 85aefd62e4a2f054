"""Ways along a net of streets: places `nodes_m` (N, 2), and `edges` (E, 2), which of them a straight piece joins."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from terrafuse.errors import InputError
from terrafuse.types import Array, Floats


def street_distances(nodes_m: Floats, edges: Array) -> tuple[Floats, Array]:
    """(metres along the streets (N, N), inf where none leads; next node (N, N) on the way from a row's to a column's).

    The next node is the node itself on the diagonal, -1 where no way leads. Floyd and Warshall's algorithm. Raises
    InputError for edges of other nodes.
    """
    edges, count = _checked(nodes_m, edges), len(nodes_m)
    distances = np.where(np.eye(count, dtype=bool), 0.0, np.inf)
    next_hop = np.where(np.eye(count, dtype=bool), np.arange(count), -1)
    for (a, b), length in zip(edges.tolist(), _lengths(nodes_m, edges).tolist(), strict=True):
        if length < distances[a, b]:
            distances[a, b] = distances[b, a] = length
            next_hop[a, b], next_hop[b, a] = b, a
    for k in range(count):
        through = distances[:, k, None] + distances[k]
        shorter = through < distances
        distances = np.where(shorter, through, distances)
        next_hop = np.where(shorter, next_hop[:, k, None], next_hop)
    return distances, next_hop


def _checked(nodes_m: Floats, edges: Array) -> Array:
    edges = np.asarray(edges, np.int64).reshape(-1, 2)
    if len(edges) and not (0 <= edges.min() and edges.max() < len(nodes_m)):
        raise InputError(
            f"streets join nodes {edges.min()} to {edges.max()}: give numbers from 0 to {len(nodes_m) - 1}"
        )
    if not np.isfinite(nodes_m).all():
        raise InputError(f"nodes {np.flatnonzero(~np.isfinite(nodes_m).all(axis=1)).tolist()}: give finite metres")
    return edges


def _lengths(nodes_m: Floats, edges: Array) -> Floats:
    return np.asarray(np.sqrt(((nodes_m[edges[:, 0]] - nodes_m[edges[:, 1]]) ** 2).sum(axis=1)))


def way(next_hop: Array, stops: Sequence[int]) -> list[int]:
    """All nodes on the way from stop to stop, as often as it passes them."""
    out = [int(stops[0])]
    for stop in stops[1:]:
        while out[-1] != stop:
            out.append(int(next_hop[out[-1], stop]))
    return out


def waypoints(nodes_m: Floats, nodes: Sequence[int], right_m: float = 0.0) -> Floats:
    """(K, 2) metres along a way through these nodes, so far to the right of the streets' centre lines. Where it turns
    back it goes around the node."""
    places = np.asarray(nodes_m, np.float64)[list(nodes)]
    legs = np.diff(places, axis=0)
    new = (legs != 0).any(axis=1)
    places, legs = places[np.concatenate([[True], new])], legs[new]
    if not len(legs) or right_m == 0:
        return np.asarray(places)
    ahead = legs / np.sqrt((legs**2).sum(axis=1))[:, None]
    right = np.column_stack([ahead[:, 1], -ahead[:, 0]])
    out = [places[:1] + right_m * right[0]]
    for here, before, after in zip(places[1:-1], right, right[1:], strict=False):
        shared = 1 + float(before @ after)
        aside = [before, after] if shared < 0.1 else [(before + after) / shared]
        out.append(here + right_m * np.array(aside))
    return np.concatenate([*out, places[-1:] + right_m * right[-1]])


def with_lookouts(nodes_m: Floats, edges: Array, sight_m: float, gap_m: float) -> tuple[Floats, Array, Array]:
    """(nodes, edges, lookouts (L, 2)): on each street of whose middle more than `gap_m` is out of sight from its ends,
    the two places, one from either end, from which a robot sees the rest. One of them will do.

    Seen from both ends, a street of length l lacks l - 2 sight_m; who goes in that far, sees on to what the other end
    sees.
    """
    edges = _checked(nodes_m, edges)
    lengths = _lengths(nodes_m, edges)
    long = lengths - 2 * sight_m > max(gap_m, 0.0)
    a, b = nodes_m[edges[long, 0]], nodes_m[edges[long, 1]]
    share = (1 - 2 * sight_m / lengths[long])[:, None]
    lookouts = len(nodes_m) + np.arange(2 * long.sum()).reshape(2, -1).T
    first, second = np.where(share <= 0.5, lookouts, lookouts[:, ::-1]).T
    pieces = [edges[long, 0], first, second, edges[long, 1]]
    return (
        np.concatenate([nodes_m, a + share * (b - a), b + share * (a - b)]),
        np.concatenate([edges[~long], *(np.column_stack(ends) for ends in pairwise(pieces))]),
        lookouts,
    )
