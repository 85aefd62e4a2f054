"""`terrain`: heights, slopes, how passable a cell is and how sure all that is.

Matta-Gómez, Del Cerro & Barrientos, "Multi-robot data mapping simulation by using Microsoft Robotics Developer Studio"
(the *patrol* paper).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import pairwise
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from terrafuse.errors import InputError
from terrafuse.kernels import (
    rasterise,
    terrain,
    terrain_coarsen,
    terrain_fuse,
    terrain_merge,
    terrain_planes,
    terrain_points,
)
from terrafuse.lattice import Lattice
from terrafuse.models.base import Layer, Reading, UnsortedPatch, checked_ends, first_flaw, patch_of
from terrafuse.tile import RecordTile
from terrafuse.types import Array, Floats, Scan, Stamp, TileKey

DEFAULT_RANGE_M = 50.0
"""Maximum range of a sensor that does not state one."""

FARTHEST_M = 1e8
STAGES = ("collision points", "heights", "gradients", "confidence", "occupation")
"""Of a scan, as in the paper's table 2."""


@dataclass(frozen=True)
class Terrain:
    """The terrain model's settings; an instance is the model."""

    max_slope: float = 0.3
    """|∇z| that a robot can just overcome: there the occupation reaches 1."""
    subcells: int = 16
    """Parts of a cell, of which the share that is hit is its confidence. A square number up to 64; let it grow with the
    cell's area."""
    min_range_m: float = 0.0
    max_range_m: float | None = None
    """Points beyond it are dropped, and confidence falls towards it. None: the scan's own where it states one, else
    50 m. For clouds in the world's frame, whose sensor nobody knows, give a large number (up to 1e8)."""
    half_life_s: float | None = 600.0
    """Time in which confidence halves; None: it does not age."""
    similar_angle_rad: float = math.radians(10)
    """Cells whose normals are further apart show different surfaces."""
    similar_height_m: float | None = 0.3
    """Cells whose heights are further apart do so, too; in large cells it is max_slope times their side, if that is
    more. None: heights tell nothing, as in the paper."""
    confidence_gap: float = 2 / 16
    """Of two cells that differ by more, the surer one is believed."""
    confidence_high: float = 0.5
    """Two cells that are this sure and disagree mean that the world has changed."""
    coarse_confidence: float = 2 / 16
    """With at least this confidence, a cell counts for the occupation of a coarser one."""
    point_sigma_m: float = 0.01
    """Standard error of a measured point, in any direction. It says which points lie on a line, and how far off the
    slope of a plane may be: gradients tell surfaces apart, and make an occupation, as far as that error lets them."""

    wall_slope: float | None = 1.5
    """Points of a cell that reach over more height than ground so steep does from corner to corner stand for a wall,
    whose height is that of its top. None: they have a mean or a plane, as in the paper."""

    name = "terrain"
    cell = terrain.CELL
    picture_layer = "height"
    fold_by_name = False

    def __post_init__(self) -> None:
        if math.isqrt(max(self.subcells, 0)) ** 2 != self.subcells or not 1 <= self.subcells <= 64:
            raise InputError(f"subcells {self.subcells}: give a square number from 1 to 64, such as 16, 25 or 64")
        for field in (
            "max_slope", "half_life_s", "similar_angle_rad", "similar_height_m", "point_sigma_m", "wall_slope",
        ):  # fmt: skip
            value = getattr(self, field)
            if value is not None and not 0 < value < math.inf:
                raise InputError(f"{field} {value}: give a positive number")
        for field in ("confidence_gap", "confidence_high", "coarse_confidence"):
            if not 0 <= getattr(self, field) <= 1:
                raise InputError(f"{field} {getattr(self, field)}: give a number from 0 to 1")
        farthest_m = FARTHEST_M if self.max_range_m is None else self.max_range_m
        if not 0 <= self.min_range_m < farthest_m <= FARTHEST_M:
            raise InputError(f"range gate {self.min_range_m} to {self.max_range_m} m: give 0 ≤ min < max ≤ 1e8 m")

    def settings(self) -> dict[str, Any]:
        return asdict(self)

    def rules(self, resolution_m: float) -> terrain.Rules:
        """The thresholds for cells of this side."""
        least_m = math.inf if self.similar_height_m is None else self.similar_height_m
        return terrain.Rules(
            math.cos(self.similar_angle_rad),
            max(least_m, self.max_slope * resolution_m),
            self.confidence_gap,
            self.confidence_high,
            0.0 if self.half_life_s is None else 1e-9 / self.half_life_s,
            self.max_slope,
            self.coarse_confidence,
        )

    def shape(self, resolution_m: float) -> terrain_planes.Shape:
        """What tells planes, walls and loose points apart in cells of this side."""
        wall_m = math.inf if self.wall_slope is None else self.wall_slope * math.sqrt(2) * resolution_m
        return terrain_planes.Shape(self.point_sigma_m, wall_m, self.rules(resolution_m).height_tolerance / 3)

    def range_m(self, scan: Scan) -> float:
        """The maximum range that counts for a scan."""
        if self.max_range_m is not None:
            return self.max_range_m
        stated_m = scan.beam.max_range_m
        return min(stated_m, FARTHEST_M) if math.isfinite(stated_m) else DEFAULT_RANGE_M

    def observer(self, lattice: Lattice) -> TerrainObserver:
        return TerrainObserver(self, lattice)

    def tile(self, lattice: Lattice) -> TerrainTile:
        return TerrainTile(lattice.tile_cells, self.cell, partial(_merge, self.rules(lattice.resolution_m)))

    def fuse(self, older: Array, newer: Array, lattice: Lattice) -> Array:
        """By the stamps, whatever the order of the arguments; of equal stamps the surer counts as the newer."""
        out = np.ascontiguousarray(older).copy()
        terrain_fuse.fuse(out, np.ascontiguousarray(newer), self.rules(lattice.resolution_m))
        return out

    def coarsen(self, cells: Array, factor: int) -> Array:
        if factor == 1:
            return cells.copy()
        out = np.zeros((cells.shape[0] // factor, cells.shape[1] // factor), self.cell)
        terrain_coarsen.coarsen(np.ascontiguousarray(cells), factor, self.rules(0.0), out)
        return out

    def known(self, cells: Array) -> Array:
        """Cells of which anything is known, be it only what was given with the scenario."""
        return np.asarray(cells["flags"] != 0)

    def check(self, cells: Array) -> str | None:
        values, flags = {name: cells[name] for name in terrain.FLAG_OF}, cells["flags"]
        unflagged = [(value != 0) & (flags & terrain.FLAG_OF[name] == 0) for name, value in values.items()]
        return first_flaw({
            "values that are not finite": np.any([~np.isfinite(value) for value in values.values()], axis=0),
            "values that their flags call unknown": np.any(unflagged, axis=0),
            "a negative gradient_error": cells["gradient_error"] < 0,
            "an occupation outside 0 to 1": (cells["occupation"] < 0) | (cells["occupation"] > 1),
            "a confidence outside 0 to 254/255": ~((cells["confidence"] >= 0)
                                                   & (cells["confidence"] <= terrain.MOST_CONFIDENT)),
            "no flag, or one that there is not": (flags == 0) | (flags & ~terrain.FLAGS != 0),
            "a gps_quality over 2 or communications over 1": (cells["gps_quality"] > 3) | (cells["communications"] > 2),
        })  # fmt: skip

    def prior(
        self,
        height_m: ArrayLike,
        confidence: ArrayLike,
        gps_quality: ArrayLike | None = None,
        communications: ArrayLike | None = None,
        stamp_ns: Stamp = 0,
    ) -> Array:
        """(K,) records of what is known beforehand: they do not age, and their gradients are unknown.

        `height_m` (K,), NaN where only the static layers are given; `confidence` (K,) from 0 to 1; `gps_quality` (K,) 0
        none, 1 single, 2 differential; `communications` (K,) 0 or 1; NaN in these two where not given. A cell of NaN
        everywhere is unknown. Raises InputError for other values.
        """
        height = np.asarray(height_m, np.float64)
        known = ~np.isnan(height)
        out = np.zeros(height.shape, self.cell)
        out["height"] = np.where(known, height, 0.0)
        sure = np.where(known, np.asarray(confidence, np.float64), 0.0)
        if np.isinf(height).any() or not ((sure >= 0) & (sure <= 1)).all():
            raise InputError("a prior map needs finite heights (NaN: none), with confidence from 0 to 1")
        out["confidence"] = np.minimum(sure, terrain.MOST_CONFIDENT)
        out["gps_quality"] = _static("gps_quality", gps_quality, 2)
        out["communications"] = _static("communications", communications, 1)
        something = known | (out["gps_quality"] > 0) | (out["communications"] > 0)
        out["flags"] = np.where(known, terrain.HEIGHT, 0) | np.where(something, terrain.PRIOR, 0)
        out["stamp"], out["revision"] = np.where(something, stamp_ns, 0), something
        return out

    @property
    def layers(self) -> Mapping[str, Layer]:
        return {layer.name: layer for layer in self._layers()}

    def _layers(self) -> list[Layer]:
        return [
            Layer("height", "m", "height at the cell's centre", _field("height", terrain.HEIGHT)),
            Layer("gradient_x", "1", "slope dz/dx towards the east", _field("gradient_x", terrain.GRADIENT_X)),
            Layer("gradient_y", "1", "slope dz/dy towards the north", _field("gradient_y", terrain.GRADIENT_Y)),
            Layer(
                "gradient_error",
                "1",
                "standard error of the gradients, of the worse direction",
                _field("gradient_error", terrain.GRADIENTS),
            ),
            self.occupied,
            Layer("confidence", "1", "how sure the cell is by now, 0 to 255", self.confidence),
            Layer("stamp", "s", "last update, seconds since 1970 UTC", lambda c, _: _where(self.known(c), _seconds(c))),
            Layer("gps_quality", "1", "0 none, 1 single, 2 differential", lambda c, _: _given(c, "gps_quality")),
            Layer("communications", "1", "0 none, 1 there is a link", lambda c, _: _given(c, "communications")),
        ]

    @property
    def occupied(self) -> Layer:
        return Layer(
            "occupation",
            "1",
            "slope as a share of what is passable: 0 level to 1 impassable",
            _field("occupation", terrain.OCCUPATION),
        )

    def confidence(self, cells: Array, reading: Reading) -> Floats:
        """0 to 255, aged to the time of reading; 0 where only static layers are given."""
        aged = terrain.aged_at(cells.reshape(-1), reading.now_ns, self.rules(0.0)).reshape(cells.shape)
        return _where(self.known(cells), 255.0 * aged)


def _where(known: Array, values: Array) -> Floats:
    return np.where(known, values.astype(np.float64), np.nan)


def _field(name: str, flag: np.uint16) -> Any:
    return lambda cells, _: _where(cells["flags"] & flag != 0, cells[name])


def _seconds(cells: Array) -> Floats:
    return np.asarray(cells["stamp"] * 1e-9)


def _given(cells: Array, name: str) -> Floats:
    return _where(cells[name] > 0, cells[name] - 1.0)


def _static(name: str, values: ArrayLike | None, most: int) -> Array | int:
    """As it is stored: value + 1, and 0 where not given."""
    if values is None:
        return 0
    given = np.asarray(values, np.float64)
    if not (np.isnan(given) | np.isin(given, range(most + 1))).all():
        raise InputError(f"{name}: give whole numbers from 0 to {most}, or NaN where nothing is known")
    return np.where(np.isnan(given), 0, np.nan_to_num(given) + 1).astype(np.uint8)


class TerrainTile(RecordTile):
    """Cells that a patch of several tiles is merged into in one call."""

    @property
    def address(self) -> int:
        return int(self._cells.ctypes.data)


def _merge(rules: terrain.Rules, cells: Array, at: Array, patch: Array, stamp_ns: Stamp, revision: int) -> None:
    """A tile by itself takes a patch in."""
    tiles, tile_of = np.array([cells.ctypes.data]), np.zeros(len(at), np.int32)
    terrain_merge.merge(tiles, tile_of, at, patch, stamp_ns, revision, rules)


@dataclass(frozen=True, eq=False)
class TerrainPatch(UnsortedPatch):
    """The 3DLaserAuxMap of the paper: (K,) CELL records."""

    rules: terrain.Rules

    def merge_into(self, tiles: Sequence[TerrainTile], stamp_ns: Stamp, revision: int) -> None:
        addresses = np.array([tile.address for tile in tiles], np.int64)
        terrain_merge.merge(addresses, self.tile_of, self.at, self.records, stamp_ns, revision, self.rules)
        for tile in tiles:
            tile.revision = revision


Found = tuple[Sequence[TileKey], Array, Array, Array]
"""Keys, tile_of, at and records of a patch."""


class TerrainObserver:
    """Turns scans of one robot into patches on one lattice; keeps the scratch between scans."""

    def __init__(self, model: Terrain, lattice: Lattice) -> None:
        self.seconds = dict.fromkeys(STAGES, 0.0)
        """Time spent, by stage."""
        self._model, self._lattice, self._rules = model, lattice, model.rules(lattice.resolution_m)
        self._shape = model.shape(lattice.resolution_m)
        self._grid = np.zeros(rasterise.NOWHERE + 1, np.int32)
        self._first_slot = 1
        across = rasterise.WINDOW // lattice.tile_cells + 2
        self._keys, self._places = np.empty((across * across, 2), np.int64), np.empty(0, np.int32)
        self._reserve(1 << 14)

    def __call__(self, scan: Scan) -> TerrainPatch:
        points = checked_ends("points", scan.points)
        T, max_range_m = scan.T_world_sensor.matrix, self._model.range_m(scan)
        dropped = np.zeros(rasterise.COUNTERS, np.int64)
        origin = self._lattice.cell(T[:2, 3]) - rasterise.WINDOW // 2
        found = self._pass(points, T, max_range_m, (int(origin[0]), int(origin[1])), dropped)
        if dropped[rasterise.LATER]:
            found = self._in_blocks(points, T, max_range_m)
        reasons = {name: int(n) for name, n in zip(rasterise.DROP_REASONS, dropped, strict=False) if n}
        return TerrainPatch(*found, len(scan.points), reasons, self._rules)

    def _in_blocks(self, points: Array, T: Floats, max_range_m: float) -> Found:
        """As `_pass`, of a scan that is wider than the window.

        Blocks overlap by a cell, so that each cell finds its neighbours; it is taken from the one that it lies inside.
        """
        block, side = rasterise.WINDOW - 2, self._lattice.tile_cells
        ends = terrain_points.locate_reference(
            points, T, self._lattice.cells_per_m, self._model.min_range_m, max_range_m
        )
        parts = []
        for x, y in np.unique(np.stack([ends[0] // block, ends[1] // block], axis=1), axis=0).tolist():
            origin = x * block - 1, y * block - 1
            keys, tile_of, at, records = self._pass(
                points, T, max_range_m, origin, np.zeros(rasterise.COUNTERS, np.int64)
            )
            corner = np.array(keys, np.int64).reshape(-1, 3)[tile_of, :2] * side
            i, j = corner[:, 0] + at % side, corner[:, 1] + at // side
            inside = (i // block == x) & (j // block == y)
            parts.append((i[inside], j[inside], records[inside]))
        i, j, records = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
        patch = patch_of(i, j, records, self._lattice, len(points))
        tile_of = np.repeat(np.arange(len(patch.keys), dtype=np.int32), np.diff(patch.starts))
        return patch.keys, tile_of, patch.at, patch.records

    def _pass(self, points: Array, T: Floats, max_range_m: float, origin: tuple[int, int], dropped: Array) -> Found:
        """The cells of the window at `origin` that the points hit: the stages of the paper's table 2 in their order."""
        self._reserve(len(points))
        model, lattice, (i0, j0), first_slot = self._model, self._lattice, origin, self._first_slot
        per_m, grid, places, sums, cells = lattice.cells_per_m, self._grid, self._places, self._sums, self._cells
        gate = model.min_range_m**2, max_range_m**2
        across = math.isqrt(model.subcells)
        clock = [perf_counter()]
        terrain_points.locate(points, T, per_m, i0, j0, *gate, across, *self._points, dropped, self._later)
        clock.append(perf_counter())
        count = terrain_points.add_up(*self._points, len(points), grid, first_slot, places, sums)
        self._first_slot += count
        terrain_planes.fit(sums, count, T[2, 3], per_m, self._shape, cells)
        clock.append(perf_counter())
        terrain_planes.difference_neighbours(sums, places, count, grid, first_slot, per_m, model.point_sigma_m, cells)
        clock.append(perf_counter())
        terrain_planes.assess(sums, places, count, i0, j0, T, per_m, max_range_m, model.subcells, cells)
        clock.append(perf_counter())
        terrain_planes.occupy_all(count, model.max_slope, cells)
        clock.append(perf_counter())
        for stage, (begun, done) in zip(STAGES, pairwise(clock), strict=True):
            self.seconds[stage] += done - begun
        tiles, _ = rasterise.divide(
            places, cells, count, i0, j0, lattice.tile_cells, self._keys, self._tile_of, self._at
        )
        keys = [TileKey(x, y) for x, y in self._keys[:tiles].tolist()]
        return keys, self._tile_of[:count], self._at[:count], cells[:count]

    def _reserve(self, capacity: int) -> None:
        """Make the scratch hold `capacity` points and cells."""
        if capacity > len(self._places):
            room = 1 << (capacity - 1).bit_length()
            self._points = terrain_points.new_points(room)
            self._places, self._tile_of, self._at = (np.empty(room, np.int32) for _ in range(3))
            self._later = np.empty(room, np.int64)
            self._sums, self._cells = np.empty(room, terrain_points.SUMS), np.zeros(room, terrain.CELL)
        if self._first_slot + capacity >= 2**31:
            self._grid.fill(0)
            self._first_slot = 1
