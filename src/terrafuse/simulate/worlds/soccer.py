"""The *grey* paper's field: 6 m east, 9 m north, boards around it, a goal at either end. The ground is level."""

from __future__ import annotations

from terrafuse.simulate.houses import Wall
from terrafuse.simulate.terrain import flat
from terrafuse.simulate.world import World
from terrafuse.types import Bounds

EAST_M, NORTH_M = 6.0, 9.0
BOARD_M, HEIGHT_M = 0.1, 0.5
GOAL_M, GOAL_DEPTH_M = 2.0, 0.5


def soccer_field() -> World:
    """The field's south-western corner is the origin, as in the paper; boards stand outside of its lines. Robots are no
    part of it: they are bodies (`soccer`)."""
    h = BOARD_M / 2
    west, east, south, north = -h, EAST_M + h, -h, NORTH_M + h
    post, other = (EAST_M - GOAL_M) / 2 - h, (EAST_M + GOAL_M) / 2 + h
    lines = [(west, south, west, north), (east, south, east, north)]
    for y, back in ((south, south - GOAL_DEPTH_M), (north, north + GOAL_DEPTH_M)):
        lines += [(west, y, post, y), (other, y, east, y), (post, y, post, back), (other, y, other, back)]
        lines += [(post, back, other, back)]
    bounds = Bounds(-1.0, -1.0, EAST_M + 1, NORTH_M + 1)
    walls = tuple(Wall(*line, HEIGHT_M, BOARD_M) for line in lines)
    return World("soccer_field", bounds, flat(bounds), walls=walls, level_walls=True)
