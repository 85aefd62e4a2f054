"""Nets of streets to patrol, and when a patrol has seen how much of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from terrafuse.types import Array, Floats

STEP_M = 2.0
LANE_M = 4.0
"""A robot is on a street as far as this from its centre line."""


def random_net(seed: int, count: int) -> tuple[Floats, Array]:
    """Nodes (N, 2) anywhere in a square kilometre, each joined to the nearest earlier one, and some more edges."""
    rng = np.random.default_rng(seed)
    nodes = rng.uniform(0, 1000, (count, 2))
    apart = np.hypot(*(nodes[:, None] - nodes).T)
    tree = [(int(apart[n, :n].argmin()), n) for n in range(1, count)]
    more = [tuple(sorted(rng.choice(count, 2, replace=False).tolist())) for _ in range(count // 2)] if count > 1 else []
    return nodes, np.array([*tree, *more]).reshape(-1, 2)


def seen_at_s(
    nodes_m: Floats, edges: Array, ways_m: Sequence[Floats], speed_mps: float = 3.0, sight_m: float = 55.0
) -> Floats:
    """When each metre of the streets is first seen, inf if never, by robots that drive along their waypoints and see
    so far along every street that they are on."""
    ends = nodes_m[edges]
    return np.concatenate([_street_seen_at_s(a, b, ways_m, speed_mps, sight_m) for a, b in ends])


def _street_seen_at_s(a: Floats, b: Floats, ways_m: Sequence[Floats], speed_mps: float, sight_m: float) -> Floats:
    length = np.hypot(*(b - a))
    east, north = (b - a) / length
    metres = np.arange(0.5, length)
    seen = np.full(len(metres), np.inf)
    for way in ways_m:
        at, place = _driven(way)
        along = (place - a) @ [east, north]
        aside = np.abs((place - a) @ [-north, east])
        on = (aside <= LANE_M) & (along >= -LANE_M) & (along <= length + LANE_M)
        for time, here in zip(at[on] / speed_mps, along[on], strict=True):
            part = slice(*np.searchsorted(metres, (here - sight_m, here + sight_m)))
            seen[part] = np.minimum(seen[part], time)
    return seen


def _driven(way_m: Floats) -> tuple[Floats, Floats]:
    """(metres driven, places (M, 2)) along a way, at each of its points and some between."""
    points = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way_m, axis=0).T))])
    at = np.union1d(points, np.arange(0, points[-1], STEP_M))
    return at, np.column_stack([np.interp(at, points, axis) for axis in way_m.T])


def seen_share_at_s(seen_s: Floats, share: float) -> float:
    """When this share of the streets has been seen."""
    return float(np.sort(seen_s)[int(np.ceil(share * len(seen_s))) - 1])


def middle(nodes_m: Floats) -> int:
    return int(np.hypot(*nodes_m.T).argmin())
