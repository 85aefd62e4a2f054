"""What moves by the clock, for MuJoCo: bodies that push robots and are pushed by none."""

from __future__ import annotations

from typing import Any

import numpy as np

from terrafuse.simulate.movers import SHAPES, Mover
from terrafuse.simulate.physics.scene import solid, standing
from terrafuse.simulate.world import World
from terrafuse.types import Floats

AWAY_M = -1000.0
"""What is not there waits this far below."""


def add_movers(spec: Any, world: World) -> None:
    for number, mover in enumerate(world.movers):
        body = spec.worldbody.add_body(name=f"mover {number}", mocap=True)
        for part in SHAPES[mover.shape]:
            body.add_geom(**solid(part), **standing())


class Traffic:
    """Where a world's movers are. They are asked for a later time each time, and go straight in between."""

    def __init__(self, world: World, origin_m: Floats, time_s: float) -> None:
        self._world, self._origin_m = world, np.append(origin_m, 0.0)
        self._time_s, self._places = time_s, self._at(time_s)

    def between(self, from_s: float, until_s: float, count: int) -> tuple[Floats, Floats]:
        """Positions (count, K, 3) and quaternions (count, K, 4) at `count` even times, the last of them `until_s`."""
        begin = self._places if from_s == self._time_s else self._at(from_s)
        end = self._at(until_s)
        self._time_s, self._places = until_s, end
        begin, end = np.where(np.isnan(begin), end, begin), np.where(np.isnan(end), begin, end)
        way = end - begin
        way[:, 3] = (way[:, 3] + np.pi) % (2 * np.pi) - np.pi
        places = begin + np.linspace(0, 1, count + 1)[1:, None, None] * way
        there = np.isfinite(places[..., :1])
        half = np.where(there[..., 0], places[..., 3], 0.0) / 2
        still = np.zeros_like(half)
        return (
            np.where(there, places[..., :3], AWAY_M),
            np.stack([np.cos(half), still, still, np.sin(half)], axis=-1),
        )

    def _at(self, time_s: float) -> Floats:
        """(K, 4): x, y, z, yaw of each mover, NaN where it is not there."""
        places = np.array([_place(mover, time_s) for mover in self._world.movers]).reshape(-1, 3)
        z = self._world.terrain.height(places[:, 0], places[:, 1])
        return np.asarray(np.column_stack([places[:, :2], z, places[:, 2]]) - self._origin_m)


def _place(mover: Mover, time_s: float) -> tuple[float, float, float]:
    return mover.route.at(time_s) or (np.nan, np.nan, np.nan)
