"""What stands: upright blocks on a rectangle, with a flat, gabled or hipped roof. Houses, walls and parked cars are
made of them.

A block's own frame has u along its length, v across, from its centre. Its top is the lowest of some planes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from terrafuse.errors import InputError
from terrafuse.types import Array, Floats


@dataclass(frozen=True)
class Block:
    """All heights are z in the world. `yaw_rad` turns u from east to north."""

    kind: str
    """What it belongs to: house, wall, car, …"""
    x_m: float
    y_m: float
    length_m: float
    width_m: float
    yaw_rad: float
    bottom_m: float
    eaves_m: float
    """Where the upright walls end and the roof begins."""
    top_m: float
    roof: str = "flat"

    def __post_init__(self) -> None:
        if not (self.length_m > 0 and self.width_m > 0):
            raise InputError(f"a {self.kind} of {self.length_m} m × {self.width_m} m: give positive sides")
        if not self.bottom_m < self.eaves_m <= self.top_m < math.inf:
            raise InputError(
                f"a {self.kind} from z {self.bottom_m} over {self.eaves_m} to {self.top_m} m: let them rise"
            )
        if self.roof not in ROOFS:
            raise InputError(f"roof '{self.roof}': there are {', '.join(ROOFS)}")
        if self.roof == "hip" and self.length_m < self.width_m:
            raise InputError("a hipped roof's ridge runs along the longer side; swap the sides and turn it by 90°")


@dataclass(frozen=True)
class Roof:
    """`share(u, v, block)` is how high the roof is between the eaves (0) and the top (1), over the footprint.

    The solid: corners (a, b, v, level), at u = a·L/2 + b·(L − W)/2, v·W/2, and bottom, eaves or top by the level; faces
    list corners anticlockwise as seen from outside. It is open below.
    """

    share: Callable[[Floats, Floats, Block], Floats]
    corners: tuple[tuple[float, float, float, int], ...]
    faces: tuple[tuple[int, ...], ...]


def turned(block: Block, x_m: Array | float, y_m: Array | float) -> tuple[Floats, Floats]:
    """(u, v) of places in the world."""
    c, s = math.cos(block.yaw_rad), math.sin(block.yaw_rad)
    east, north = np.asarray(x_m) - block.x_m, np.asarray(y_m) - block.y_m
    return c * east + s * north, c * north - s * east


def top_at(block: Block, x_m: Array | float, y_m: Array | float) -> Floats:
    """z of its top at (x, y); -inf beside it."""
    u, v = turned(block, x_m, y_m)
    share = ROOFS[block.roof].share(u, v, block)
    inside = (abs(u) <= block.length_m / 2) & (abs(v) <= block.width_m / 2)
    return np.where(inside, block.eaves_m + (block.top_m - block.eaves_m) * share, -np.inf)


def corners_of(block: Block) -> Floats:
    """(4, 2): its footprint, anticlockwise."""
    c, s = math.cos(block.yaw_rad), math.sin(block.yaw_rad)
    u = block.length_m / 2 * np.array([-1.0, 1.0, 1.0, -1.0])
    v = block.width_m / 2 * np.array([-1.0, -1.0, 1.0, 1.0])
    return np.stack([block.x_m + c * u - s * v, block.y_m + s * u + c * v], axis=1)


def half_extent(block: Block) -> tuple[float, float]:
    """How far it reaches east and north of its centre."""
    c, s = abs(math.cos(block.yaw_rad)), abs(math.sin(block.yaw_rad))
    return (block.length_m * c + block.width_m * s) / 2, (block.length_m * s + block.width_m * c) / 2


def overlap(one: Block, other: Block, apart_m: float = 0.0) -> bool:
    """Whether their footprints are nearer than `apart_m` (seen along the four sides, so corners count as nearer)."""
    for block, strange in ((one, other), (other, one)):
        u, v = turned(block, *corners_of(strange).T)
        for place, half in ((u, block.length_m / 2), (v, block.width_m / 2)):
            if place.min() >= half + apart_m or place.max() <= -half - apart_m:
                return False
    return True


def triangles_of(blocks: Sequence[Block]) -> Floats:
    """(K, 3, 3): their faces as triangles, anticlockwise from outside, roof by roof in the order of `ROOFS`."""
    parts = [_faces(roof, [b for b in blocks if b.roof == name]) for name, roof in ROOFS.items()]
    return np.concatenate(parts)


def _faces(roof: Roof, blocks: list[Block]) -> Floats:
    fans = [(face[0], face[k], face[k + 1]) for face in roof.faces for k in range(1, len(face) - 1)]
    return _corners(roof, blocks)[:, np.array(fans)].reshape(-1, 3, 3)


def _corners(roof: Roof, blocks: list[Block]) -> Floats:
    """(K, corners, 3)."""
    columns = "x_m", "y_m", "length_m", "width_m", "yaw_rad"
    x, y, length, width, yaw = np.array([[getattr(b, c) for c in columns] for b in blocks]).reshape(-1, 5).T[..., None]
    levels = np.array([(b.bottom_m, b.eaves_m, b.top_m) for b in blocks]).reshape(-1, 3)
    a, b, v, level = np.array(roof.corners).T
    along = a * length / 2 + b * (length - width) / 2
    across = v * width / 2
    c, s = np.cos(yaw), np.sin(yaw)
    out = [x + c * along - s * across, y + s * along + c * across, levels[:, level.astype(int)]]
    return np.stack(out, axis=-1)


def _flat(u: Floats, v: Floats, block: Block) -> Floats:
    return np.ones(np.broadcast(u, v).shape)


def _gable(u: Floats, v: Floats, block: Block) -> Floats:
    return np.broadcast_to(1 - abs(v) / (block.width_m / 2), np.broadcast(u, v).shape)


def _hip(u: Floats, v: Floats, block: Block) -> Floats:
    """All four sides rise at one slope: half the width from the eaves to the ridge."""
    half = block.width_m / 2
    return np.asarray(np.minimum(half - abs(v), block.length_m / 2 - abs(u)) / half)


def _square(level: int) -> tuple[tuple[float, float, float, int], ...]:
    return tuple((a, 0.0, v, level) for a, v in ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)))


_WALLS = ((0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))

ROOFS: dict[str, Roof] = {
    "flat": Roof(_flat, (*_square(0), *_square(2)), (*_WALLS, (4, 5, 6, 7))),
    "gable": Roof(
        _gable,
        (*_square(0), *_square(1), (-1.0, 0.0, 0.0, 2), (1.0, 0.0, 0.0, 2)),
        ((0, 1, 5, 4), (1, 2, 6, 9, 5), (2, 3, 7, 6), (3, 0, 4, 8, 7), (4, 5, 9, 8), (6, 7, 8, 9)),
    ),
    "hip": Roof(
        _hip,
        (*_square(0), *_square(1), (0.0, -1.0, 0.0, 2), (0.0, 1.0, 0.0, 2)),
        (*_WALLS, (4, 5, 9, 8), (6, 7, 8, 9), (5, 6, 9), (7, 4, 8)),
    ),
}
