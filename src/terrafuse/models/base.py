"""The interface of a cell model: what a cell holds, how a scan changes it, how robots' cells become one.

A model is a frozen object in the dict `terrafuse.models.MODELS`. Rules that hold for all:

* A cell record of all zeros is the unknown cell; memory and files hold nothing for space that nobody saw.
* The record has the fields `stamp` (int64, ns UTC of its last update) and `revision` (uint32, the number of the robot's
  scan that last changed it; it only grows). The newest revision of a cell replaces any older one.
* `fuse` is deterministic and takes unknown as neutral.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from terrafuse.errors import InputError
from terrafuse.kernels.cones import MAX_BAND_CELLS
from terrafuse.kernels.grouping import by_tile
from terrafuse.lattice import Lattice
from terrafuse.tile import RecordTile, Tile, opaque
from terrafuse.types import Array, Floats, Scan, Stamp, TileKey


class AnyPatch(Protocol):
    """The evidence of one scan: only the cells that it touched."""

    @property
    def keys(self) -> Sequence[TileKey]:
        """The tiles that it touched, each once."""

    @property
    def cells(self) -> int:
        """How many cells it touched."""

    @property
    def points(self) -> int:
        """Points of the scan."""

    @property
    def dropped(self) -> Mapping[str, int]:
        """Points that did not count, by reason."""

    def merge_into(self, tiles: Sequence[Any], stamp_ns: int, revision: int) -> None:
        """Merge into these tiles, one for each key in the same order. `revision` is larger than any before."""


@dataclass(frozen=True, eq=False)
class Patch:
    """A patch as records grouped by tile: what a model needs that has no layout of its own.

    Records `starts[t]:starts[t + 1]` belong to tile `keys[t]`; `at` has each one's flat position in its tile,
    j·tile_cells + i, each position once. The arrays are the observer's scratch: they hold until its
    next scan.
    """

    keys: Sequence[TileKey]
    starts: Array
    at: Array
    records: Array
    points: int
    dropped: Mapping[str, int]
    """Points that did not count, by reason."""

    @property
    def cells(self) -> int:
        return len(self.at)

    def merge_into(self, tiles: Sequence[RecordTile], stamp_ns: int, revision: int) -> None:
        for t, tile in enumerate(tiles):
            part = slice(self.starts[t], self.starts[t + 1])
            tile.merge(self.at[part], self.records[part], stamp_ns, revision)


@dataclass(frozen=True, eq=False)
class UnsortedPatch:
    """A patch as its kernel made it: (K,) records in the order in which the cells were met, of which number k belongs
    to position at[k] of the tile keys[tile_of[k]].

    The arrays are the observer's scratch: they hold until its next scan. A model that has such patches adds
    `merge_into`, one call of its kernel for all tiles.
    """

    keys: Sequence[TileKey]
    tile_of: Array
    at: Array
    records: Array
    points: int
    dropped: Mapping[str, int]

    @property
    def cells(self) -> int:
        return len(self.at)


def checked_ends(what: str, ends: Array) -> Array:
    """A scan's points, misses or origins as kernels take them: (N, 3 or more), float32 or float64, contiguous."""
    if ends.ndim != 2 or ends.shape[1] < 3:
        raise InputError(f"a scan's {what} are (N, 3), not {ends.shape}")
    if ends.dtype not in (np.float32, np.float64):
        ends = ends.astype(np.float64)
    return np.ascontiguousarray(ends)


def checked_origins(scan: Scan) -> Array | None:
    """A scan's origins as kernels take them, one for each of its points and misses; None where it states none."""
    if scan.origins is None:
        return None
    count = len(scan.points) + (0 if scan.misses is None else len(scan.misses))
    origins = checked_ends("origins", scan.origins)
    if len(origins) != count:
        raise InputError(f"a scan of {count} points and misses has {len(origins)} origins; give one for each")
    return origins


def check_band(what: str, half_m: float, lattice: Lattice, remedy: str) -> None:
    """Raise InputError for a sonar's band of so much either way, beyond what bounds the memory of a scan."""
    if not half_m * lattice.cells_per_m <= MAX_BAND_CELLS:
        raise InputError(
            f"{what} of {half_m:.6g} m is over {MAX_BAND_CELLS} cells of {lattice.resolution_m:.6g} m: "
            f"{remedy}, or use larger cells"
        )


