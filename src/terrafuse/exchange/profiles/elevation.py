"""What travels of `elevation`: of a cell's sums the count, the mean, how far its extremes are from that, the variance.

Heights are in centimetres, variances in mm². No points have a variance of more than (mean - lowest)(highest - mean),
which rounding to centimetres may make too small for the true one. Where that is small it is cut; where it is not, so
that the cell may be vertical, the mean gives way by one centimetre. The highest point never does: it is what such a
cell shows.

The lean profile holds what a cell shows: its height, the mean or, of a vertical one, the highest point. Flat cells have
no variance in it; vertical ones are as if their points lay half at the top and half so deep below that they stay so.
"""

from __future__ import annotations

import numpy as np

from terrafuse.exchange.profiles.base import Profile, Quantity, at_level, level, level_above, level_below, most_level
from terrafuse.kernels import rounded
from terrafuse.kernels.absorb import CELL, GROUND_OF_CELL, vertical
from terrafuse.kernels.entropy import PREDICTED, SIGNED
from terrafuse.kernels.evidence import TWO_64
from terrafuse.kernels.rounded import CM2, MM2, MOST_COUNT, STEP
from terrafuse.lattice import Lattice
from terrafuse.models.elevation import Elevation
from terrafuse.types import Array

TALL = 40_000
"""mm²; with less variance a cell is not vertical, unless the model's threshold is lower than this."""
MOST_STEPS = (2**31 - 1) // STEP
FULL_BITS, LEAN_BITS, VARIANCE_BITS = 3, 0, 3
MOST_VARIANCE = 1 << 48
"""mm²; no heights within 31 bits of ticks have more."""

FIELDS = ("n", "z_min", "z_max", "sq_hi", "z_sum", "sq_lo")


def _evidence(cells: Array, prefix: str = "") -> dict[str, Array]:
    return {name: cells[prefix + name] for name in FIELDS}


def _mean(own: dict[str, Array]) -> Array:
    """In steps."""
    mean = own["z_sum"] / np.maximum(own["n"], 1)
    return np.clip(np.rint(mean / STEP), -MOST_STEPS, MOST_STEPS).astype(np.int64)


def _steps(ticks: Array) -> Array:
    return np.clip(np.rint(ticks / STEP), -MOST_STEPS, MOST_STEPS).astype(np.int64)


def variance_mm2(own: dict[str, Array]) -> Array:
    """The variance of each record, whole mm². From Σ(z - m)² about a whole m near the mean, in integers, which lose
    nothing at great heights; in floats only where that would not fit 62 bits."""
    n = np.maximum(own["n"], 1).astype(np.int64)
    mean = own["z_sum"] / n
    m = np.rint(mean).astype(np.int64)
    with np.errstate(over="ignore"):
        spread = own["sq_lo"].astype(np.int64) - 2 * m * own["z_sum"] + n * (m * m)
    rough = own["sq_hi"] * TWO_64 + own["sq_lo"] - mean * own["z_sum"]
    squares = np.where(rough < 2.0**62, spread, rough)
    return np.rint(np.clip(squares / n - (mean - m) ** 2, 0, MOST_VARIANCE * float(MM2)) / MM2).astype(np.int64)


def _sums(out: Array, prefix: str, n: Array, mean: Array, low: Array, high: Array, mm2: Array) -> None:
    """Set the sums of records that have these; all zero where n is 0."""
    some = n > 0
    count, z, variance = (np.where(some, value, 0) for value in (n, mean * STEP, mm2 * MM2))
    out[prefix + "n"], out[prefix + "z_sum"] = count, count * z
    out[prefix + "z_min"], out[prefix + "z_max"] = z - np.where(some, low * STEP, 0), z + np.where(some, high * STEP, 0)
    square, times = (z * z + variance).astype(np.uint64), count.astype(np.uint64)
    lower, upper = times * (square & np.uint64(0xFFFFFFFF)), times * (square >> np.uint64(32))
    low_word = lower + (upper << np.uint64(32))
    out[prefix + "sq_lo"] = low_word
    out[prefix + "sq_hi"] = (upper >> np.uint64(32)) + (low_word < lower)


def _count(levels: Array, bits: int) -> Array:
    return np.minimum(at_level(levels, bits), MOST_COUNT)


# --- full -------------------------------------------------------------------------------------------------------------


def _surface(own: dict[str, Array]) -> tuple[Array, Array, Array, Array, Array]:
    """Count, mean, how far below and above it the extremes are, variance: as they travel."""
    mean, top, bottom = _mean(own), _steps(own["z_max"]), _steps(own["z_min"])
    mm2 = variance_mm2(own)
    variance = level(mm2, VARIANCE_BITS)
    tight = (at_level(variance, VARIANCE_BITS) > CM2 * (mean - bottom) * (top - mean)) & (mm2 >= TALL)
    mean = mean + np.where(tight, np.where(top - mean <= mean - bottom, -1, 1), 0)
    room = level_below(np.maximum(CM2 * (mean - bottom) * (top - mean), 0), VARIANCE_BITS)
    return level(own["n"], FULL_BITS), mean, mean - bottom, top - mean, np.minimum(variance, room)


