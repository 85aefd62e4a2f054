"""One floor of an office: a corridor around a block of rooms, rooms outside it too, a door to each."""

from __future__ import annotations

import numpy as np

from terrafuse.simulate.houses import Wall
from terrafuse.simulate.streets import Streets
from terrafuse.simulate.terrain import flat
from terrafuse.simulate.world import World
from terrafuse.types import Bounds

WALL_M, HEIGHT_M, DOOR_M = 0.15, 2.5, 1.0
EAST_M, NORTH_M = 30.0, 20.0
OUTER, INNER = Bounds(5.0, 5.0, 25.0, 15.0), Bounds(7.0, 7.0, 23.0, 13.0)
"""The corridor lies between these two rectangles, 2 m wide."""

Line = tuple[float, float, float, float]


def hallway() -> World:
    """30 m × 20 m with its corner at the origin. Its street is the corridor's middle, in which patrols go round."""
    lines = [
        *_rectangle(Bounds(0.0, 0.0, EAST_M, NORTH_M)),
        *_with_doors(OUTER, along_x=(7.5, 12.5, 17.5, 22.5), along_y=(7.5, 12.5)),
        *_with_doors(INNER, along_x=(9.0, 13.0, 17.0, 21.0), along_y=()),
        *_partitions(),
    ]
    walls = tuple(Wall(*line, HEIGHT_M, WALL_M) for line in lines)
    margin = Bounds(-1.0, -1.0, EAST_M + 1, NORTH_M + 1)
    return World("hallway", margin, flat(margin), walls=walls, streets=_corridor(), level_walls=True)


def _corridor() -> Streets:
    west, south, east, north = ((a + b) / 2 for a, b in zip(OUTER, INNER, strict=True))
    nodes = np.array([(west, south), (east, south), (east, north), (west, north)])
    return Streets(nodes, np.array([(0, 1), (1, 2), (2, 3), (3, 0)]), 1.6)


def _rectangle(b: Bounds) -> list[Line]:
    return [
        (b.west, b.south, b.east, b.south),
        (b.east, b.south, b.east, b.north),
        (b.east, b.north, b.west, b.north),
        (b.west, b.north, b.west, b.south),
    ]


def _with_doors(b: Bounds, along_x: tuple[float, ...], along_y: tuple[float, ...]) -> list[Line]:
    """A rectangle's walls, with doors at these places of its two walls along x, and of its two along y."""
    x, y = _pieces(b.west, b.east, along_x), _pieces(b.south, b.north, along_y)
    across = [(p, edge, q, edge) for edge in (b.south, b.north) for p, q in x]
    return across + [(edge, p, edge, q) for edge in (b.west, b.east) for p, q in y]


def _pieces(start: float, end: float, doors: tuple[float, ...]) -> list[tuple[float, float]]:
    # Walls are longer by half their thickness at both ends: a door keeps its width.
    half = (DOOR_M + WALL_M) / 2
    cuts = [start, *(edge for door in doors for edge in (door - half, door + half)), end]
    return list(zip(cuts[::2], cuts[1::2], strict=True))


def _partitions() -> list[Line]:
    """Walls between rooms: four rooms within the corridor from either side, the others around it."""
    inside = [(x, INNER.south, x, INNER.north) for x in (11.0, 15.0, 19.0)]
    middle = [(INNER.west, 10.0, INNER.east, 10.0)]
    bands = [(0.0, OUTER.south), (OUTER.north, NORTH_M)]
    between = [(x, *band) for x in (10.0, 15.0, 20.0) for band in bands]
    # Rooms in the corners have their door to the room beside them.
    corners = [(x, *piece) for x in (5.0, 25.0) for band in bands for piece in _pieces(*band, (sum(band) / 2,))]
    sides = [(x, y, x + 5.0, y) for x in (0.0, 25.0) for y in (5.0, 10.0, 15.0)]
    return inside + middle + [(x, y0, x, y1) for x, y0, y1 in between + corners] + sides
