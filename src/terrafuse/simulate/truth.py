"""The truth on any lattice, as arrays (H, W) [j, i] over a window of cells (i0, j0, i1, j1).

Heights, footprints and streets are those at the cells' centres; a cell is occupied where something solid reaches in.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np

from terrafuse.errors import InputError
from terrafuse.lattice import Lattice
from terrafuse.simulate.blocks import Block, half_extent, top_at
from terrafuse.simulate.movers import BODY, NO_BODIES
from terrafuse.simulate.movers import bodies as _bodies
from terrafuse.simulate.regions import ALLOWED
from terrafuse.simulate.streets import street_grid
from terrafuse.simulate.world import World
from terrafuse.types import Array, Floats
from terrafuse.views import CellWindow, shape_of

DEEPER_M = 1e-3
"""What reaches less deep into a cell does not occupy it: walls that end on a cell's border fill no further cell."""


class _Centres(NamedTuple):
    """Centres of a window's columns (W,) and rows (H,)."""

    x: Floats
    y: Floats

    def around(self, x: float, y: float, half: tuple[float, float]) -> tuple[slice, slice]:
        """The part [j, i] whose centres may lie within `half` (east, north) of a place."""
        i = slice(*np.searchsorted(self.x, (x - half[0] - 1e-6, x + half[0] + 1e-6)))
        j = slice(*np.searchsorted(self.y, (y - half[1] - 1e-6, y + half[1] + 1e-6)))
        return j, i


def height(world: World, lattice: Lattice, window: CellWindow, bodies: Array = NO_BODIES) -> Floats:
    """z of what is seen from above, NaN off the terrain; with `bodies`, as of `World.bodies(time_s)`, of these too."""
    centres = _centres(lattice, window)
    z = ground(world, lattice, window)
    for part, top in _tops(world.blocks, centres):
        z[part] = np.where(np.isfinite(top), np.fmax(z[part], top), z[part])
    for body in bodies:
        j, i = part = centres.around(body["x"], body["y"], _half_extent(body))
        covered = _covers(body, centres.x[i], centres.y[j, None])
        z[part] = np.where(covered, np.fmax(z[part], body["top"]), z[part])
    return z


def ground(world: World, lattice: Lattice, window: CellWindow) -> Floats:
    """z of the terrain, whatever stands on it; NaN off it."""
    x, y = _centres(lattice, window)
    return world.terrain.height(x, y[:, None])


def footprints(world: World, lattice: Lattice, window: CellWindow, kinds: Iterable[str] = ("house",)) -> Array:
    """Which cells' centres lie under something of these kinds (`Block.kind`)."""
    wanted, centres = set(kinds), _centres(lattice, window)
    out = np.zeros(shape_of(window), bool)
    for part, top in _tops([block for block in world.blocks if block.kind in wanted], centres):
        out[part] |= np.isfinite(top)
    return out


def streets(world: World, lattice: Lattice, window: CellWindow) -> Array:
    """Which cells' centres lie on a street."""
    return street_grid(world.streets, *_centres(lattice, window))


def static_layer(world: World, name: str, lattice: Lattice, window: CellWindow) -> Array:
    """`gps_quality` or `communications` at the cells' centres, uint8. Raises InputError for another name."""
    if name not in ALLOWED:
        raise InputError(f"static layer '{name}': there are {', '.join(ALLOWED)}")
    x, y = _centres(lattice, window)
    layer = world.gps_quality if name == "gps_quality" else world.communications
    return layer.at(x, y[:, None])


def occupied(
    world: World, lattice: Lattice, window: CellWindow, band_m: tuple[float, float], bodies: Array = NO_BODIES
) -> Array:
    """Which cells something solid reaches into, between two heights above the ground at its centre.

    A block counts with its whole footprint if any of it is in the band: what has a roof also has walls below it.
    """
    low, high = band_m
    if not low < high:
        raise InputError(f"band from {low} to {high} m: give the lower height first")
    centres, out = _centres(lattice, window), np.zeros(shape_of(window), bool)
    for solid in _bodies([_solids(world.blocks), bodies]):
        z = float(world.terrain.height(solid["x"], solid["y"]))
        if solid["bottom"] < z + high and solid["top"] > z + low:
            _mark(out, solid, centres, lattice.resolution_m / 2)
    return out


def _centres(lattice: Lattice, window: CellWindow) -> _Centres:
    i0, j0, i1, j1 = window
    return _Centres(lattice.cell_centre(np.arange(i0, i1)), lattice.cell_centre(np.arange(j0, j1)))


def _tops(blocks: Iterable[Block], centres: _Centres) -> Iterator[tuple[tuple[slice, slice], Floats]]:
    """Of each block, the part of the window that it may cover, and its top there, -inf beside it."""
    for block in blocks:
        j, i = centres.around(block.x_m, block.y_m, half_extent(block))
        yield (j, i), top_at(block, centres.x[i], centres.y[j, None])


def _solids(blocks: tuple[Block, ...]) -> Array:
    """Blocks as bodies: what lies between bottom and top over their footprints."""
    rows = [
        (b.x_m, b.y_m, b.bottom_m, b.top_m, b.length_m / 2, b.width_m / 2, math.cos(b.yaw_rad), math.sin(b.yaw_rad), 0)
        for b in blocks
    ]
    return np.array(rows, BODY)


def _half_extent(solid: Any) -> tuple[float, float]:
    if solid["round"]:
        return float(solid["half_length"]), float(solid["half_length"])
    c, s, length, width = abs(solid["cos"]), abs(solid["sin"]), solid["half_length"], solid["half_width"]
    return float(c * length + s * width), float(s * length + c * width)


def _covers(solid: Any, x: Floats, y: Floats) -> Array:
    """Which places lie on a solid's footprint, its edge included."""
    x, y = x - solid["x"], y - solid["y"]
    if solid["round"]:
        return np.asarray(x * x + y * y <= solid["half_length"] ** 2)
    u, v = solid["cos"] * x + solid["sin"] * y, solid["cos"] * y - solid["sin"] * x
    return np.asarray((abs(u) <= solid["half_length"]) & (abs(v) <= solid["half_width"]))


def _mark(out: Array, solid: Any, centres: _Centres, half_cell: float) -> None:
    """Rectangle against square: apart if they are so along one of their sides' directions. Circle against square: apart
    if the square's nearest place is outside."""
    east, north = _half_extent(solid)
    margin = half_cell - DEEPER_M
    j, i = part = centres.around(solid["x"], solid["y"], (east + margin, north + margin))
    x, y = centres.x[i] - solid["x"], centres.y[j, None] - solid["y"]
    if solid["round"]:
        beside = np.hypot(np.maximum(abs(x) - half_cell, 0), np.maximum(abs(y) - half_cell, 0))
        out[part] |= beside < solid["half_length"] - DEEPER_M
        return
    u, v = solid["cos"] * x + solid["sin"] * y, solid["cos"] * y - solid["sin"] * x
    reach = half_cell * (abs(solid["cos"]) + abs(solid["sin"])) - DEEPER_M
    out[part] |= (abs(u) < solid["half_length"] + reach) & (abs(v) < solid["half_width"] + reach)
