"""Grey intervals: what a sonar says about the cells of its cone, and how two intervals become one.

Xie et al., "Cooperative map building of multi-robot based on grey fusion" (the *grey* paper). An interval [a, b] is
kept as a and c = 1 - b, in whole ticks of 1/65535, both rounded down: the true interval always lies inside, and the
unknown [0, 1] is all zeros. Whether the white value (a + b)/2 is above, at or below ½ is whether a is above, at or
below c: integers decide that exactly. Fusing only compares and chooses, so every machine fuses to the same bytes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from terrafuse.kernels.cones import MAX_BAND_CELLS, cone, cone_reference
from terrafuse.lattice import MAX_CELL
from terrafuse.types import Array, Floats

FULL = 65535
"""Ticks of 1. It is 257·255, so that rounding outward to 1/255 is a whole division."""

INTERVAL = np.dtype([("a", "<u2"), ("c", "<u2")])
"""b = 1 - c."""

CELL = np.dtype([("a", "<u2"), ("c", "<u2"), ("revision", "<u4"), ("stamp", "<i8")])
"""A grey cell, 16 bytes. Readings that contradict each other may leave [0, 1]: what tells such a cell from the unknown
one is its revision, which is never 0."""

ANGLE_OF_NO_CONFIDENCE = 1.0 / math.sqrt(21.0)
"""Where Γ reaches 0, 12.5°: cells further off the axis learn nothing, however wide the cone."""

MAX_READING_CELLS = 1536
MAX_SPREAD_CELLS = 500
"""No beam of a scan starts further from where its first one does, east or north. With MAX_BAND_CELLS for Δr this bounds
the memory that a scan can ask for: its cells lie in a square of 5200²."""
FURTHEST_CELL = MAX_CELL - MAX_READING_CELLS - MAX_BAND_CELLS - 2
"""From here every cell of a cone is on the lattice."""

NOT_FINITE, TOO_NEAR, TOO_FAR, UPRIGHT, TOO_LONG, ASTRAY = range(6)
DROP_REASONS = (
    "not finite",
    "nearer than min_range_m",
    "beyond max_range_m",
    "straight up or down",
    f"over {MAX_READING_CELLS} cells long",
    f"from over {MAX_SPREAD_CELLS} cells away from the first, or off the lattice",
)

AT_MAXIMUM = 1e-5
"""A range this close to the maximum, relatively, is the maximum: as much as float32 coordinates may be off."""

X, Y, AXIS_X, AXIS_Y, READING, ECHO = range(6)
"""Columns of beams: apex (m), unit axis on the ground, reading (m), and 1 for an echo, 0 for a reading at maximum."""


class Sonar(NamedTuple):
    """How a reading is believed; the paper's α, ρ_v, Δr and v."""

    opening_angle_rad: float
    rho_v_m: float
    delta_r_m: float
    reliability: float


# --- the formulas, as the paper has them ---------------------------------------------------------------------------


def angle_confidence(theta: Floats | float, opening_angle_rad: float) -> Floats:
    """Γ(θ), eq. 1, with θ in radians; clamped at 0, which it reaches at 12.5°."""
    inside = np.abs(theta) <= opening_angle_rad / 2
    return np.asarray(np.where(inside, np.maximum(1.0 - 21.0 * np.square(theta), 0.0), 0.0))


def distance_confidence(rho: Floats | float, rho_v_m: float) -> Floats:
    """Δ(ρ), eq. 2: near 1 close by, ½ at ρ_v."""
    return np.asarray(1.0 - (1.0 + np.tanh(2.0 * (rho - rho_v_m))) / 2.0)


def band_confidence(rho: Floats | float, reading_m: float, delta_r_m: float) -> Floats:
    """f₁(ρ, r), eq. 3: 1 at the reading, 0 from Δr away on."""
    away = np.abs(rho - reading_m) / delta_r_m
    return np.asarray(np.where(away < 1.0, 1.0 - np.square(away), 0.0))


def interval(rho: Floats, theta: Floats, reading_m: float, echo: bool, sonar: Sonar) -> tuple[Floats, Floats]:
    """[a, b], eqs. 7 and 8, of cells at this distance and angle; a reading without an echo says nothing of its band."""
    confidence = sonar.reliability * angle_confidence(theta, sonar.opening_angle_rad)
    confidence = confidence * distance_confidence(rho, sonar.rho_v_m)
    before = rho <= reading_m - sonar.delta_r_m
    within = np.full(np.shape(rho), echo) & ~before & (rho < reading_m + sonar.delta_r_m)
    a = np.where(within, band_confidence(rho, reading_m, sonar.delta_r_m) * confidence, 0.0)
    return a, 1.0 - np.where(before, confidence, 0.0)


# --- fusing ----------------------------------------------------------------------------------------------------------


