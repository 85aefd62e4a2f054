"""What robots can drive on and fly over: the world as seen by rays straight down, and whatever moves in it."""

from __future__ import annotations

import numpy as np

from terrafuse.simulate.motion import Ground
from terrafuse.simulate.rays import RayCaster
from terrafuse.simulate.world import World
from terrafuse.types import Array, Floats

STEP_M = 0.12
"""What stands higher than this above the ground is in a wheeled robot's way."""
ABOVE_M = 5.0
REACH_M = 5.0
"""Bodies further from a robot than this are not looked at: no robot is wider, nor faster in a tick."""


class Surface:
    """The tops of all that stands for good."""

    def __init__(self, world: World, caster: RayCaster) -> None:
        self._world, self._caster = world, caster
        tops = [block.top_m for block in world.blocks] + [float(world.terrain.heights_m.max())]
        self._from_m = max(tops) + ABOVE_M
        self._reach_m = self._from_m - float(world.terrain.heights_m.min()) + ABOVE_M

    def ground(self, x_m: Floats, y_m: Floats) -> Floats:
        """z of the terrain, NaN off it."""
        return self._world.terrain.height(x_m, y_m)

    def top(self, x_m: Floats, y_m: Floats) -> Floats:
        """z of what is seen from above, NaN off the terrain; what moves does not count."""
        origins = np.column_stack([np.ravel(x_m), np.ravel(y_m), np.full(np.size(x_m), self._from_m)])
        down = np.broadcast_to(np.array([0.0, 0.0, -1.0]), origins.shape)
        ranges = self._caster.cast(origins, down, self._reach_m).ranges_m
        z = np.where(np.isfinite(ranges), self._from_m - ranges, np.nan).reshape(np.shape(x_m))
        return np.where(np.isfinite(self.ground(x_m, y_m)), z, np.nan)

    def for_wheels(self, moving: list[Array]) -> Ground:
        """What blocks wheels: what stands, and of what moves that which `moving` lists for each robot."""

        def blocked(x_m: Floats, y_m: Floats) -> Array:
            stands = self.top(x_m, y_m) - self.ground(x_m, y_m) > STEP_M
            return np.asarray(stands | _covered(moving, x_m, y_m))

        return Ground(self.ground, blocked)

    def for_wings(self) -> Ground:
        """What flies meets only what reaches up to it."""
        return Ground(self.top)


def _covered(moving: list[Array], x_m: Floats, y_m: Floats) -> Array:
    """Which places (N, K) lie on the footprint of something that moves near their robot, a row."""
    out = np.zeros(np.shape(x_m), bool)
    for row, bodies in enumerate(moving):
        x, y = x_m[row], y_m[row]
        near = np.hypot(bodies["x"] - x[0], bodies["y"] - y[0]) < REACH_M + bodies["half_length"]
        for body in bodies[near]:
            out[row] |= _inside(body, x, y)
    return out


def _inside(body: Array, x_m: Floats, y_m: Floats) -> Array:
    dx, dy = x_m - body["x"], y_m - body["y"]
    if body["round"]:
        return np.asarray(np.hypot(dx, dy) <= body["half_length"])
    along, across = body["cos"] * dx + body["sin"] * dy, body["cos"] * dy - body["sin"] * dx
    return np.asarray((np.abs(along) <= body["half_length"]) & (np.abs(across) <= body["half_width"]))
