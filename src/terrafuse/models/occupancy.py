"""`occupancy`: how probably a cell is occupied, as a sum of log-odds, from lidars' rays and sonars' cones.

Barnes, Garcia, Quasny & Pyeatt, "Multi-agent mapping using dynamic allocation utilizing a centralized storage system"
(the *database* paper), after Moravec & Elfes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np

from terrafuse.errors import InputError
from terrafuse.kernels import occupancy, occupancy_beams, occupancy_sonar, rays, traced
from terrafuse.lattice import Lattice
from terrafuse.models.base import Layer, Patch, check_band, checked_ends, checked_origins, first_flaw, patch_of
from terrafuse.tile import RecordTile
from terrafuse.types import Array, Beam, Floats, Scan, Stamp, TileKey

FREE, OCCUPIED, UNDECIDED = 1, 2, 3
ORIGIN = np.zeros((1, 3))


@dataclass(frozen=True)
class Occupancy:
    """The occupancy model's settings; an instance is the model."""

    hit_probability: float = 0.7
    miss_probability: float = 0.4
    """What a lidar's ray says of the cell in which it ends, and of those that it crosses: once a scan, and a hit counts
    more than any number of crossings. OctoMap's values."""
    max_empty_evidence: float = 0.95
    max_occupied_evidence: float = 0.9
    """Limits of a sonar's evidence: 1 could never be outweighed. A reading says that *all* cells before the echo are
    empty, but only that *some* cell about it is occupied: of that it is less sure."""
    max_log_odds: float = 5.0
    """A cell's log-odds are read as no more than this, either way: p from 0.0067 to 0.9933. The stored sum goes on."""
    occupied_threshold: float = 0.65
    free_threshold: float = 0.35
    """`state` is occupied from the first p on and free up to the second: one hit is enough, and so are two misses."""
    min_range_m: float = 0.0
    max_range_m: float = 100.0
    """Nearer points are dropped. Those at or beyond the maximum clear the way up to it and mark nothing. The sensor's
    own limits count beside these, and so do MAX_RAY_CELLS (4096 cells) or, of a cone, MAX_CONE_CELLS (512)."""
    min_z_m: float = -0.25
    max_z_m: float = 0.25
    """The slice of the world that the map shows, as heights above where a beam starts: beams clear and mark in it only,
    so that the ground that a 3D lidar sees is no obstacle. Widen it down to just above the ground. Cones are not cut:
    they are as high as they are wide."""

    name = "occupancy"
    cell = occupancy.CELL
    picture_layer = "occupancy"
    fold_by_name = False

    def __post_init__(self) -> None:
        if not 0 < self.miss_probability < 0.5 < self.hit_probability < 1:
            raise InputError(
                f"miss_probability {self.miss_probability} and hit_probability {self.hit_probability}: "
                "give 0 < miss < 0.5 < hit < 1"
            )
        for field in ("max_empty_evidence", "max_occupied_evidence"):
            if not 0 < getattr(self, field) < 1:
                raise InputError(f"{field} {getattr(self, field)}: give more than 0 and less than 1")
        if not 0 < self.max_log_odds < 500:
            raise InputError(f"max_log_odds {self.max_log_odds}: give more than 0, less than 500")
        if not 0 < self.free_threshold <= 0.5 <= self.occupied_threshold < 1:
            raise InputError(
                f"free_threshold {self.free_threshold} and occupied_threshold {self.occupied_threshold}: "
                "give 0 < free ≤ 0.5 ≤ occupied < 1"
            )
        if not 0 <= self.min_range_m < self.max_range_m < math.inf:
            raise InputError(f"range gate {self.min_range_m} to {self.max_range_m} m is empty or has no end")
        if not -math.inf < self.min_z_m < self.max_z_m < math.inf:
            raise InputError(f"slice of heights {self.min_z_m} to {self.max_z_m} m is empty or has no end")

    def settings(self) -> dict[str, Any]:
        return asdict(self)

    def observer(self, lattice: Lattice) -> OccupancyObserver:
        return OccupancyObserver(self, lattice)

    def tile(self, lattice: Lattice) -> RecordTile:
        return RecordTile(lattice.tile_cells, self.cell, occupancy.take)

    def fuse(self, older: Array, newer: Array, lattice: Lattice) -> Array:
        """Independent evidence adds."""
        return occupancy.fuse(older, newer)

    def coarsen(self, cells: Array, factor: int) -> Array:
        """The largest sum of k×k cells, in which one that nobody saw counts as 0; their updates add.

        So a coarse cell is free only where all of it is, and no wall is lost: not by coarsening, and not by fusing what
        several robots coarsened, as a sum of largest is never less than the largest sum.
        """
        return occupancy.coarsen(cells, factor)

    def known(self, cells: Array) -> Array:
        return np.asarray(cells["updates"] > 0)

    def check(self, cells: Array) -> str | None:
        most = cells["updates"].astype(np.int64) * occupancy.MOST_TICKS
        return first_flaw({
            "no update": ~self.known(cells),
            "more log-odds than the updates can give": (cells["sum"] > most) | (cells["sum"] < -most),
        })  # fmt: skip

    @property
    def layers(self) -> Mapping[str, Layer]:
        return {
            layer.name: layer
            for layer in (
                self.occupied,
                Layer("log_odds", "1", "ln(p / (1 - p)) of occupied", lambda c, _: self.log_odds(c)),
                Layer("updates", "1", "how many readings said something of it", lambda c, _: self._of(c, c["updates"])),
                Layer("state", "1", "1 free, 2 occupied, 3 undecided", lambda c, _: self.state(c)),
                Layer("stamp", "s", "last update, seconds since 1970 UTC", lambda c, _: self._of(c, c["stamp"] * 1e-9)),
            )
        }

    @property
    def occupied(self) -> Layer:
        return Layer("occupancy", "1", "probability that it is occupied", lambda c, _: self.probability(c))

    def _of(self, cells: Array, values: Array) -> Floats:
        return np.where(self.known(cells), values.astype(np.float64), np.nan)

    def log_odds(self, cells: Array) -> Floats:
        """Nats within ±max_log_odds, NaN unknown."""
        return self._of(cells, (cells["sum"] / occupancy.TICKS_PER_NAT).clip(-self.max_log_odds, self.max_log_odds))

    def probability(self, cells: Array) -> Floats:
        return occupancy.probability(self.log_odds(cells))

    def state(self, cells: Array) -> Floats:
        """1 free, 2 occupied, 3 undecided, NaN unknown."""
        p = self.probability(cells)
        kinds = [p <= self.free_threshold, p >= self.occupied_threshold]
        return self._of(cells, np.select(kinds, [FREE, OCCUPIED], UNDECIDED))


