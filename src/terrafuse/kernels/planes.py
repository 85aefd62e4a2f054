"""Least-squares planes over squares of cells."""

from __future__ import annotations

import numpy as np
from numba import njit

from terrafuse.types import Array, Floats


@njit(cache=True, nogil=True)
def _fit(z, half, a, b, residual2, count):
    height, width = z.shape
    for j in range(height):
        for i in range(width):
            n = sx = sy = sz = sxx = sxy = syy = sxz = syz = szz = 0.0
            # Heights count from a known one in the square, so that 1000 m above the datum costs no digits.
            datum = np.nan
            for y in range(max(0, j - half), min(height, j + half + 1)):
                for x in range(max(0, i - half), min(width, i + half + 1)):
                    if np.isnan(z[y, x]):
                        continue
                    if n == 0.0:
                        datum = z[y, x]
                    u, v, w = np.float64(x - i), np.float64(y - j), z[y, x] - datum
                    n += 1.0
                    sx += u
                    sy += v
                    sz += w
                    sxx += u * u
                    sxy += u * v
                    syy += v * v
                    sxz += u * w
                    syz += v * w
                    szz += w * w
            count[j, i] = int(n)
            if n < 3.0:
                continue
            cxx, cxy, cyy = sxx - sx * sx / n, sxy - sx * sy / n, syy - sy * sy / n
            cxz, cyz, czz = sxz - sx * sz / n, syz - sy * sz / n, szz - sz * sz / n
            determinant = cxx * cyy - cxy * cxy
            if determinant < 1e-9:
                continue
            a[j, i] = (cxz * cyy - cyz * cxy) / determinant
            b[j, i] = (cyz * cxx - cxz * cxy) / determinant
            residual2[j, i] = max(0.0, czz - a[j, i] * cxz - b[j, i] * cyz) / n


def fit_planes(z: Floats, cells: int) -> tuple[Floats, Floats, Floats, Array]:
    """Fit z = a·x + b·y + c to the known heights of the `cells`×`cells` square around each cell of z (H, W).

    x and y count cells. Returns a and b (metres a cell), the mean squared residual (m²), each NaN where fewer than
    three known cells or all on one line, and how many were known.
    """
    a, b, residual2 = (np.full(z.shape, np.nan) for _ in range(3))
    count = np.zeros(z.shape, np.int64)
    _fit(np.ascontiguousarray(z), cells // 2, a, b, residual2, count)
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
