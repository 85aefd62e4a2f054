"""What travels of `grey`: both ends of the interval, rounded outward, so that the true interval stays inside."""

from __future__ import annotations

import numpy as np

from terrafuse.exchange.profiles.base import Profile, Quantity
from terrafuse.kernels.entropy import PREDICTED
from terrafuse.kernels.grey import CELL, FULL
from terrafuse.types import Array

FULL_LEVELS, LEAN_LEVELS = 255, 15


def profile(levels: int) -> Profile:
    step = FULL // levels  # both divide 65535

    def numbers(cells: Array) -> Array:
        return np.stack([cells[name].astype(np.int64) // step for name in ("a", "c")])

    def cells(numbers: Array) -> Array:
        out = np.zeros(numbers.shape[1], CELL)
        out["a"], out["c"] = numbers * step
        return out

    return Profile((Quantity("a", PREDICTED, levels), Quantity("c", PREDICTED, levels)), numbers, cells)


PROFILES = {"lean": profile(LEAN_LEVELS), "full": profile(FULL_LEVELS)}