def _full_numbers(cells: Array) -> Array:
    n, mean, low, high, variance = _surface(_evidence(cells))
    covered = cells["ground_n"] > 0
    ground = _surface(_evidence(cells, "ground_"))
    changes = cells["changes"].astype(np.int64)
    return np.stack([
        n, mean, low, high, variance, changes, cells["merges"] - changes - 1,
        *(np.where(covered, value, 0) for value in (ground[0], ground[1] - mean, *ground[2:])),
    ])  # fmt: skip


def full_reference(numbers: Array) -> Array:
    """What the kernel must equal."""
    n, mean, low, high, variance, changes, alike, ground_n, ground_mean, *ground = numbers
    out = np.zeros(numbers.shape[1], CELL)
    _sums(out, "", _count(n, FULL_BITS), mean, low, high, at_level(variance, VARIANCE_BITS))
    ground_low, ground_high, ground_variance = ground
    ground_variance = at_level(ground_variance, VARIANCE_BITS)
    _sums(out, "ground_", _count(ground_n, FULL_BITS), mean + ground_mean, ground_low, ground_high, ground_variance)
    out["changes"], out["merges"] = changes, changes + alike + 1
    return out


def _full_cells(numbers: Array) -> Array:
    out = np.zeros(numbers.shape[1], CELL)
    rounded.elevation_full(numbers, FULL_BITS, VARIANCE_BITS, out, out.view(GROUND_OF_CELL))
    return out


FULL = Profile(
    (
        Quantity("n", PREDICTED, most_level(MOST_COUNT, FULL_BITS), least=1),
        Quantity("mean", PREDICTED, MOST_STEPS, least=-MOST_STEPS),
        Quantity("below", most=2 * MOST_STEPS),
        Quantity("above", most=2 * MOST_STEPS),
        Quantity("variance", most=most_level(MOST_VARIANCE, VARIANCE_BITS)),
        Quantity("changes", most=MOST_COUNT),
        Quantity("alike", most=MOST_COUNT),
        Quantity("ground_n", most=most_level(MOST_COUNT, FULL_BITS)),
        Quantity("ground_mean", SIGNED, 2 * MOST_STEPS, "ground_n"),
        Quantity("ground_below", most=2 * MOST_STEPS, where="ground_n"),
        Quantity("ground_above", most=2 * MOST_STEPS, where="ground_n"),
        Quantity("ground_variance", most=most_level(MOST_VARIANCE, VARIANCE_BITS), where="ground_n"),
    ),
    _full_numbers,
    _full_cells,
)


# --- lean -------------------------------------------------------------------------------------------------------------


def _flat(cells: Array, model: Elevation, lattice: Lattice) -> Array:
    """Cells that are not vertical as if all their points lay at one height."""
    out = cells.copy()
    flat = ~vertical(cells, model.rules(lattice))
    mean = _mean(_evidence(cells))
    n, none = np.where(flat, cells["n"], 0), np.zeros(len(cells), np.int64)
    level_cells = np.zeros(len(cells), CELL)
    _sums(level_cells, "", n.astype(np.int64), mean, none, none, none)
    for name in FIELDS:
        out[name] = np.where(flat, level_cells[name], cells[name])
    return out


def _lean_numbers(cells: Array) -> Array:
    own = _evidence(cells)
    top, mm2 = _steps(own["z_max"]), variance_mm2(own)
    height = np.where(mm2 > 0, top, _mean(own))
    sigma = np.ceil(np.sqrt(mm2 / CM2)).astype(np.int64)
    # Heights end somewhere: the lowest point can't lie below.
    room = level_below((height + MOST_STEPS) // 2, 0)
    drop = np.where(mm2 > 0, np.minimum(level_above(np.maximum(top - _mean(own), sigma), 0), room), 0)
    return np.stack([level(own["n"], LEAN_BITS), height, drop])


def lean_reference(numbers: Array) -> Array:
    """What the kernel must equal."""
    n, height, drop = numbers
    out = np.zeros(numbers.shape[1], CELL)
    half = at_level(drop, 0)
    _sums(out, "", _count(n, LEAN_BITS), height - half, half, half, CM2 * half * half)
    out["merges"] = 1
    return out


def _lean_cells(numbers: Array) -> Array:
    out = np.empty(numbers.shape[1], CELL)
    rounded.elevation_lean(numbers, LEAN_BITS, out, out.view(GROUND_OF_CELL))
    return out


LEAN = Profile(
    (
        Quantity("n", PREDICTED, most_level(MOST_COUNT, LEAN_BITS), least=1),
        Quantity("height", PREDICTED, MOST_STEPS, least=-MOST_STEPS),
        Quantity("drop", most=most_level(2 * MOST_STEPS, 0)),
    ),
    _lean_numbers,
    _lean_cells,
    _flat,
)
PROFILES = {"lean": LEAN, "full": FULL}