@njit(inline="always")
def fused(a1, c1, a2, c2):
    """(a, c) of two intervals in ticks."""
    if a1 == c1 or a2 == c2:
        a, c = max(a1, a2), max(c1, c2)
        if np.int64(a) + np.int64(c) > FULL:
            a, c = min(a1, a2), min(c1, c2)
    elif (a1 > c1) != (a2 > c2):
        a, c = min(a1, a2), min(c1, c2)
    elif a1 > c1:
        a, c = max(a1, a2), min(c1, c2)
    else:
        a, c = min(a1, a2), max(c1, c2)
    return a, c


def fused_reference(one: tuple[int, int], other: tuple[int, int]) -> tuple[int, int]:
    """What `fused` must equal: the table of the four cases, on [a, b] in ticks."""
    (a1, b1), (a2, b2) = one, other
    m1, m2 = a1 + b1, a2 + b2  # twice the white values; ½ is FULL
    if FULL in (m1, m2):
        a, b = max(a1, a2), min(b1, b2)
        return (a, b) if a <= b else (min(a1, a2), max(b1, b2))
    if m1 > FULL and m2 > FULL:
        return max(a1, a2), max(b1, b2)
    if m1 < FULL and m2 < FULL:
        return min(a1, a2), min(b1, b2)
    return min(a1, a2), max(b1, b2)


@njit(cache=True, nogil=True)
def fuse(own, new):
    """The next step of the fold, in place: own (M,) CELL takes new (M,) CELL in."""
    for k in range(own.shape[0]):
        one, other = own[k], new[k]
        one.a, one.c = fused(one.a, one.c, other.a, other.c)
        one.stamp = max(one.stamp, other.stamp)
        one.revision = max(one.revision, other.revision)


@njit(cache=True, nogil=True)
def merge_stable(cells, at, patch, stamp, revision):
    """A robot's cells (T²,) CELL ← a scan's patch (K,) INTERVAL: what was known and what is new are fused."""
    for k in range(at.shape[0]):
        own, new = cells[at[k]], patch[k]
        own.a, own.c = fused(own.a, own.c, new.a, new.c)
        own.stamp = max(own.stamp, stamp)
        own.revision = np.uint32(revision)


@njit(cache=True, nogil=True)
def merge_changing(cells, at, patch, stamp, revision):
    """A robot's cells (T²,) CELL ← a scan's patch (K,) INTERVAL: the newest reading counts, a late one does not."""
    for k in range(at.shape[0]):
        own, new = cells[at[k]], patch[k]
        if stamp < own.stamp:
            continue
        own.a, own.c = new.a, new.c
        own.stamp = stamp
        own.revision = np.uint32(revision)


@njit(cache=True, nogil=True)
def coarsen(cells, factor, out):
    """k×k cells → one: cells (H, W) CELL, out (H/k, W/k) CELL. [max a, max b], the most occupied of them."""
    for j in range(out.shape[0]):
        for i in range(out.shape[1]):
            own = out[j, i]
            own.c = np.uint16(FULL)
            for y in range(j * factor, (j + 1) * factor):
                for x in range(i * factor, (i + 1) * factor):
                    new = cells[y, x]
                    own.a, own.c = max(own.a, new.a), min(own.c, new.c)
                    own.stamp = max(own.stamp, new.stamp)
                    own.revision = max(own.revision, new.revision)


# --- observing -------------------------------------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def aim(ends, origins, echoes, T, near, far, cells_per_m, beams, dropped):
    """(K, 3) ends and origins in the sensor's frame, the first `echoes` of them echoes → beams (K, 6).

    Returns how many count. Ranges outside near to far (m) are dropped and counted; one at `far` is no echo, whatever
    it was given as.
    """
    count = 0
    for k in range(ends.shape[0]):
        dx, dy, dz = ends[k, 0] - origins[k, 0], ends[k, 1] - origins[k, 1], ends[k, 2] - origins[k, 2]
        distance = math.sqrt(dx * dx + dy * dy + dz * dz)
        if not np.isfinite(distance):
            dropped[NOT_FINITE] += 1
            continue
        if distance < near:
            dropped[TOO_NEAR] += 1
            continue
        if distance > far * (1.0 + AT_MAXIMUM):
            dropped[TOO_FAR] += 1
            continue
        east, north = T[0, 0] * dx + T[0, 1] * dy + T[0, 2] * dz, T[1, 0] * dx + T[1, 1] * dy + T[1, 2] * dz
        reading = math.sqrt(east * east + north * north)
        if reading <= 1e-9:
            dropped[UPRIGHT] += 1
            continue
        if reading * cells_per_m > MAX_READING_CELLS:
            dropped[TOO_LONG] += 1
            continue
        beam, first = beams[count], beams[0]
        x, y, z = origins[k, 0], origins[k, 1], origins[k, 2]
        beam[X] = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]
        beam[Y] = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
        away = max(abs(beam[X] - first[X]), abs(beam[Y] - first[Y])) * cells_per_m
        if not away <= MAX_SPREAD_CELLS or max(abs(beam[X]), abs(beam[Y])) * cells_per_m > FURTHEST_CELL:
            dropped[ASTRAY] += 1
            continue
        beam[AXIS_X], beam[AXIS_Y], beam[READING] = east / reading, north / reading, reading
        beam[ECHO] = 1.0 if k < echoes and distance < far * (1.0 - AT_MAXIMUM) else 0.0
        count += 1
    return count


