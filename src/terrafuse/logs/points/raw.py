"""Arrays without a header (.bin) and NumPy's own (.npy)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from terrafuse.errors import LogError
from terrafuse.types import Array


def read_npy(path: Path) -> Array:
    """An array (N, 3 or more) whose first columns are x, y, z. Raises LogError for any other."""
    try:
        values = np.load(path, allow_pickle=False)
    except (ValueError, EOFError, OSError) as error:
        raise LogError(f"{path}: {error}: truncated, or not a plain .npy array") from None
    if values.ndim != 2 or values.shape[1] < 3 or values.dtype.kind not in "fiu":
        raise LogError(f"{path}: an array {values.shape} of {values.dtype}; points are numbers in (N, 3 or more)")
    single = values.dtype.kind == "f" and values.dtype.itemsize <= 4
    return np.ascontiguousarray(values[:, :3], np.float32 if single else np.float64)


def read_bin(path: Path, columns: int) -> Array:
    """float32, little endian, this many a point, x y z first. Raises LogError if the size does not fit."""
    size = path.stat().st_size
    if size % (4 * columns):
        raise LogError(
            f"{path}: {size} bytes are no whole number of points of {columns} float32; "
            "truncated, or say the right ?columns="
        )
    return np.ascontiguousarray(np.fromfile(path, "<f4").reshape(-1, columns)[:, :3])
