"""The *patrol* paper's cell, what it knows, and how what it knows ages.

Confidence halves every half-life, worked out when two cells meet or one is read, not by sweeping the map.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from terrafuse.types import Array, Floats, Stamp

CELL = np.dtype(
    [
        ("stamp", "<i8"),
        ("height", "<f8"),
        ("gradient_x", "<f4"),
        ("gradient_y", "<f4"),
        ("gradient_error", "<f4"),
        ("occupation", "<f4"),
        ("confidence", "<f4"),
        ("rival", "<f4"),
        ("revision", "<u4"),
        ("flags", "<u2"),
        ("gps_quality", "u1"),
        ("communications", "u1"),
    ]
)
"""48 bytes without a gap. A quantity that its flag does not call known is 0. `gradient_error` is the standard error of
the gradients, of the worse direction. `confidence` counts from 0 to 1, as it was at `stamp`. `rival` is the height that
the last look found which contradicted the cell. `gps_quality` and `communications` are stored as value + 1; 0: not
given."""

HEIGHT, GRADIENT_X, GRADIENT_Y, OCCUPATION = (np.uint16(1 << bit) for bit in range(4))
"""Flags: which quantities are known. A cell of which nothing but static layers is known has PRIOR alone."""
PRIOR = np.uint16(1 << 4)
"""It was not measured but given, and does not age."""
COARSE = np.uint16(1 << 5)
"""It stands for several finer cells, and its occupation is the worst of theirs."""
HELD = np.uint16(1 << 6)
"""It was seen alike twice, or has replaced another: one look does not replace it."""
CONTRADICTED = np.uint16(1 << 7)
"""The last look that counted contradicted it: another one like that replaces it."""
PLANE = np.uint16(1 << 8)
"""Its points made a plane of their own."""
WALL = np.uint16(1 << 9)
"""Its points reached over more height than any ground: it stands upright, and its height is that of its top."""
RIVAL_WALL = np.uint16(1 << 10)
"""The look that contradicted it saw a wall."""

GRADIENTS = GRADIENT_X | GRADIENT_Y
KNOWN = HEIGHT | GRADIENTS | OCCUPATION
SHAPES = PLANE | WALL
LOOKS = HELD | CONTRADICTED | RIVAL_WALL
FLAGS = KNOWN | PRIOR | COARSE | SHAPES | LOOKS
FLAG_OF = {
    "height": HEIGHT,
    "gradient_x": GRADIENT_X,
    "gradient_y": GRADIENT_Y,
    "gradient_error": GRADIENTS,
    "occupation": OCCUPATION,
    "rival": CONTRADICTED,
}
"""The flags of which at least one is set where a field is not 0."""

MOST_CONFIDENT = np.float32(254 / 255)
"""Certainty is never reached: from 1, confidence would not change any more."""


class Rules(NamedTuple):
    """The thresholds."""

    cos_similar: float
    """Cosine of the largest angle between similar cells' normals."""
    height_tolerance: float
    """metres"""
    confidence_gap: float
    confidence_high: float
    half_lives_per_ns: float
    """0: nothing ages."""
    max_slope: float
    coarse_confidence: float
    """The least with which a fine cell counts for a coarse one's occupation, and a wall against a plane."""


_POWERS = tuple((-math.log(2.0)) ** k / math.factorial(k) for k in range(17))


@njit(nogil=True)
def half_power(x):
    """2⁻ˣ for x ≥ 0, of sums and products only: the same bits on every machine, which the C library's is not."""
    whole = math.floor(x)
    if whole > 1000.0:
        return 0.0
    share = x - whole
    power = 0.0
    for k in range(len(_POWERS) - 1, -1, -1):
        power = power * share + _POWERS[k]
    return math.ldexp(power, -int(whole))


@njit(inline="always")
def new_memo():
    """What `aged` remembers: an age in half-lives and what it leaves. Cells of one map share few ages."""
    return np.array([0.0, 1.0])


@njit(inline="always")
def aged(cell, stamp, later, rules, memo):
    """The confidence that a cell of this stamp has left at `later`."""
    if cell.flags & PRIOR or later <= stamp:
        return np.float64(cell.confidence)
    half_lives = (later - stamp) * rules.half_lives_per_ns
    if half_lives != memo[0]:
        memo[0], memo[1] = half_lives, half_power(half_lives)
    return cell.confidence * memo[1]


@njit(cache=True, nogil=True)
def aged_at(cells, later, rules):
    """(M,) float64: the confidence that each of (M,) CELL has left at `later`."""
    memo, out = new_memo(), np.empty(cells.shape[0])
    for k in range(cells.shape[0]):
        out[k] = aged(cells[k], cells[k].stamp, later, rules, memo)
    return out


def aged_reference(cells: Array, later: Array | Stamp, rules: Rules) -> Floats:
    """c · 2^(-Δt / half-life), but for what is given and what is not older."""
    half_lives = np.maximum(np.subtract(later, cells["stamp"]), 0) * rules.half_lives_per_ns
    confidence = cells["confidence"].astype(np.float64)
    return np.where(cells["flags"] & PRIOR, confidence, confidence * np.exp2(-half_lives))
