"""Least-squares planes over squares of cells."""

from __future__ import annotations

import numpy as np
from numba import njit

from terrafuse.types import Array, Floats


@njit(cache=True, nogil=True)
def _fit(w, known, half, a, b, residual2, count):
    """Sums over the square are sums over columns of sums over a column: 2k steps a cell instead of k²."""
    height, width = w.shape
    # Of each column of the band around row j: how many are known, Σv, Σv², Σw, Σvw, Σw²; `half` empty ones beside.
    columns = np.zeros((6, width + 2 * half))
    N, V, VV, W, VW, WW = columns[0], columns[1], columns[2], columns[3], columns[4], columns[5]
    somewhere = np.zeros(height, np.bool_)
    for y in range(height):
        somewhere[y] = known[y].any()
    for j in range(height):
        first, last = max(0, j - half), min(height, j + half + 1)
        if not somewhere[first:last].any():
            continue
        columns[:] = 0.0
        for y in range(first, last):
            if not somewhere[y]:
                continue
            v = np.float64(y - j)
            for x in range(width):
                k, h = known[y, x], w[y, x]
                N[x + half] += k
                V[x + half] += v * k
                VV[x + half] += v * v * k
                W[x + half] += h
                VW[x + half] += v * h
                WW[x + half] += h * h
        for i in range(width):
            n = 0.0
            for x in range(i, i + 2 * half + 1):
                n += N[x]
            count[j, i] = int(n)
            if n < 3.0:
                continue
            su = sv = sw = suu = suv = svv = suw = svw = sww = 0.0
            for x in range(i, i + 2 * half + 1):
                u = np.float64(x - i - half)
                su += u * N[x]
                sv += V[x]
                sw += W[x]
                suu += u * u * N[x]
                suv += u * V[x]
                svv += VV[x]
                suw += u * W[x]
                svw += VW[x]
                sww += WW[x]
            mu, mv, mw = su / n, sv / n, sw / n
            cuu, cuv, cvv = suu - su * mu, suv - su * mv, svv - sv * mv
            cuw, cvw, cww = suw - su * mw, svw - sv * mw, sww - sw * mw
            determinant = cuu * cvv - cuv * cuv
            if determinant <= 1e-9 * cuu * cvv:  # on one line
                continue
            a[j, i] = (cuw * cvv - cvw * cuv) / determinant
            b[j, i] = (cvw * cuu - cuw * cuv) / determinant
            residual2[j, i] = max(0.0, cww - a[j, i] * cuw - b[j, i] * cvw) / n


def fit_planes(z: Floats, cells: int) -> tuple[Floats, Floats, Floats, Array]:
    """Fit z = a·x + b·y + c to the known heights of the `cells`×`cells` square around each cell of z (H, W).

    x and y count cells. Returns a and b (metres a cell), the mean squared residual (m²), each NaN where fewer than
    three known cells or all on one line, and how many were known.
    """
    a, b, residual2 = (np.full(z.shape, np.nan) for _ in range(3))
    count = np.zeros(z.shape, np.int64)
    known = ~np.isnan(z)
    # Heights count from their mean, so that 1000 m above the datum costs no digits.
    w = np.where(known, z - (z[known].mean() if known.any() else 0.0), 0.0)
    _fit(w, known.astype(np.float64), cells // 2, a, b, residual2, count)
    return a, b, residual2, count


def fit_planes_reference(z: Floats, cells: int) -> tuple[Floats, Floats, Floats, Array]:
    """What `fit_planes` must equal, by NumPy's least squares on each square."""
    half = cells // 2
    padded = np.pad(z, half, constant_values=np.nan)
    y, x = np.mgrid[-half : half + 1, -half : half + 1].astype(np.float64)
    a, b, residual2 = (np.full(z.shape, np.nan) for _ in range(3))
    count = np.zeros(z.shape, np.int64)
    for j, i in np.ndindex(*z.shape):
        square = padded[j : j + cells, i : i + cells]
        known = ~np.isnan(square)
        count[j, i] = known.sum()
        A = np.stack([x[known], y[known], np.ones(known.sum())], axis=1)
        if np.linalg.matrix_rank(A) < 3:
            continue
        solution, *_ = np.linalg.lstsq(A, square[known], rcond=None)
        a[j, i], b[j, i] = solution[:2]
        residual2[j, i] = np.mean((A @ solution - square[known]) ** 2)
    return a, b, residual2, count
