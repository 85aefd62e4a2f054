"""What travels of `terrain`. A robot's memory of the last look that contradicted a cell is its own: the fold has no use
for it."""

from __future__ import annotations

import numpy as np

from terrafuse.exchange.profiles.base import Profile, Quantity, at_level, level, most_level, steps
from terrafuse.kernels import rounded
from terrafuse.kernels.entropy import MOST, PREDICTED, SIGNED
from terrafuse.kernels.terrain import (
    CELL,
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
from terrafuse.types import Array

HEIGHT_M = 0.01
GRADIENT = 0.01
FULL_OCCUPATIONS, LEAN_OCCUPATIONS = 100, 4
"""Steps of the occupation from 0 to 1."""
CONFIDENCES, ERRORS = 1 << 12, 1 << 16
"""Confidences and standard errors are counted in 1/4096 and in 1/65536 before they are rounded to levels."""
FULL_BITS, LEAN_BITS, ERROR_BITS = 4, 1, 3
MOST_ERROR = 1e6

SLOPES = np.array([0, GRADIENT_X | GRADIENT_Y, GRADIENT_X, GRADIENT_Y], np.int64)
"""Which gradients are known, by number."""


def _bit(cells: Array, flag: np.uint16) -> Array:
    return np.asarray(cells["flags"] & flag != 0, np.int64)


def _rare(cells: Array) -> Array:
    """What nearly all cells have alike, as one number: a height, nothing given."""
    gps, link = (cells[name].astype(np.int64) for name in ("gps_quality", "communications"))
    return np.asarray(1 - _bit(cells, HEIGHT) | _bit(cells, PRIOR) << 1 | gps << 2 | link << 4)


def _occupation(cells: Array, count: int) -> Array:
    """0: unknown; else 1 + steps."""
    return np.where(_bit(cells, OCCUPATION), 1 + steps(cells["occupation"], 1 / count), 0)


def _confidence(cells: Array, bits: int) -> Array:
    return level(steps(cells["confidence"], 1 / CONFIDENCES), bits)


def _new(rare: Array, height: Array, confidence: Array, bits: int) -> Array:
    out = np.zeros(len(rare), CELL)
    out["flags"] = np.where(rare & 1, 0, HEIGHT) | np.where(rare & 2, PRIOR, 0)
    out["gps_quality"], out["communications"] = rare >> 2 & 3, rare >> 4 & 3
    out["height"] = height * HEIGHT_M
    out["confidence"] = np.minimum(at_level(confidence, bits) / CONFIDENCES, MOST_CONFIDENT)
    return out


def _flag(out: Array, flag: np.uint16, bit: Array) -> None:
    out["flags"] |= np.where(bit != 0, flag, np.uint16(0))


def _occupy(out: Array, numbers: Array, count: int) -> None:
    out["occupation"] = np.maximum(numbers - 1, 0) / count
    _flag(out, OCCUPATION, numbers)


# --- full -------------------------------------------------------------------------------------------------------------


def _full_numbers(cells: Array) -> Array:
    x, y = _bit(cells, GRADIENT_X), _bit(cells, GRADIENT_Y)
    slopes = np.where(x & y, 1, 2 * x + 3 * y)
    errors = steps(np.clip(cells["gradient_error"], 0, MOST_ERROR), 1 / ERRORS)
    return np.stack([
        _rare(cells),
        *(_bit(cells, flag) for flag in (COARSE, WALL, HELD, PLANE)),
        slopes,
        steps(cells["height"], HEIGHT_M),
        _confidence(cells, FULL_BITS),
        *(np.where(slopes, value, 0) for value in (
            steps(cells["gradient_x"], GRADIENT), steps(cells["gradient_y"], GRADIENT), level(errors, ERROR_BITS),
        )),
        _occupation(cells, FULL_OCCUPATIONS),
    ])  # fmt: skip


def full_reference(numbers: Array) -> Array:
    """What the kernel must equal."""
    rare, coarse, wall, held, plane, slopes, height, confidence, east, north, error, occupation = numbers
    out = _new(rare, height, confidence, FULL_BITS)
    for flag, bit in ((COARSE, coarse), (WALL, wall), (HELD, held), (PLANE, plane)):
        _flag(out, flag, bit)
    out["flags"] |= SLOPES[slopes].astype(np.uint16)
    out["gradient_x"], out["gradient_y"] = east * GRADIENT, north * GRADIENT
    out["gradient_error"] = at_level(error, ERROR_BITS) / ERRORS
    _occupy(out, occupation, FULL_OCCUPATIONS)
    return out


def _full_cells(numbers: Array) -> Array:
    out = np.zeros(numbers.shape[1], CELL)
    rounded.terrain_full(
        numbers, FULL_BITS, ERROR_BITS, FULL_OCCUPATIONS, HEIGHT_M, GRADIENT, 1 / CONFIDENCES, 1 / ERRORS, out
    )
    return out


FULL = Profile(
    (
        Quantity("rare", most=63),
        *(Quantity(name, most=1) for name in ("coarse", "wall", "held", "plane")),
        Quantity("slopes", most=3),
        Quantity("height", PREDICTED, least=-MOST),
        Quantity("confidence", PREDICTED, most_level(CONFIDENCES, FULL_BITS)),
        Quantity("gradient_x", SIGNED, MOST, "slopes"),
        Quantity("gradient_y", SIGNED, MOST, "slopes"),
        Quantity("gradient_error", most=most_level(round(MOST_ERROR * ERRORS), ERROR_BITS), where="slopes"),
        Quantity("occupation", most=1 + FULL_OCCUPATIONS),
    ),
    _full_numbers,
    _full_cells,
)


# --- lean -------------------------------------------------------------------------------------------------------------


def _lean_numbers(cells: Array) -> Array:
    coarse = _bit(cells, COARSE)
    return np.stack([
        _rare(cells),
        coarse,
        _bit(cells, WALL),
        steps(cells["height"], HEIGHT_M),
        _confidence(cells, LEAN_BITS),
        np.where(coarse, _occupation(cells, LEAN_OCCUPATIONS), 0),
    ])  # fmt: skip


def lean_reference(numbers: Array) -> Array:
    """What the kernel must equal."""
    rare, coarse, wall, height, confidence, occupation = numbers
    out = _new(rare, height, confidence, LEAN_BITS)
    _flag(out, COARSE, coarse)
    _flag(out, WALL, wall)
    _occupy(out, np.where(wall & ~coarse & 1, 1 + LEAN_OCCUPATIONS, occupation), LEAN_OCCUPATIONS)
    return out


def _lean_cells(numbers: Array) -> Array:
    out = np.zeros(numbers.shape[1], CELL)
    rounded.terrain_lean(numbers, LEAN_BITS, LEAN_OCCUPATIONS, HEIGHT_M, 1 / CONFIDENCES, out)
    return out


LEAN = Profile(
    (
        Quantity("rare", most=63),
        Quantity("coarse", most=1),
        Quantity("wall", most=1),
        Quantity("height", PREDICTED, least=-MOST),
        Quantity("confidence", PREDICTED, most_level(CONFIDENCES, LEAN_BITS)),
        Quantity("occupation", PREDICTED, 1 + LEAN_OCCUPATIONS, "coarse"),
    ),
    _lean_numbers,
    _lean_cells,
)
PROFILES = {"lean": LEAN, "full": FULL}