def patch_of(
    i: Array, j: Array, records: Array, lattice: Lattice, points: int, dropped: Mapping[str, int] | None = None
) -> Patch:
    """The patch of these records, one for each cell (i, j) of the lattice; cells are distinct, in any order."""
    keys, starts, at, order = by_tile(i, j, lattice.tile_cells)
    grouped = opaque(records)[order].view(records.dtype)
    return Patch([TileKey(int(x), int(y)) for x, y in keys], starts, at, grouped, points, dropped or {})


class Observer(Protocol):
    """Turns scans into patches; holds the scratch memory of one robot. Not for two threads at once."""

    def __call__(self, scan: Scan) -> AnyPatch: ...


@dataclass(frozen=True)
class Reading:
    """What a layer is read with, beside the cells: their lattice, and the time.

    `now_ns` is the stamp of the newest report in the map, so that the age of a cell, too, is a function of what robots
    reported and not of the clock on the wall.
    """

    lattice: Lattice
    now_ns: Stamp


@dataclass(frozen=True)
class Layer:
    """A named 2D array that people, planners and files see.

    `compute(cells, reading)` takes (H, W) cell records, [j, i], and gives a (H, W) float64 array, NaN where unknown.
    A layer that looks at neighbours states how many cells around it needs as `halo`; it gets them as unknown cells
    where there are none.
    """

    name: str
    unit: str
    description: str
    compute: Callable[[Array, Reading], Floats]
    halo: int = 0


class Model(Protocol):
    """One way to believe a sensor."""

    @property
    def name(self) -> str: ...

    @property
    def cell(self) -> np.dtype[Any]:
        """Structured dtype of a cell record."""

    @property
    def layers(self) -> Mapping[str, Layer]: ...

    @property
    def picture_layer(self) -> str:
        """The layer that a picture of the map shows."""

    @property
    def fold_by_name(self) -> bool:
        """Whether robots' cells are fused in the order of their names alone, whatever the stamps; False is usual."""

    @property
    def occupied(self) -> Layer:
        """How surely a cell is in a robot's way, 0 to 1: what becomes a ROS map. It need not be among the layers."""

    def settings(self) -> dict[str, Any]:
        """What makes two maps comparable: stored with a map, plain JSON."""

    def observer(self, lattice: Lattice) -> Observer: ...

    def tile(self, lattice: Lattice) -> Tile:
        """A new tile of a robot's own map, all unknown; the observer's patches merge into such."""

    def fuse(self, older: Array, newer: Array, lattice: Lattice) -> Array:
        """The next step of the fold: (M,) cells of robots so far, (M,) of the next robot → (M,)."""

    def coarsen(self, cells: Array, factor: int) -> Array:
        """(H, W) cells of one robot → (H/k, W/k)."""

    def known(self, cells: Array) -> Array:
        """Which cells somebody observed, as booleans of the same shape."""

    def check(self, cells: Array) -> str | None:
        """What is wrong with (K,) cells that a robot reports, which no mapper makes; None: nothing.

        A delta with such cells is refused whole: messages come from anywhere, and one bad cell would stay for good.
        """


def first_flaw(flaws: Mapping[str, Array]) -> str | None:
    """The first of these that is True of any cell."""
    return next((flaw for flaw, cells in flaws.items() if cells.any()), None)


def fold(model: Model, contributions: Sequence[Array], lattice: Lattice) -> Array:
    """The global cells: `model.fuse` over the robots' cells in the order (stamp, robot), for each cell its own order.

    A model whose `fold_by_name` is true has them fused in the order of the robots' names alone, whatever the stamps.

    `contributions`: (M,) cells of each robot, in the order of the robots' names. This is the one definition of the
    global map: whatever way contributions came, the same ones give the same bytes.
    """
    if len(contributions) == 1:
        return contributions[0].copy()
    ordered = contributions if model.fold_by_name else _by_stamp(contributions)
    fused = ordered[0]
    for newer in ordered[1:]:
        fused = model.fuse(fused, newer, lattice)
    return np.asarray(fused)


def _by_stamp(contributions: Sequence[Array]) -> Sequence[Array]:
    """(robots, M) cells, each column sorted by stamp; equal stamps keep the order of the names."""
    stamps = np.stack([cells["stamp"] for cells in contributions])
    wrong = np.flatnonzero((stamps[1:] < stamps[:-1]).any(axis=0))
    if not len(wrong):
        return contributions
    order = np.argsort(stamps[:, wrong], axis=0, kind="stable")
    sorted_ = np.stack([opaque(cells) for cells in contributions])
    sorted_[:, wrong] = np.take_along_axis(sorted_[:, wrong], order, axis=0)
    return list(sorted_.view(contributions[0].dtype))
