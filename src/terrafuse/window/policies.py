"""The policies: where the robot is → which tiles are inside its window."""

from __future__ import annotations

import math
from typing import Protocol

from terrafuse.errors import InputError
from terrafuse.lattice import Lattice
from terrafuse.types import TileKey
from terrafuse.window.area import EVERYWHERE, Area, disc, rectangle

MAX_ACROSS = 256
"""Tiles: each is looked at when a window moves, and a robot that needs more has tiles of the wrong size."""

_MORE = {True: " over 0", False: ", 0 or more"}


class Window(Protocol):
    """Made for one robot on one lattice; asked once a scan, so it answers in microseconds."""

    def around(self, east_m: float, north_m: float) -> Area:
        """The tiles inside the window of a robot that is here now."""


class KeepAll:
    """Every tile stays."""

    def __init__(self, lattice: Lattice) -> None:
        pass

    def around(self, east_m: float, north_m: float) -> Area:
        return EVERYWHERE


class NineBlock:
    """3×3 blocks around the robot's block: grid configuration 1 of the *database* paper. A block is a tile.

    There is no hysteresis: leaving the middle block sideways adds three blocks and drops three, diagonally five.
    """

    def __init__(self, lattice: Lattice) -> None:
        self._lattice = lattice

    def around(self, east_m: float, north_m: float) -> Area:
        return _three_by_three(self._lattice.tile_at(east_m, north_m))


class Tiles3x3:
    """3×3 tiles around the robot, with the hysteresis of the *tiles* paper.

    The window moves only when the robot leaves its central half (0.75 tiles from the middle on either axis), and then
    centres on the robot's tile: someone who walks along a tile border, or to and fro across it, moves it once.
    """

    def __init__(self, lattice: Lattice) -> None:
        self._lattice = lattice
        self._middle: tuple[float, float] | None = None
        self._area: Area = EVERYWHERE

    def around(self, east_m: float, north_m: float) -> Area:
        if self._middle is None or self._strayed(*_in_tiles(self._lattice, east_m, north_m), *self._middle):
            tile = self._lattice.tile_at(east_m, north_m)
            self._middle = tile.x + 0.5, tile.y + 0.5
            self._area = _three_by_three(tile)
        return self._area

    @staticmethod
    def _strayed(x: float, y: float, middle_x: float, middle_y: float) -> bool:
        return max(abs(x - middle_x), abs(y - middle_y)) > 0.75


class Radius:
    """What the robot can see before its next update: R = r + δt·V, equation 3 of the *database* paper.

    Tiles that the disc of this radius around the robot meets. `range_m` is the reach of its sensor, `period_s` the time
    between two updates, `speed_mps` the most that it drives. Raises InputError unless R is a sensible length.
    """

    def __init__(self, lattice: Lattice, range_m: float = 50.0, period_s: float = 0.1, speed_mps: float = 20.0) -> None:
        for name, value in (("range_m", range_m), ("period_s", period_s), ("speed_mps", speed_mps)):
            if not (math.isfinite(value) and value >= 0) or (name == "range_m" and value == 0):
                raise InputError(f"window radius: {name}={value:g}: give a finite number{_MORE[name == 'range_m']}")
        self.radius_m = range_m + period_s * speed_mps
        self._lattice = lattice
        self._radius_tiles = self.radius_m / lattice.tile_m
        _check_across("radius", 2 * self._radius_tiles)

    def around(self, east_m: float, north_m: float) -> Area:
        return disc(*_in_tiles(self._lattice, east_m, north_m), self._radius_tiles)


class Centred:
    """A square of `cells`×`cells` cells with the robot's cell in its middle: the *patrol* paper's local map.

    Tiles that the square meets. Of an even number of cells one more lies south and west of the robot's.
    """

    def __init__(self, lattice: Lattice, cells: float = 320) -> None:
        if not (cells >= 1 and math.isfinite(cells) and cells == int(cells)):
            raise InputError(f"window centred: cells={cells:g}: give a whole number over 0; the paper has 320")
        _check_across("centred", cells / lattice.tile_cells)
        self._cells = int(cells)
        self._lattice = lattice

    def around(self, east_m: float, north_m: float) -> Area:
        per_tile = self._lattice.tile_cells
        west, south = (math.floor(v * self._lattice.cells_per_m) - self._cells // 2 for v in (east_m, north_m))
        east, north = west + self._cells - 1, south + self._cells - 1
        return rectangle(west // per_tile, south // per_tile, east // per_tile + 1, north // per_tile + 1)


def _three_by_three(tile: TileKey) -> Area:
    return rectangle(tile.x - 1, tile.y - 1, tile.x + 2, tile.y + 2)


def _in_tiles(lattice: Lattice, east_m: float, north_m: float) -> tuple[float, float]:
    """The place in tile sides, by the arithmetic that puts points into cells."""
    return east_m * lattice.cells_per_m / lattice.tile_cells, north_m * lattice.cells_per_m / lattice.tile_cells


def _check_across(window: str, tiles: float) -> None:
    if tiles > MAX_ACROSS:
        raise InputError(
            f"window {window}: {tiles:,.0f} tiles across; at most {MAX_ACROSS}: make it smaller, "
            "or the tiles larger (--tile), or keep everything (--window all)"
        )
