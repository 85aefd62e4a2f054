"""`elevation`: heights as exact statistics, with vertical cells, moving things and the ground they cover.

Koch & Lacroix, "Managing environment models in multi-robot teams" (the *tiles* paper).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from terrafuse.errors import InputError
from terrafuse.kernels import absorb, evidence, rasterise
from terrafuse.kernels.planes import fit_planes
from terrafuse.lattice import Lattice
from terrafuse.models.base import Layer, Reading, UnsortedPatch, checked_ends, first_flaw
from terrafuse.tile import aligned_zeros
from terrafuse.types import Array, Floats, Scan, TileKey

FARTHEST_M = 1e8


@dataclass(frozen=True)
class Elevation:
    """The elevation model's settings; an instance is the model.

    `static=True` switches the dynamic rule off: every merge is then the exact merging of statistics.
    """

    static: bool = False
    variance_threshold_m2: float = 0.05
    """A cell with more than 2 points and a larger variance is vertical."""
    flat_tolerance_m: float = 0.10
    """Two flat surfaces whose means are further apart are different surfaces."""
    flat_slope: float = 0.5
    """The slope that a flat cell may have. Two looks at different parts of a cell of side r on such a slope differ by
    up to slope·r in mean, and points within one have a variance of up to (slope·r)²/4: both thresholds are at least
    that, or large cells on a hillside would count as moving. Up to 0.2 m it changes nothing."""
    min_range_m: float = 0.0
    max_range_m: float = FARTHEST_M
    """Points nearer or further from the sensor are dropped; the default keeps all."""
    traversability_cells: int = 5
    """Side k of the square over which a plane is fitted for `traversability`; odd."""
    impassable_roughness: float = 0.25
    """Roughness a² + b² + χ² at which traversability reaches 0: a slope of 27° by itself."""

    name = "elevation"
    cell = absorb.CELL
    picture_layer = "height"
    fold_by_name = False

    def __post_init__(self) -> None:
        if self.traversability_cells % 2 == 0 or self.traversability_cells < 3:
            raise InputError(f"traversability_cells {self.traversability_cells}: give an odd number of at least 3")
        for field in ("variance_threshold_m2", "flat_tolerance_m", "impassable_roughness", "flat_slope"):
            if not getattr(self, field) > 0:
                raise InputError(f"{field} {getattr(self, field)}: give a positive number")
        if not 0 <= self.min_range_m < self.max_range_m <= FARTHEST_M:
            raise InputError(f"range gate {self.min_range_m} to {self.max_range_m} m: give 0 ≤ min < max ≤ 1e8 m")

    def settings(self) -> dict[str, Any]:
        return asdict(self)

    def rules(self, lattice: Lattice) -> absorb.Rules:
        """The thresholds for cells of this lattice."""
        rise_m = self.flat_slope * lattice.resolution_m
        tolerance_m = max(self.flat_tolerance_m, rise_m)
        return absorb.rules(self.static, tolerance_m, max(self.variance_threshold_m2, rise_m**2 / 4))

    def observer(self, lattice: Lattice) -> ElevationObserver:
        return ElevationObserver(lattice, self.rules(lattice), self.min_range_m, self.max_range_m)

    def tile(self, lattice: Lattice) -> ElevationTile:
        return ElevationTile(lattice.tile_cells)

    def fuse(self, older: Array, newer: Array, lattice: Lattice) -> Array:
        out = np.ascontiguousarray(older).copy()
        new = np.ascontiguousarray(newer)
        absorb.fuse(out, out.view(absorb.GROUND_OF_CELL), new, new.view(absorb.GROUND_OF_CELL), self.rules(lattice))
        return out

    def coarsen(self, cells: Array, factor: int) -> Array:
        """The exact statistics of all points of k×k cells; `changes` and `merges` add, cached ground is left behind."""
        out = np.zeros((cells.shape[0] // factor, cells.shape[1] // factor), self.cell)
        absorb.coarsen(np.ascontiguousarray(cells), factor, out)
        return out

    def known(self, cells: Array) -> Array:
        return np.asarray(cells["n"] > 0)

    def check(self, cells: Array) -> str | None:
        ground = np.ascontiguousarray(cells).view(absorb.GROUND_OF_CELL)
        if absorb.sound(cells, ground):
            return None
        none = ground == np.zeros((), ground.dtype)
        return first_flaw({
            "sums that no points have": ~evidence.consistent(cells),
            "a cached ground with sums that no points have": ~none & ~evidence.consistent(ground),
            "more changes than merges allow": cells["changes"] >= cells["merges"],
        })  # fmt: skip

    @property
    def layers(self) -> Mapping[str, Layer]:
        return {layer.name: layer for layer in self._layers()}

    def _layers(self) -> list[Layer]:
        half = self.traversability_cells // 2
        return [
            Layer("height", "m", "mean height; the highest point where vertical", self.height),
            Layer("z_mean", "m", "mean height of the points", lambda c, _: evidence.mean_m(c)),
            Layer("z_var", "m2", "variance of the points' heights", lambda c, _: evidence.variance_m2(c)),
            Layer("z_min", "m", "lowest point", lambda c, _: self._metres(c, "z_min")),
            Layer("z_max", "m", "highest point", lambda c, _: self._metres(c, "z_max")),
            Layer("n", "1", "number of points", lambda c, _: self._count(c, "n")),
            Layer("state", "1", "1 flat, 2 vertical", self.state),
            Layer("changes", "1", "how often the surface changed", lambda c, _: self._count(c, "changes")),
            Layer("dynamic", "1", "probability that the next look finds a change", lambda c, _: self.dynamic(c)),
            Layer(
                "stamp",
                "s",
                "last update, seconds since 1970 UTC",
                lambda c, _: self._count(c, "stamp") * 1e-9,
            ),
            Layer("traversability", "1", "0 impassable to 1 smooth and level", self.traversability, half),
        ]

    def _count(self, cells: Array, field: str) -> Floats:
        return np.where(self.known(cells), cells[field].astype(np.float64), np.nan)

    def _metres(self, cells: Array, field: str) -> Floats:
        return self._count(cells, field) * evidence.TICK_M

    def state(self, cells: Array, reading: Reading) -> Floats:
        """1 flat, 2 vertical, NaN unknown."""
        return np.where(self.known(cells), 1.0 + absorb.vertical(cells, self.rules(reading.lattice)), np.nan)

    def height(self, cells: Array, reading: Reading) -> Floats:
        """z_mean, or z_max where vertical."""
        return np.where(
            absorb.vertical(cells, self.rules(reading.lattice)), self._metres(cells, "z_max"), evidence.mean_m(cells)
        )

    def dynamic(self, cells: Array) -> Floats:
        """Posterior mean (changes + 1)/(merges + 2) of the chance that a look finds a change.

        `merges` counts every scan that touched the cell, the first one too.
        """
        return np.where(self.known(cells), (cells["changes"] + 1.0) / (cells["merges"] + 2.0), np.nan)

    def traversability(self, cells: Array, reading: Reading) -> Floats:
        """1 - roughness / impassable, from the plane fitted to the heights of k×k cells.

        Roughness is a² + b² + χ²: the plane's slopes, and the mean squared residual in units of a cell's side, so
        that the three add up at any resolution. NaN where over half of the k×k cells are unknown, or the known ones
        lie on one line.
        """
        a, b, residual2, count = fit_planes(self.height(cells, reading), self.traversability_cells)
        roughness = (a * a + b * b + residual2) / reading.lattice.resolution_m**2
        enough = 2 * count >= self.traversability_cells**2
        return np.where(enough, np.clip(1.0 - roughness / self.impassable_roughness, 0.0, 1.0), np.nan)

    @property
    def occupied(self) -> Layer:
        return Layer(
            "obstacle",
            "1",
            "1 - traversability: 0 smooth and level to 1 impassable",
            lambda cells, reading: 1.0 - self.traversability(cells, reading),
            self.traversability_cells // 2,
        )


class ElevationTile:
    """Two arrays: what every scan touches, a cache line a cell; and the cached ground, which few cells have."""

    def __init__(self, side: int) -> None:
        self.revision = 0
        self._surface = aligned_zeros(side * side, absorb.SURFACE)
        self._ground = aligned_zeros(side * side, evidence.EVIDENCE)
        # One more than there are cells: the kernel writes before it knows whether to keep.
        self._changed = np.empty(side * side + 1, np.int32)
        self._addresses = self._surface.ctypes.data, self._ground.ctypes.data, self._changed.ctypes.data
        self._count = 0
        self._reported = 0

    @property
    def state(self) -> tuple[int, int, int, int, int]:
        """As absorb.STATE."""
        return *self._addresses, self._count, self._reported

    def check_newer(self, revision: int) -> None:
        """Raise InputError unless nothing is as new: the list of changes has room for each cell once a revision."""
        if revision <= max(self.revision, self._reported):
            raise InputError(f"revision {revision} is not larger than {self.revision}, which the tile has")

    def merged(self, changed: int, revision: int) -> None:
        """The kernel was here: so many positions are in the list of changes now."""
        self._count = changed
        self.revision = revision

    def changed(self, since: int) -> tuple[Array, Array]:
        at = self._changed_after(since)
        cells = np.empty(len(at), absorb.CELL)
        absorb.read(self._surface, self._ground, at, cells, cells.view(absorb.GROUND_OF_CELL))
        return at, cells

    def _changed_after(self, since: int) -> Array:
        """Positions, rising. The list that `merge` keeps starts where the last question ended."""
        if since < self._reported:
            return np.flatnonzero(self._surface["revision"] > since).astype(np.int32)
        at = np.sort(self._changed[: self._count])
        at = at[self._surface["revision"][at] > since]
        self._changed[: len(at)] = at
        self._count = len(at)
        self._reported = since
        return at

    def surface(self) -> Array:
        return self._surface

    def put(self, at: Array, cells: Array) -> None:
        given = np.ascontiguousarray(cells)
        absorb.write(self._surface, self._ground, at, given, given.view(absorb.GROUND_OF_CELL))
        self.revision = max(self.revision, int(cells["revision"].max(initial=0)))
        self._reported = self.revision
        self._count = 0

    @property
    def nbytes(self) -> int:
        return int(self._surface.nbytes + self._ground.nbytes + self._changed.nbytes)


@dataclass(frozen=True, eq=False)
class ElevationPatch(UnsortedPatch):
    """The evidence of one scan: (K,) EVIDENCE records."""

    rules: absorb.Rules

    def merge_into(self, tiles: Sequence[ElevationTile], stamp_ns: int, revision: int) -> None:
        for tile in tiles:
            tile.check_newer(revision)
        states = np.array([tile.state for tile in tiles], absorb.STATE)
        absorb.merge(states, self.tile_of, self.at, self.records, stamp_ns, revision, self.rules)
        for tile, count in zip(tiles, states["count"].tolist(), strict=True):
            tile.merged(count, revision)


class ElevationObserver:
    """Rasterises scans of one robot on one lattice; keeps the scratch between scans."""

    def __init__(self, lattice: Lattice, rules: absorb.Rules, min_range_m: float, max_range_m: float) -> None:
        self._lattice, self._rules = lattice, rules
        self._near2, self._far2 = min_range_m**2, max_range_m**2
        self._scratch = rasterise.new_patchwork(1 << 14)
        self._first_slot = 1
        across = rasterise.WINDOW // lattice.tile_cells + 2
        self._keys = np.empty((across * across, 2), np.int64)

    def __call__(self, scan: Scan) -> ElevationPatch:
        T_world_sensor = scan.T_world_sensor.matrix
        dropped = np.zeros(rasterise.COUNTERS, np.int64)
        parts: list[ElevationPatch] = []
        points = checked_ends("points", scan.points)
        centre = T_world_sensor[:2, 3]
        while len(points):
            points, part = self._pass(points, T_world_sensor, centre, dropped)
            parts.append(_copy(part) if len(points) or parts else part)
            if len(points):
                p = points[0].astype(np.float64)
                centre = T_world_sensor[:2, :3] @ p + T_world_sensor[:2, 3]
        reasons = {name: int(n) for name, n in zip(rasterise.DROP_REASONS, dropped, strict=False) if n}
        return _joined(parts, len(scan.points), reasons, self._rules)

    def _pass(self, points: Array, T: Floats, centre: Floats, dropped: Array) -> tuple[Array, ElevationPatch]:
        """Rasterise what lies in one window of the lattice; return the points beyond it, and the patch."""
        work = self._reserve(len(points) + 1)
        lattice = self._lattice
        i0, j0 = (int(np.floor(c * lattice.cells_per_m)) - rasterise.WINDOW // 2 for c in centre)
        dropped[rasterise.LATER] = 0
        count = rasterise.rasterise(
            points,
            T,
            lattice.cells_per_m,
            i0,
            j0,
            self._near2,
            self._far2,
            work.grid,
            self._first_slot,
            work.places,
            work.records,
            dropped,
            work.later,
        )
        self._first_slot += count
        tiles, count = rasterise.divide(
            work.places, work.records, count, i0, j0, lattice.tile_cells, self._keys, work.tile_of, work.at
        )
        keys = [TileKey(x, y) for x, y in self._keys[:tiles].tolist()]
        rest = points[work.later[: dropped[rasterise.LATER]]]
        return rest, ElevationPatch(
            keys, work.tile_of[:count], work.at[:count], work.records[:count], 0, {}, self._rules
        )

    def _reserve(self, capacity: int) -> rasterise.Patchwork:
        """The scratch, with room for `capacity` points."""
        if self._scratch.capacity < capacity:
            self._scratch = rasterise.new_patchwork(1 << (capacity - 1).bit_length(), self._scratch.grid)
        if self._first_slot + capacity >= 2**31:
            self._scratch.grid.fill(0)
            self._first_slot = 1
        return self._scratch


def _copy(patch: ElevationPatch) -> ElevationPatch:
    """The patch in memory of its own, before the next pass takes the scratch."""
    return replace(patch, tile_of=patch.tile_of.copy(), at=patch.at.copy(), records=patch.records.copy())


def _joined(
    parts: list[ElevationPatch], points: int, dropped: Mapping[str, int], rules: absorb.Rules
) -> ElevationPatch:
    """One patch of several passes. Their windows may overlap in a tile, never in a cell."""
    if len(parts) == 1:
        return replace(parts[0], points=points, dropped=dropped)
    none = np.empty(0, np.int32)
    keys = list(dict.fromkeys(key for part in parts for key in part.keys))
    number = {key: k for k, key in enumerate(keys)}
    tile_of = [np.array([number[key] for key in part.keys], np.int32)[part.tile_of] for part in parts]
    return ElevationPatch(
        keys,
        np.concatenate([none, *tile_of]),
        np.concatenate([none, *(part.at for part in parts)]),
        np.concatenate([np.empty(0, evidence.EVIDENCE), *(part.records for part in parts)]),
        points,
        dropped,
        rules,
    )
