"""What travels of `occupancy`: the sum of log-odds in even steps, and how many updates, rounded up, so that no sum is
more than they can give."""

from __future__ import annotations

import numpy as np

from terrafuse.exchange.profiles.base import Profile, Quantity, at_level, level_above, most_level
from terrafuse.kernels.entropy import MOST, PREDICTED
from terrafuse.kernels.occupancy import CELL, MOST_UPDATES
from terrafuse.types import Array

FULL_TICKS, LEAN_TICKS = 500, 1000
"""Steps of the sum: 0.05 and 0.1 nat. Both divide the most that a reading can say."""
FULL_BITS, LEAN_BITS = 3, 0


def profile(step: int, bits: int) -> Profile:
    def numbers(cells: Array) -> Array:
        whole, rest = np.divmod(cells["sum"], step)
        nearest = whole + (2 * rest + (whole & 1) > step)  # halves to even
        return np.stack([np.clip(nearest, -MOST, MOST), level_above(cells["updates"], bits)])

    def cells(numbers: Array) -> Array:
        out = np.zeros(numbers.shape[1], CELL)
        out["sum"] = numbers[0] * step
        out["updates"] = np.minimum(at_level(numbers[1], bits), MOST_UPDATES)
        return out

    return Profile(
        (
            Quantity("sum", PREDICTED, least=-MOST),
            Quantity("updates", PREDICTED, most_level(MOST_UPDATES, bits), least=1),
        ),
        numbers,
        cells,
    )


PROFILES = {"lean": profile(LEAN_TICKS, LEAN_BITS), "full": profile(FULL_TICKS, FULL_BITS)}