@dataclass(frozen=True, eq=False)
class RaysPatch:
    """What rays say of the cells that they cross. It is the observer's scratch, and holds until its next scan."""

    traced: traced.Traced
    hit_ticks: int
    miss_ticks: int
    points: int
    dropped: Mapping[str, int]

    @cached_property
    def keys(self) -> list[TileKey]:
        return [TileKey(x, y) for x, y in self.traced.keys.tolist()]

    @property
    def cells(self) -> int:
        return self.traced.cells

    def merge_into(self, tiles: Sequence[RecordTile], stamp_ns: Stamp, revision: int) -> None:
        for t, tile in enumerate(tiles):
            at, hit = self.traced.part(t)
            readings = np.empty(len(at), occupancy.READING)
            occupancy.read_rays(hit, self.hit_ticks, self.miss_ticks, readings)
            tile.merge(at, readings, stamp_ns, revision)


class OccupancyObserver:
    """What scans of one robot say of the cells of one lattice; keeps the scratch between scans."""

    def __init__(self, model: Occupancy, lattice: Lattice) -> None:
        self._model, self._lattice = model, lattice
        self._rays = traced.Tracer(lattice.cells_per_m, lattice.tile_cells)
        self._cones = occupancy_sonar.Listener(
            lattice.cells_per_m, model.max_empty_evidence, model.max_occupied_evidence
        )

    def __call__(self, scan: Scan) -> Patch | RaysPatch:
        cone = scan.beam.half_angle_rad > 0
        longest = occupancy_sonar.MAX_CONE_CELLS if cone else rays.MAX_RAY_CELLS
        ends, marks, dropped = self._segments(scan, longest)
        reasons = {name: int(n) for name, n in zip(occupancy_beams.REASONS, dropped, strict=True) if n}
        return (self._listened if cone else self._traced)(ends, marks, scan, reasons)

    def _listened(self, ends: Floats, marks: Array, scan: Scan, dropped: Mapping[str, int]) -> Patch:
        check_band(
            "a range error", scan.beam.range_error_m, self._lattice, "describe the sensor with a smaller range_error_m"
        )
        nearest_m = max(scan.beam.min_range_m, self._model.min_range_m)
        i, j, readings = self._cones(ends, marks, scan.beam, nearest_m)
        return patch_of(i, j, readings, self._lattice, len(scan.points), dropped)

    def _traced(self, ends: Floats, marks: Array, scan: Scan, dropped: Mapping[str, int]) -> RaysPatch:
        model = self._model
        hit_ticks, miss_ticks = (self._ticks(p, scan.beam) for p in (model.hit_probability, model.miss_probability))
        return RaysPatch(self._rays(ends, marks), hit_ticks, miss_ticks, len(scan.points), dropped)

    def _ticks(self, probability: float, beam: Beam) -> int:
        """Of a ray; a sensor that is believed half says half as far from ½."""
        return occupancy.ticks(0.5 + (probability - 0.5) * beam.reliability)

    def _segments(self, scan: Scan, longest: int) -> tuple[Floats, Array, Array]:
        """(ends (K, 4) in the world, marks (K,), dropped by reason) of the scan's beams, none over `longest` cells."""
        model, lattice, beam = self._model, self._lattice, scan.beam
        points = checked_ends("points", scan.points)
        misses = checked_ends("misses", np.empty((0, 3)) if scan.misses is None else scan.misses)
        count = len(points) + len(misses)
        given = checked_origins(scan)
        origins = ORIGIN if given is None else given.astype(np.float64)
        ends, marks, dropped = np.empty((count, 4)), np.empty(count, np.bool_), np.zeros(6, np.int64)
        cone = beam.half_angle_rad > 0
        used = occupancy_beams.segments(
            points,
            misses,
            origins,
            scan.T_world_sensor.matrix,
            max(model.min_range_m, beam.min_range_m),
            min(model.max_range_m, beam.max_range_m, longest * lattice.resolution_m),
            -math.inf if cone else model.min_z_m,
            math.inf if cone else model.max_z_m,
            lattice.cells_per_m,
            rays.MAX_SPREAD_CELLS,
            ends,
            marks,
            dropped,
        )
        return ends[:used], marks[:used], dropped
