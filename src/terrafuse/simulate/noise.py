"""Smooth random surfaces: noise of one wavelength, and sums of several."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from terrafuse.types import Array, Floats

MEAN_SQUARE = 151 / 315
"""Of a cubic B-spline's weights, over all places: what splines of white noise lose in variance along an axis."""


class Octave(NamedTuple):
    wavelength_m: float
    sigma_m: float
    """Standard deviation over the plane."""


def octaves(x_m: Floats, y_m: Floats, parts: tuple[Octave, ...], seed: int) -> Floats:
    """The sum of several, (len(y), len(x)); each has a stream of random numbers of its own, by its place in `parts`."""
    out = np.zeros((len(y_m), len(x_m)))
    for number, part in enumerate(parts):
        out += part.sigma_m * unit_noise(x_m, y_m, part.wavelength_m, np.random.default_rng([seed, number]))
    return out


def unit_noise(x_m: Floats, y_m: Floats, wavelength_m: float, rng: np.random.Generator) -> Floats:
    """Cubic splines through white noise on knots half a wavelength apart: twice continuously differentiable, with mean
    0 and variance 1 over the plane. (len(y), len(x)) on rising axes."""
    (i, wi), (j, wj) = (_spline(axis - axis[0], wavelength_m / 2) for axis in (x_m, y_m))
    knots = rng.standard_normal((j[-1] + 4, i[-1] + 4))
    out = np.zeros((len(y_m), len(x_m)))
    for b in range(4):
        # Sums of four in a fixed order: a matrix product's last bits depend on the machine.
        along = sum(wi[a] * knots[j + b][:, i + a] for a in range(4))
        out += wj[b][:, None] * along
    return out / MEAN_SQUARE


def _spline(offset_m: Floats, spacing_m: float) -> tuple[Array, list[Floats]]:
    """The first of four knots at each place, and their weights."""
    place = offset_m / spacing_m
    first = np.floor(place).astype(np.int64)
    f = place - first
    weights = [(1 - f) ** 3, 3 * f**3 - 6 * f**2 + 4, -3 * f**3 + 3 * f**2 + 3 * f + 1, f**3]
    return first, [np.asarray(w / 6) for w in weights]


def axis(start_m: float, end_m: float, step_m: float) -> Floats:
    """Places from start on, a step apart, the last at or beyond the end."""
    return np.asarray(start_m + step_m * np.arange(math.ceil((end_m - start_m) / step_m - 1e-9) + 1))
