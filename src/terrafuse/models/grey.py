"""`grey`: how possibly a cell is occupied, as an interval, from sonars.

Xie et al., "Cooperative map building of multi-robot based on grey fusion" (the *grey* paper).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from terrafuse.errors import InputError
from terrafuse.kernels import grey
from terrafuse.lattice import Lattice
from terrafuse.models.base import Layer, Patch, Reading, check_band, checked_ends, checked_origins, first_flaw, patch_of
from terrafuse.tile import RecordTile
from terrafuse.types import Array, Beam, Floats, Scan

Mode = Literal["stable", "changing"]
MERGES = {"stable": grey.merge_stable, "changing": grey.merge_changing}


@dataclass(frozen=True)
class Grey:
    """The grey model's settings; an instance is the model."""

    mode: Mode = "stable"
    """`stable`: a robot fuses each reading into its cell. `changing`: its cell is what its newest reading says."""
    opening_angle_rad: float | None = None
    """α, the whole angle of a sonar's cone; None takes the scan's beam. 16 sonars see all around from 22.5° on."""
    rho_v_m: float = 1.5
    """ρ_v: at this distance a reading is believed half. The paper gives no number; this is half of the 3 m for which it
    trusts a sonar."""
    delta_r_m: float | None = None
    """Δr: how far from the reading an obstacle may be. None takes the beam's `range_error_m`, but no less than half
    a cell's diagonal, so that the cell in which a reading ends is in the band however large cells are."""
    reliability: float = 1.0
    """v, 0 to 1; times the beam's own."""

    name = "grey"
    cell = grey.CELL
    picture_layer = "white"
    fold_by_name = True
    """The global cell is folded by the robots' names, as in the paper's Fig. 2, whatever their stamps."""

    def __post_init__(self) -> None:
        if self.mode not in MERGES:
            raise InputError(f"mode '{self.mode}': give 'stable' or 'changing'")
        if self.opening_angle_rad is not None and not 0 < self.opening_angle_rad <= 2 * np.pi:
            raise InputError(f"opening_angle_rad {self.opening_angle_rad}: give 0 to 2π; the paper's sonars have 0.39")
        if self.delta_r_m is not None and not 0 < self.delta_r_m < np.inf:
            raise InputError(f"delta_r_m {self.delta_r_m}: give a positive number of metres")
        if not 0 <= self.rho_v_m < np.inf:
            raise InputError(f"rho_v_m {self.rho_v_m}: give a number of metres from 0 on")
        if not 0 < self.reliability <= 1:
            raise InputError(f"reliability {self.reliability}: give more than 0, at most 1")

    def settings(self) -> dict[str, Any]:
        return asdict(self)

    def sonar(self, beam: Beam, lattice: Lattice) -> grey.Sonar:
        """How this model believes such a beam on this lattice. Raises InputError for a beam without a width."""
        opening_angle_rad = self.opening_angle_rad or 2.0 * beam.half_angle_rad
        if not opening_angle_rad > 0:
            raise InputError(
                "the model 'grey' is for sonars and this sensor's beams have no width: "
                "set the model's opening_angle_rad, describe the sensor, or use the model 'occupancy'"
            )
        delta_r_m = self.delta_r_m or max(beam.range_error_m, lattice.resolution_m * np.sqrt(0.5))
        check_band("Δr", delta_r_m, lattice, "set the model's delta_r_m")
        return grey.Sonar(opening_angle_rad, self.rho_v_m, float(delta_r_m), self.reliability * beam.reliability)

    def observer(self, lattice: Lattice) -> GreyObserver:
        return GreyObserver(self, lattice)

    def tile(self, lattice: Lattice) -> RecordTile:
        return RecordTile(lattice.tile_cells, grey.CELL, MERGES[self.mode])

    def fuse(self, older: Array, newer: Array, lattice: Lattice) -> Array:
        out = np.ascontiguousarray(older).copy()
        grey.fuse(out, np.ascontiguousarray(newer))
        return out

    def coarsen(self, cells: Array, factor: int) -> Array:
        """[max a, max b] of k×k cells: a block is as occupied as its worst cell, and free only where all of it is."""
        out = np.zeros((cells.shape[0] // factor, cells.shape[1] // factor), self.cell)
        grey.coarsen(np.ascontiguousarray(cells), factor, out)
        return out

    def known(self, cells: Array) -> Array:
        return np.asarray(cells["revision"] > 0)

    def check(self, cells: Array) -> str | None:
        return first_flaw({"an empty interval, a > b": cells["a"].astype(np.int64) + cells["c"] > grey.FULL})

    @property
    def layers(self) -> Mapping[str, Layer]:
        return {layer.name: layer for layer in self._layers()}

    def _layers(self) -> list[Layer]:
        return [
            Layer("white", "1", "how possibly occupied, (a + b)/2; 0.5: nobody can tell", white),
            Layer("a", "1", "least possibility of being occupied", lambda c, _: where_known(c, lower(c))),
            Layer("b", "1", "greatest possibility of being occupied", lambda c, _: where_known(c, upper(c))),
            Layer("information", "1", "1 - (b - a)", lambda c, _: where_known(c, 1.0 - (upper(c) - lower(c)))),
            Layer("stamp", "s", "last update, seconds since 1970 UTC", lambda c, _: where_known(c, c["stamp"] * 1e-9)),
        ]

    @property
    def occupied(self) -> Layer:
        return self.layers["white"]


def lower(cells: Array) -> Floats:
    """a"""
    return np.asarray(cells["a"] / grey.FULL)


def upper(cells: Array) -> Floats:
    """b"""
    return np.asarray(1.0 - cells["c"] / grey.FULL)


def where_known(cells: Array, values: Floats) -> Floats:
    return np.where(cells["revision"] > 0, values, np.nan)


def white(cells: Array, _: Reading | None = None) -> Floats:
    """Θ_M = (a + b)/2, exactly ½ where nothing speaks for either; NaN where unknown."""
    balance = cells["a"].astype(np.float64) - cells["c"]
    return where_known(cells, 0.5 + balance / (2 * grey.FULL))


def local_view(own: Array, others: Array, mode: Mode) -> Floats:
    """The white values that a robot goes by: its own cells and the others' global cells, (M,) each, NaN where unknown.

    In a stable world the others' intervals are fused with its own; in a changing one they count only as white values,
    where the robot knows nothing itself. A function at read time: neither comes back into what the robot reports.
    """
    if mode == "changing":
        return np.where(own["revision"] > 0, white(own), white(others))
    view = np.ascontiguousarray(own).copy()
    grey.fuse(view, np.ascontiguousarray(others))
    return white(view)


class GreyObserver:
    """Turns the sonar scans of one robot into patches; keeps the scratch between scans."""

    def __init__(self, model: Grey, lattice: Lattice) -> None:
        self._model, self._lattice = model, lattice
        self._scratch = grey.new_scratch(256)
        self._first_slot = 1

    def __call__(self, scan: Scan) -> Patch:
        sonar = self._model.sonar(scan.beam, self._lattice)
        beams, dropped = aimed(scan, self._lattice.cells_per_m)
        i0, j0, work = self._window(beams, sonar)
        count = grey.observe(beams, sonar, self._lattice.cells_per_m, i0, j0, self._first_slot, work)
        self._first_slot += count
        i, j, records = work.i[:count], work.j[:count], work.records[:count]
        return patch_of(i, j, records, self._lattice, len(scan.points), dropped)

    def _window(self, beams: Floats, sonar: grey.Sonar) -> tuple[int, int, grey.Scratch]:
        """The first cell of a window that holds all cones, and the scratch with room for it."""
        if not len(beams):
            return 0, 0, self._scratch
        reach = beams[:, grey.READING] + (sonar.delta_r_m + self._lattice.resolution_m)
        (x, y), cells_per_m = beams[:, :2].T, self._lattice.cells_per_m
        i0, j0 = (int(np.floor((apex - reach).min() * cells_per_m)) for apex in (x, y))
        i1, j1 = (int(np.floor((apex + reach).max() * cells_per_m)) for apex in (x, y))
        return i0, j0, self._reserve(max(i1 - i0, j1 - j0) + 1)

    def _reserve(self, side: int) -> grey.Scratch:
        if len(self._scratch.grid) < side:
            self._scratch = grey.new_scratch(-(-side // 256) * 256)
            self._first_slot = 1
        if self._first_slot + len(self._scratch.records) >= 2**31:
            self._scratch.grid.fill(0)
            self._first_slot = 1
        return self._scratch


def aimed(scan: Scan, cells_per_m: float) -> tuple[Floats, dict[str, int]]:
    """The beams (B, 6) of a scan that count, in its order, points before misses; and the others by reason."""
    ends = _float64(checked_ends("points", scan.points))
    if scan.misses is not None:
        ends = np.concatenate([ends, _float64(checked_ends("misses", scan.misses))])
    given = checked_origins(scan)
    origins = np.zeros_like(ends) if given is None else _float64(given)
    beams, dropped = np.empty((len(ends), 6)), np.zeros(len(grey.DROP_REASONS), np.int64)
    near, far = scan.beam.min_range_m, scan.beam.max_range_m
    T_world_sensor = scan.T_world_sensor.matrix
    count = grey.aim(ends, origins, len(scan.points), T_world_sensor, near, far, cells_per_m, beams, dropped)
    return beams[:count], {name: n for name, n in zip(grey.DROP_REASONS, dropped.tolist(), strict=True) if n}


def _float64(ends: Array) -> Floats:
    return np.ascontiguousarray(ends[:, :3], np.float64)
