"""Records of the numbers that travel, a loop each: what `exchange.profiles` says in arrays, and must equal."""

from __future__ import annotations

import numpy as np
from numba import njit

from terrafuse.kernels.evidence import TICKS_PER_M
from terrafuse.kernels.terrain import (
    COARSE,
    GRADIENT_X,
    GRADIENT_Y,
    HEIGHT,
    HELD,
    MOST_CONFIDENT,
    OCCUPATION,
    PLANE,
    PRIOR,
    WALL,
)

STEP = int(TICKS_PER_M) // 100
"""A centimetre in ticks."""
MM2 = (int(TICKS_PER_M) // 1000) ** 2
"""A mm² in ticks²."""
CM2 = 100
"""A cm² in mm²."""
MOST_COUNT = 2**32 - 1


@njit(inline="always")
def at_level(number, bits):
    shift = max((number >> bits) - 1, 0)
    return (number - (shift << bits)) << shift


@njit(inline="always")
def set_sums(record, n, mean, below, above, mm2):
    """n points of this mean and extremes (cm) and variance (mm²); fields as EVIDENCE."""
    count, z = min(n, MOST_COUNT), mean * STEP
    square, times = np.uint64(z * z + mm2 * MM2), np.uint64(count)
    lower, upper = times * (square & np.uint64(0xFFFFFFFF)), times * (square >> np.uint64(32))
    low_word = lower + (upper << np.uint64(32))
    record.n = count
    record.z_sum = count * z
    record.z_min = z - below * STEP
    record.z_max = z + above * STEP
    record.sq_lo = low_word
    record.sq_hi = (upper >> np.uint64(32)) + np.uint64(low_word < lower)


@njit(inline="always")
def set_none(record):
    """No points at all."""
    record.n = 0
    record.z_sum = 0
    record.z_min = 0
    record.z_max = 0
    record.sq_lo = 0
    record.sq_hi = 0


@njit(cache=True, nogil=True)
def elevation_full(numbers, n_bits, variance_bits, cells, grounds):
    """numbers (12, K) → cells (K,) of zeros; grounds is the same memory as GROUND_OF_CELL."""
    for k in range(cells.shape[0]):
        n, mean, below, above = numbers[0, k], numbers[1, k], numbers[2, k], numbers[3, k]
        set_sums(cells[k], at_level(n, n_bits), mean, below, above, at_level(numbers[4, k], variance_bits))
        cells[k].changes = numbers[5, k]
        cells[k].merges = numbers[5, k] + numbers[6, k] + 1
        if numbers[7, k] > 0:
            n, mean, below, above = numbers[7, k], mean + numbers[8, k], numbers[9, k], numbers[10, k]
            set_sums(grounds[k], at_level(n, n_bits), mean, below, above, at_level(numbers[11, k], variance_bits))


@njit(cache=True, nogil=True)
def elevation_lean(numbers, n_bits, cells, grounds):
    """numbers (3, K) → cells (K,), whatever they were; grounds is the same memory as GROUND_OF_CELL."""
    for k in range(cells.shape[0]):
        half = at_level(numbers[2, k], 0)
        set_sums(cells[k], at_level(numbers[0, k], n_bits), numbers[1, k] - half, half, half, CM2 * half * half)
        cells[k].merges = 1
        cells[k].changes = cells[k].revision = 0
        cells[k].stamp = 0
        set_none(grounds[k])


@njit(inline="always")
def set_terrain(cell, rare, coarse, wall, height, confidence, height_m, share):
    """What both profiles have."""
    flags = (np.uint16(0) if rare & 1 else HEIGHT) | (PRIOR if rare & 2 else np.uint16(0))
    cell.flags = flags | (COARSE if coarse else np.uint16(0)) | (WALL if wall else np.uint16(0))
    cell.gps_quality, cell.communications = rare >> 2 & 3, rare >> 4 & 3
    cell.height = height * height_m
    cell.confidence = min(confidence * share, np.float64(MOST_CONFIDENT))


@njit(inline="always")
def set_occupation(cell, number, count):
    if number > 0:
        cell.flags |= OCCUPATION
        cell.occupation = (number - 1) / count


@njit(cache=True, nogil=True)
def terrain_full(numbers, bits, error_bits, count, height_m, gradient, share, error, cells):
    """numbers (12, K) → cells (K,) of zeros."""
    for k in range(cells.shape[0]):
        cell = cells[k]
        sure = at_level(numbers[7, k], bits)
        set_terrain(cell, numbers[0, k], numbers[1, k], numbers[2, k], numbers[6, k], sure, height_m, share)
        cell.flags |= (HELD if numbers[3, k] else np.uint16(0)) | (PLANE if numbers[4, k] else np.uint16(0))
        slopes = numbers[5, k]
        cell.flags |= (GRADIENT_X if slopes in (1, 2) else np.uint16(0)) | (GRADIENT_Y if slopes & 1 else np.uint16(0))
        cell.gradient_x, cell.gradient_y = numbers[8, k] * gradient, numbers[9, k] * gradient
        cell.gradient_error = at_level(numbers[10, k], error_bits) * error
        set_occupation(cell, numbers[11, k], count)


@njit(cache=True, nogil=True)
def terrain_lean(numbers, bits, count, height_m, share, cells):
    """numbers (6, K) → cells (K,) of zeros."""
    for k in range(cells.shape[0]):
        cell, coarse, wall = cells[k], numbers[1, k], numbers[2, k]
        set_terrain(cell, numbers[0, k], coarse, wall, numbers[3, k], at_level(numbers[4, k], bits), height_m, share)
        set_occupation(cell, 1 + count if wall and not coarse else numbers[5, k], count)
