"""What stands for good, for MuJoCo: the ground as a height field, blocks as boxes or convex meshes, a fence around.

MuJoCo cuts each square of a height field from south-west to north-east, as `Terrain` does, so both are one surface.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from terrafuse.simulate.blocks import Block, triangles_of
from terrafuse.simulate.movers import Part
from terrafuse.simulate.physics.library import mujoco
from terrafuse.simulate.terrain import Terrain
from terrafuse.simulate.world import World
from terrafuse.types import Array, Floats

STANDS, MOVES, LIES = 1, 2, 4
"""Bits of contype and conaffinity: what moves meets what has the bit. Wheels meet the ground in contacts of their own,
so they leave out what LIES."""
GROUND = "ground"
BASE_M = 5.0
"""How far below its lowest place the ground is solid."""
FRICTION = 0.6
"""Of hulls and walls; wheels have their own."""
SOLREF = (0.01, 1.0)
"""Contacts give way and come back within 10 ms, without a bounce."""


def origin_of(world: World) -> Floats:
    """(3,) of the frame in which MuJoCo works: near the robots even where coordinates are UTM's."""
    west, south, east, north = world.terrain.bounds
    return np.round([(west + east) / 2, (south + north) / 2, world.terrain.heights_m.min()])


def add_world(spec: Any, world: World, origin_m: Floats) -> None:
    add_ground(spec, world.terrain, origin_m)
    add_fence(spec, world.terrain, origin_m)
    for number, block in enumerate(world.blocks):
        _add_block(spec, block, number, origin_m)


def add_ground(spec: Any, terrain: Terrain, origin_m: Floats) -> None:
    rows, columns = terrain.heights_m.shape
    west, south, east, north = terrain.bounds
    low, rise = _range(terrain.heights_m)
    spec.add_hfield(
        name=GROUND,
        nrow=rows,
        ncol=columns,
        size=[(east - west) / 2, (north - south) / 2, rise, BASE_M],
        userdata=((terrain.heights_m - low) / rise).ravel(),
    )
    middle = np.array([(west + east) / 2, (south + north) / 2, low]) - origin_m
    spec.worldbody.add_geom(**_lying(), name=GROUND, type=mujoco().mjtGeom.mjGEOM_HFIELD, hfieldname=GROUND, pos=middle)


def _range(heights_m: Array) -> tuple[float, float]:
    """The lowest height, and how far the others rise above it; MuJoCo needs a rise where there is none."""
    return float(heights_m.min()), float(np.ptp(heights_m)) or 1.0


def add_fence(spec: Any, terrain: Terrain, origin_m: Floats) -> None:
    """Beyond the terrain there is nothing, and nobody goes there."""
    west, south, east, north = terrain.bounds
    for x, y, inwards in ((west, south, (1, 0)), (west, south, (0, 1)), (east, north, (-1, 0)), (east, north, (0, -1))):
        spec.worldbody.add_geom(
            **_lying(),
            type=mujoco().mjtGeom.mjGEOM_PLANE,
            size=[0.0, 0.0, 1.0],
            pos=np.array([x, y, origin_m[2]]) - origin_m,
            zaxis=[*inwards, 0.0],
        )


def _add_block(spec: Any, block: Block, number: int, origin_m: Floats) -> None:
    if block.roof == "flat":
        height = block.top_m - block.bottom_m
        spec.worldbody.add_geom(
            **standing(),
            type=mujoco().mjtGeom.mjGEOM_BOX,
            size=[block.length_m / 2, block.width_m / 2, height / 2],
            pos=np.array([block.x_m, block.y_m, block.bottom_m + height / 2]) - origin_m,
            quat=turn(block.yaw_rad),
        )
    else:
        _add_mesh(spec, f"block {number}", np.unique(triangles_of([block]).reshape(-1, 3), axis=0) - origin_m)


def _add_mesh(spec: Any, name: str, corners_m: Floats) -> None:
    """The hull of some corners. They count from their middle: MuJoCo keeps them in float32."""
    middle = corners_m.mean(axis=0)
    spec.add_mesh(name=name, uservert=(corners_m - middle).ravel())
    spec.worldbody.add_geom(**standing(), type=mujoco().mjtGeom.mjGEOM_MESH, meshname=name, pos=middle)


def standing() -> dict[str, Any]:
    """What every geom has that robots meet."""
    return {"contype": STANDS, "conaffinity": MOVES, **_firm()}


def _lying() -> dict[str, Any]:
    return {"contype": LIES, "conaffinity": 0, **_firm()}


def hull() -> dict[str, Any]:
    """What the geom of a robot's hull has."""
    return {"contype": MOVES, "conaffinity": STANDS | MOVES | LIES, **_firm()}


def wheel() -> dict[str, Any]:
    """What the geoms of wheels have, for all but the ground."""
    return {"contype": MOVES, "conaffinity": STANDS | MOVES, **_firm()}


def _firm() -> dict[str, Any]:
    return {"friction": [FRICTION, 0, 0], "solref": SOLREF}


def solid(part: Part) -> dict[str, Any]:
    """What a geom of a part's shape has, in the frame of its body."""
    kinds, height = mujoco().mjtGeom, part.top_m - part.bottom_m
    place = [part.x_m, part.y_m, part.bottom_m + height / 2]
    if part.round:
        return {"type": kinds.mjGEOM_CYLINDER, "size": [part.length_m / 2, height / 2, 0], "pos": place}
    return {"type": kinds.mjGEOM_BOX, "size": [part.length_m / 2, part.width_m / 2, height / 2], "pos": place}


def turn(yaw_rad: float) -> list[float]:
    """Quaternion w x y z."""
    return [math.cos(yaw_rad / 2), 0.0, 0.0, math.sin(yaw_rad / 2)]
