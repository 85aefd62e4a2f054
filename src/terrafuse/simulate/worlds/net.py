"""What places with streets have in common: nets of streets, houses along them, ways through them."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field

from terrafuse.errors import InputError
from terrafuse.simulate.blocks import Block, corners_of, overlap
from terrafuse.simulate.houses import House, Wall
from terrafuse.simulate.quantities import Number
from terrafuse.simulate.regions import Region
from terrafuse.simulate.streets import Streets, reached
from terrafuse.types import Bounds, Floats

EDGE_FREE_M = 2.0
"""What stands keeps this far from a street and from the world's border."""
APART_M = 1.5


class Net(NamedTuple):
    """How a net of streets is drawn: a square one with crossings about `spacing_m` apart, each moved by up to
    `jitter_m`, from which a share of the pieces is left out as long as all stays connected."""

    spacing_m: float
    jitter_m: float
    dropped: float
    width_m: float


class Plot(NamedTuple):
    """How houses line streets. Ranges are (least, most); `shapes`: (weight in the draw, range of heights)."""

    length_m: tuple[float, float]
    depth_m: tuple[float, float]
    setback_m: tuple[float, float]
    gap_m: tuple[float, float]
    turn_rad: float
    shapes: dict[str, tuple[float, tuple[float, float]]]


Side = Annotated[Number, Field(ge=50, le=5000)]
"""Of a square world: as much as is made within minutes."""


def square(side_m: float) -> Bounds:
    """Around the origin. Raises InputError for a side that is none."""
    if not (math.isfinite(side_m) and side_m >= 50):
        raise InputError(f"a world of {side_m} m a side: give 50 or more")
    return Bounds(-side_m / 2, -side_m / 2, side_m / 2, side_m / 2)


def street_net(bounds: Bounds, net: Net, rng: np.random.Generator) -> Streets:
    """A net inside the bounds, half a spacing from their edges."""
    count = max(2, round((bounds.east - bounds.west) / net.spacing_m))
    spacing = (bounds.east - bounds.west) / count
    j, i = np.divmod(np.arange(count * count), count)
    places = np.stack([bounds.west + (i + 0.5) * spacing, bounds.south + (j + 0.5) * spacing], axis=1)
    nodes = places + rng.uniform(-net.jitter_m, net.jitter_m, places.shape)
    number = np.arange(count * count).reshape(count, count)
    across = np.stack([number[:, :-1].ravel(), number[:, 1:].ravel()], axis=1)
    along = np.stack([number[:-1].ravel(), number[1:].ravel()], axis=1)
    edges = np.concatenate([across, along])
    return _thinned(Streets(nodes, edges, net.width_m), net.dropped, rng)


def _thinned(streets: Streets, share: float, rng: np.random.Generator) -> Streets:
    """Without a share of its pieces; none goes that holds the net together or would make a dead end."""
    edges = streets.edges
    for edge in rng.permutation(edges)[: round(share * len(edges))]:
        fewer = Streets(streets.nodes_m, edges[(edges != edge).any(axis=1)], streets.width_m)
        if len(reached(fewer, 0)) == len(fewer.nodes_m) and min(len(fewer.neighbours[n]) for n in edge) > 1:
            edges = fewer.edges
    return Streets(streets.nodes_m, edges, streets.width_m)


class Sited(NamedTuple):
    """A house, its outline, and the street before it: x, y of the centre line, its direction, on which side (1 left, -1
    right) the house stands, and how far the front is from the centre line."""

    house: House
    outline: Block
    at_m: tuple[float, float]
    along_rad: float
    side: float
    front_m: float


def line_streets(streets: Streets, bounds: Bounds, plot: Plot, rng: np.random.Generator) -> list[Sited]:
    """Houses on both sides of all streets, none on a street, none on another."""
    out: list[Sited] = []
    for segment in streets.segments_m:
        for side in (1.0, -1.0):
            for sited in _row(segment, side, streets.width_m, plot, rng):
                if is_free(sited.outline, streets, bounds) and not _hits(sited.outline, out):
                    out.append(sited)
    return out


def _row(segment: Floats, side: float, width_m: float, plot: Plot, rng: np.random.Generator) -> list[Sited]:
    """What would stand along one side of a piece, if nothing else were there."""
    x0, y0, x1, y1 = segment.tolist()
    whole, along = math.hypot(x1 - x0, y1 - y0), math.atan2(y1 - y0, x1 - x0)
    out: list[Sited] = []
    at = rng.uniform(*plot.gap_m)
    while True:
        length, depth = rng.uniform(*plot.length_m), rng.uniform(*plot.depth_m)
        setback, gap, turn = rng.uniform(*plot.setback_m), rng.uniform(*plot.gap_m), rng.uniform(-1, 1) * plot.turn_rad
        shape, height = _kind(plot, rng)
        if at + length > whole:
            return out
        middle = at + length / 2
        front = width_m / 2 + setback
        street = x0 + middle * math.cos(along), y0 + middle * math.sin(along)
        x, y = beside(street, along, side * (front + depth / 2))
        house = House(x, y, length, depth, height, along + turn, shape)
        outline = Block("house", x, y, length, depth, along + turn, 0.0, 1.0, 1.0)
        out.append(Sited(house, outline, street, along, side, front))
        at += length + gap