@njit(inline="always")
def ticks(confidence):
    return np.uint16(np.floor(confidence * FULL))


@njit(inline="always")
def says(rho, theta, reading, echo, sonar):
    """(a, c) in ticks: `interval`, with 1 - (1 + tanh(2x))/2 = 1/(1 + e⁴ˣ), and no more work than needed."""
    nothing = np.uint16(0)
    before = rho <= reading - sonar.delta_r_m
    if not before and (not echo or rho >= reading + sonar.delta_r_m):
        return nothing, nothing
    gamma = max(1.0 - 21.0 * theta * theta, 0.0)
    confidence = sonar.reliability * gamma / (1.0 + math.exp(4.0 * (rho - sonar.rho_v_m)))
    if before:
        return nothing, ticks(confidence)
    away = (rho - reading) / sonar.delta_r_m
    return ticks((1.0 - away * away) * confidence), nothing


class Scratch(NamedTuple):
    """The memory of one robot's observer, kept between scans."""

    grid: Array
    """(side, side) int32: `first_slot` + slot of each cell of the window; what is less is of an older scan."""
    i: Array
    j: Array
    """(side²,) int64: the cell of each slot."""
    records: Array
    """(side²,) INTERVAL."""
    cone_i: Array
    cone_j: Array
    rho: Array
    theta: Array
    """Of one cone, (side²,)."""


def new_scratch(side: int) -> Scratch:
    """Scratch for a window of `side`² cells."""
    i, j, cone_i, cone_j = (np.empty(side * side, np.int64) for _ in range(4))
    rho, theta = (np.empty(side * side) for _ in range(2))
    return Scratch(np.zeros((side, side), np.int32), i, j, np.empty(side * side, INTERVAL), cone_i, cone_j, rho, theta)


@njit(cache=True, nogil=True)
def observe(beams, sonar, cells_per_m, i0, j0, first_slot, scratch):
    """Fuse what beams (B, 6) say, in their order, into one record a cell. Returns how many slots are used.

    Only cells that a beam says something about get one. All cones lie in the window whose first cell is (i0, j0); its
    grid holds nothing that is `first_slot` or more.
    """
    grid, records, cone_i, cone_j = scratch.grid, scratch.records, scratch.cone_i, scratch.cone_j
    rho, theta = scratch.rho, scratch.theta
    count = 0
    half_angle = min(sonar.opening_angle_rad / 2.0, ANGLE_OF_NO_CONFIDENCE)
    for b in range(beams.shape[0]):
        x, y, axis_x, axis_y, reading, echo = beams[b]
        reach = reading + sonar.delta_r_m if echo > 0.0 else reading - sonar.delta_r_m
        if reach <= 0.0:
            continue
        met = cone(x, y, axis_x, axis_y, half_angle, reach, cells_per_m, cone_i, cone_j, rho, theta, 0)
        for k in range(met):
            a, c = says(rho[k], theta[k], reading, echo > 0.0, sonar)
            if a == 0 and c == 0:
                continue
            row, column = cone_j[k] - j0, cone_i[k] - i0
            slot = grid[row, column] - first_slot
            if slot < 0:
                grid[row, column] = first_slot + count
                scratch.i[count], scratch.j[count] = cone_i[k], cone_j[k]
                records[count].a, records[count].c = a, c
                count += 1
            else:
                own = records[slot]
                own.a, own.c = fused(own.a, own.c, a, c)
    return count


def observe_reference(beams: Floats, sonar: Sonar, cells_per_m: float) -> dict[tuple[int, int], tuple[int, int]]:
    """What `observe` must equal, within a tick: (i, j) → [a, b] in ticks, by the paper's formulas."""
    out: dict[tuple[int, int], tuple[int, int]] = {}
    for x, y, axis_x, axis_y, reading, echo in beams.tolist():
        reach, heading = reading + sonar.delta_r_m, math.atan2(axis_y, axis_x)
        cells = cone_reference(x, y, heading, sonar.opening_angle_rad / 2, reach, cells_per_m)
        rho, theta = np.array(list(cells.values())).T
        a, b = interval(rho, theta, reading, bool(echo), sonar)
        lower, upper = np.floor(a * FULL).astype(int), FULL - np.floor((1.0 - b) * FULL).astype(int)
        for cell, one in zip(cells, zip(lower.tolist(), upper.tolist(), strict=True), strict=True):
            if one != (0, FULL):
                out[cell] = fused_reference(out[cell], one) if cell in out else one
    return out
