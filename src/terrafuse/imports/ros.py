"""A ROS map as a contribution to an `occupancy` map."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from terrafuse import crs
from terrafuse.errors import InputError
from terrafuse.exchange.delta import Delta, TileCells, map_id
from terrafuse.grids import corner
from terrafuse.imports.base import Contribution, Wishes
from terrafuse.imports.place import first_cell, lattice_for, nearest, plain
from terrafuse.kernels import occupancy
from terrafuse.lattice import Lattice
from terrafuse.models import make_model
from terrafuse.models.base import Model
from terrafuse.rosmap.files import read_map
from terrafuse.rosmap.meaning import pixels
from terrafuse.rosmap.memory import NOTE, remember
from terrafuse.rosmap.types import Placement, RosMap
from terrafuse.tile import opaque
from terrafuse.types import Array, Floats, Stamp, TileKey

SURE_LOG_ODDS = 7.0
"""What 0 and 1 become, which no sum of readings ever is: p = 0.99909, which rounds to 100 of 100 and 255 of 255. The
map is read up to there. 18 rays of a lidar that pass through, of 0.405 each, take a wall away that is gone."""
REMEDY = "use --resample, and each cell takes the nearest pixel"


def take_ros_map(file: Path, wishes: Wishes) -> Contribution:
    """Every pixel that is known becomes a cell; the file's own numbers and pixels are kept as a note."""
    ros_map = read_map(file)
    resolution_m = wishes.resolution_m or plain(ros_map.placement.resolution_m)
    frame = crs.canonical(wishes.crs) if wishes.crs else None
    lattice = lattice_for(resolution_m, wishes.tile_m, frame)
    model = make_model("occupancy", {"max_log_odds": SURE_LOG_ODDS})
    remarks = _greys_lost(ros_map)
    try:
        first, placed = _on_lattice(ros_map, lattice, wishes.resample)
    except InputError as error:
        raise InputError(f"{file}: {error}") from error
    if placed is not ros_map:
        remarks += (f"resampled to cells of {resolution_m:g} m by nearest neighbours",)
    notes = {NOTE: {"robot": wishes.robot, "cell": list(first), **remember(placed)}}
    return Contribution(lattice, model, _deltas(placed.probability, first, lattice, model, wishes), notes, remarks)


def _greys_lost(ros_map: RosMap) -> tuple[str, ...]:
    """What an export will not have again."""
    grey = ros_map.grey
    between = 0 if grey.dtype == np.uint8 else int((grey != np.rint(grey)).sum())
    if not between:
        return ()
    return (
        f"colours or 16 bits became greys, {between:,} of {grey.size:,} between two of 256: an export has the nearest",
    )


def _on_lattice(ros_map: RosMap, lattice: Lattice, resample: bool) -> tuple[tuple[int, int], RosMap]:
    """(cell of the lower-left pixel, the map), resampled if it must be and may be."""
    place = ros_map.placement
    try:
        if place.yaw_rad != 0:
            raise InputError(f"yaw {place.yaw_rad:g} rad, and cells lie north-up; turn the map before, or {REMEDY}")
        if plain(place.resolution_m) != lattice.resolution_m:
            raise InputError(f"pixels of {place.resolution_m:g} m are no cells of {lattice.resolution_m:g} m; {REMEDY}")
        return first_cell(place.east_m, place.north_m, lattice, REMEDY), ros_map
    except InputError:
        if not resample:
            raise
    return resampled(ros_map, lattice)


def resampled(ros_map: RosMap, lattice: Lattice) -> tuple[tuple[int, int], RosMap]:
    """(cell of the lower-left pixel, the map north-up on the lattice): each cell takes the pixel that its centre lies
    in, and is unknown where it lies in none."""
    (i0, j0, *_), row, column, inside = nearest(ros_map.grid, lattice)
    seen = np.ones(inside.shape, bool) if ros_map.opaque is None else ros_map.opaque[row, column]
    nothing, nowhere_seen = pixels(np.full(inside.shape, np.nan), ros_map.meaning)
    grey = np.where(inside, ros_map.grey[row, column], nothing)
    seen = np.where(inside, seen, nowhere_seen is None)
    here = Placement(lattice.resolution_m, corner(lattice, i0), corner(lattice, j0))
    return (i0, j0), replace(ros_map, placement=here, grey=grey, opaque=None if seen.all() else seen)


def _deltas(values: Floats, first: tuple[int, int], lattice: Lattice, model: Model, wishes: Wishes) -> Iterator[Delta]:
    """A delta for each line of tiles; `values` (H, W) have row 0 in the north."""
    upward, side = values[::-1], lattice.tile_cells
    i0, j0 = first
    rows = upward.shape[0]
    for y in range(j0 // side, (j0 + rows - 1) // side + 1):
        low, high = max(y * side, j0), min((y + 1) * side, j0 + rows)
        j, i = np.nonzero(~np.isnan(upward[low - j0 : high - j0]))
        if len(i):
            cells = _cells(upward[low - j0 : high - j0][j, i], wishes.stamp_ns)
            tiles = _tiles(i + i0, j + low, y, cells, side)
            yield Delta(map_id(model.name, lattice), wishes.robot, 0, 1, wishes.stamp_ns, tiles)


def _cells(values: Floats, stamp_ns: Stamp) -> Array:
    """Occupancy cells of one reading each, of probabilities (K,)."""
    with np.errstate(divide="ignore"):
        log_odds = np.log(values / (1 - values)).clip(-SURE_LOG_ODDS, SURE_LOG_ODDS)
    cells = np.zeros(len(values), occupancy.CELL)
    cells["sum"] = np.rint(log_odds * occupancy.TICKS_PER_NAT)
    cells["stamp"], cells["updates"], cells["revision"] = stamp_ns, 1, 1
    return cells


def _tiles(i: Array, j: Array, y: int, cells: Array, side: int) -> tuple[TileCells, ...]:
    """Cells (i, j) of one line of tiles, in rising (j, i) order, by tile."""
    x, at = i // side, (j - y * side) * side + i % side
    parts = [(int(number), np.flatnonzero(x == number)) for number in np.unique(x)]
    return tuple(
        TileCells(TileKey(number, y), at[part].astype(np.int32), opaque(cells)[part].view(cells.dtype))
        for number, part in parts
    )
