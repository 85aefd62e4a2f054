"""GNSS as the layer `gps_quality` lets it be: nothing, metres that wander slowly, or decimetres."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from terrafuse.navigate.readings import NO_FIX, Fix, GnssModel
from terrafuse.types import Floats, Stamp

QualityAt = Callable[[float, float], ArrayLike]
"""(x, y) in metres → 0 none, 1 single, 2 differential: `StaticLayer.at`, or any function."""


class Gnss:
    """One robot's receiver. Draws the same random numbers at each reading, whatever the quality.

    With `outlier_chance` a fix is off by `outlier_m` in a random direction.
    """

    def __init__(
        self,
        model: GnssModel,
        quality_at: QualityAt,
        rng: np.random.Generator,
        outlier_chance: float = 0.0,
        outlier_m: float = 50.0,
    ) -> None:
        self._model, self._quality_at, self._rng = model, quality_at, rng
        self._outlier_chance, self._outlier_m = outlier_chance, outlier_m
        self._wander = rng.normal(size=3)
        self._stamp_ns: Stamp | None = None

    def read(self, stamp_ns: Stamp, position_m: Floats) -> Fix:
        """What the receiver says at the true place (3,); later readings have later stamps."""
        kept = self._model.kept((stamp_ns - (stamp_ns if self._stamp_ns is None else self._stamp_ns)) * 1e-9)
        self._stamp_ns = stamp_ns
        fresh, white = self._rng.normal(size=(2, 3))
        self._wander = kept * self._wander + (1 - kept**2) ** 0.5 * fresh
        chance, direction = self._rng.random(2).tolist()
        quality = int(np.asarray(self._quality_at(float(position_m[0]), float(position_m[1]))))
        if quality == NO_FIX:
            return Fix(stamp_ns, np.full(3, np.nan), NO_FIX)
        white_m, slow_m = self._model.deviations(quality)
        error_m = white_m * white + slow_m * self._wander
        if chance < self._outlier_chance:
            angle = 2 * np.pi * direction
            error_m += self._outlier_m * np.array([np.cos(angle), np.sin(angle), 0.0])
        return Fix(stamp_ns, position_m + error_m, quality)
