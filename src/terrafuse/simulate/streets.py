"""Streets as a net of straight pieces, and the ground made level across them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from terrafuse.errors import InputError
from terrafuse.simulate.terrain import Terrain
from terrafuse.types import Array, Floats

CHUNK = 4096
"""Places that are held against all streets at once."""


@dataclass(frozen=True, eq=False)
class Streets:
    """`nodes_m` (N, 2) crossings and ends, `edges` (E, 2) which of them a piece joins; all are `width_m` wide, with
    round ends."""

    nodes_m: Floats
    edges: Array
    width_m: float

    def __post_init__(self) -> None:
        if len(self.edges) and not self.width_m > 0:
            raise InputError(f"streets {self.width_m} m wide: give a positive width")
        if len(self.edges) and not (0 <= self.edges.min() and self.edges.max() < len(self.nodes_m)):
            raise InputError(f"streets join nodes {self.edges.min()} to {self.edges.max()} of {len(self.nodes_m)}")

    @property
    def segments_m(self) -> Floats:
        """(E, 4): x0 y0 x1 y1 of each centre line."""
        return self.nodes_m[self.edges].reshape(-1, 4)

    @cached_property
    def neighbours(self) -> tuple[tuple[int, ...], ...]:
        """Of each node, the nodes next to it, rising."""
        out: list[set[int]] = [set() for _ in self.nodes_m]
        for a, b in self.edges.tolist():
            out[a].add(b)
            out[b].add(a)
        return tuple(tuple(sorted(found)) for found in out)

    @property
    def connected(self) -> bool:
        """Whether every node can be reached from every other."""
        return len(reached(self, 0)) == len(self.nodes_m) if len(self.nodes_m) else True

    def distance(self, x_m: Array | float, y_m: Array | float) -> Floats:
        """How far (x, y) is from the nearest centre line; inf without streets."""
        x, y = np.broadcast_arrays(np.asarray(x_m, np.float64), np.asarray(y_m, np.float64))
        out = np.full(x.size, np.inf)
        segments = self.segments_m.T[:, :, None]
        for start in range(0, x.size, CHUNK):
            part = slice(start, start + CHUNK)
            distances = nearest_on(segments, x.ravel()[part], y.ravel()[part])[0]
            out[part] = distances.min(axis=0, initial=np.inf)
        return out.reshape(x.shape)


NO_STREETS = Streets(np.empty((0, 2)), np.empty((0, 2), np.int64), 1.0)


def reached(streets: Streets, start: int) -> set[int]:
    """The nodes that streets lead to from a node, itself included."""
    found, ahead = {start}, [start]
    while ahead:
        for node in streets.neighbours[ahead.pop()]:
            if node not in found:
                found.add(node)
                ahead.append(node)
    return found


def nearest_on(segment: Floats, x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
    """Distance from (x, y) to a piece x0 y0 x1 y1 (or arrays of them), and the place on it that is nearest."""
    x0, y0, x1, y1 = segment
    dx, dy = x1 - x0, y1 - y0
    along = ((x - x0) * dx + (y - y0) * dy) / np.maximum(dx * dx + dy * dy, 1e-12)
    share = np.minimum(np.maximum(along, 0.0), 1.0)
    px, py = x0 + share * dx, y0 + share * dy
    return np.hypot(x - px, y - py), px, py


def near_segments(
    segments: Floats, x: Floats, y: Floats, reach_m: float
) -> Iterator[tuple[tuple[slice, slice], Floats]]:
    """For each piece, the part [j, i] that may be in reach of a grid with rising axes x (W,), y (H,); and the piece."""
    for segment in segments:
        i = slice(*np.searchsorted(x, (segment[0::2].min() - reach_m, segment[0::2].max() + reach_m)))
        j = slice(*np.searchsorted(y, (segment[1::2].min() - reach_m, segment[1::2].max() + reach_m)))
        yield (j, i), segment


def street_grid(streets: Streets, x: Floats, y: Floats, beyond_m: float = 0.0) -> Array:
    """Which places of a grid with rising axes lie on a street or within `beyond_m` of one, (H, W)."""
    out, reach = np.zeros((len(y), len(x)), bool), streets.width_m / 2 + beyond_m
    for (j, i), segment in near_segments(streets.segments_m, x, y, reach):
        out[j, i] |= nearest_on(segment, x[i], y[j, None])[0] <= reach
    return out


def graded(terrain: Terrain, bed: Terrain, streets: Streets, level_m: float, blend_m: float) -> Terrain:
    """The ground with streets laid into it: level across, along them as high as `bed`.

    Level up to `level_m` beside the centre line, and the old ground from `blend_m` further on; where streets meet, each
    counts by its nearness. `bed` lies under the same places and should be smooth.
    """
    rows, columns = terrain.heights_m.shape
    x, y = terrain.axes_m
    weights, heights, most = np.zeros((rows, columns)), np.zeros((rows, columns)), np.zeros((rows, columns))
    for (j, i), segment in near_segments(streets.segments_m, x, y, level_m + blend_m):
        distance, px, py = nearest_on(segment, x[i], y[j, None])
        weight = _fade((distance - level_m) / blend_m)
        steep = weight**4
        weights[j, i] += steep
        heights[j, i] += steep * np.nan_to_num(bed.height(px, py))
        most[j, i] = np.maximum(most[j, i], weight)
    street = heights / np.where(weights > 0, weights, 1.0)
    return replace(
        terrain, heights_m=np.where(weights > 0, most * street + (1 - most) * terrain.heights_m, terrain.heights_m)
    )


def _fade(share: Floats) -> Floats:
    """1 up to 0, 0 from 1 on, smooth between."""
    s = np.clip(share, 0, 1)
    return np.asarray(1 - s * s * (3 - 2 * s))