def _kind(plot: Plot, rng: np.random.Generator) -> tuple[str, float]:
    names, weights = list(plot.shapes), np.array([weight for weight, _ in plot.shapes.values()])
    shape = names[int(np.searchsorted(np.cumsum(weights / weights.sum()), rng.uniform()))]
    return shape, float(rng.uniform(*plot.shapes[shape][1]))


def beside(place: tuple[float, float], along_rad: float, left_m: float) -> tuple[float, float]:
    """The place so far to the left of a direction."""
    return place[0] - left_m * math.sin(along_rad), place[1] + left_m * math.cos(along_rad)


def is_free(outline: Block, streets: Streets, bounds: Bounds) -> bool:
    """Whether a footprint keeps off the streets and inside the bounds."""
    edge = outline_points(outline)
    inside = (edge > np.array(bounds[:2]) + EDGE_FREE_M).all() and (edge < np.array(bounds[2:]) - EDGE_FREE_M).all()
    return bool(inside and (streets.distance(*edge.T) > streets.width_m / 2 + EDGE_FREE_M).all())


def outline_points(outline: Block) -> Floats:
    """Points along a footprint's edge, at most 2 m apart, its corners among them."""
    corners = corners_of(outline)
    pieces = []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        count = math.ceil(float(np.hypot(*(b - a))) / 2)
        pieces.append(a + (b - a) * (np.arange(count) / count)[:, None])
    return np.concatenate(pieces)


def _hits(outline: Block, others: list[Sited]) -> bool:
    here, reach = (outline.x_m, outline.y_m), _radius(outline) + 2 * APART_M
    return any(
        math.dist(here, (other.outline.x_m, other.outline.y_m)) < reach + _radius(other.outline)
        and overlap(outline, other.outline, APART_M)
        for other in others
    )


def _radius(outline: Block) -> float:
    return math.hypot(outline.length_m, outline.width_m) / 2


def garden_wall(sited: Sited, streets: Streets, rng: np.random.Generator) -> Wall | None:
    """A wall along the street before a house, with a gap for the gate at one end; None where another street is near."""
    half = sited.house.length_m / 2
    height, gate = rng.uniform(0.8, 1.8), rng.uniform(1.2, 3.0)
    line = beside(sited.at_m, sited.along_rad, sited.side * (streets.width_m / 2 + EDGE_FREE_M / 2))
    c, s = math.cos(sited.along_rad), math.sin(sited.along_rad)
    (x0, y0), (x1, y1) = ((line[0] + c * t, line[1] + s * t) for t in (-half, half - gate))
    off = streets.distance(np.array([x0, (x0 + x1) / 2, x1]), np.array([y0, (y0 + y1) / 2, y1]))
    return Wall(x0, y0, x1, y1, height) if (off > streets.width_m / 2 + 0.5).all() else None


def tour(streets: Streets, steps: int, right_m: float, rng: np.random.Generator) -> list[tuple[float, float]]:
    """A closed way: a walk over so many pieces, back the same way, always so far to the right of the centre line.

    The last place is the first.
    """
    walk = [int(rng.integers(len(streets.nodes_m)))]
    while len(walk) <= steps:
        ahead = [n for n in streets.neighbours[walk[-1]] if len(walk) < 2 or n != walk[-2]]
        walk.append(int(rng.choice(ahead or list(streets.neighbours[walk[-1]]))))
    nodes = streets.nodes_m[[*walk, *walk[-2::-1]]]
    return offset_loop(nodes, right_m)


def offset_loop(nodes: Floats, right_m: float) -> list[tuple[float, float]]:
    """A closed polyline (its last node is its first) moved to its right; where it turns back, around the node."""
    legs = np.diff(nodes, axis=0)
    ahead = legs / np.hypot(*legs.T)[:, None]
    right = right_m * np.stack([ahead[:, 1], -ahead[:, 0]], axis=1)
    out: list[tuple[float, float]] = []
    for k in range(len(legs)):
        here, before, after = nodes[k], right[k - 1], right[k]
        shared = 1 + float(ahead[k - 1] @ ahead[k])
        places = [here + before, here + after] if shared < 0.1 else [here + (before + after) / shared]
        out += [(float(x), float(y)) for x, y in places]
    return [*out, out[0]]


def patch(value: int, bounds: Bounds, rng: np.random.Generator) -> Region:
    """A region of this value somewhere: an irregular octagon of about an eighth of the bounds' width."""
    side = bounds.east - bounds.west
    x, y = rng.uniform(bounds.west, bounds.east), rng.uniform(bounds.south, bounds.north)
    radii = (side * rng.uniform(0.06, 0.13, 8)).tolist()
    angles = [k * math.pi / 4 for k in range(8)]
    ring = tuple((x + r * math.cos(a), y + r * math.sin(a)) for r, a in zip(radii, angles, strict=True))
    return Region(value, ring)
