"""From named columns to an array of points."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from terrafuse.errors import LogError
from terrafuse.logs.options import listed
from terrafuse.types import Array


def need_xyz(names: Sequence[str], path: Path) -> list[int]:
    """Where x, y and z are among the names. Raises LogError listing what there is."""
    if not {"x", "y", "z"} <= set(names):
        raise LogError(f"{path}: no columns x, y, z; it has {listed(names)}")
    return [names.index(name) for name in "xyz"]


def xyz_of(records: Any) -> Array:
    """(N, 3) of a structured array's x, y, z: float32 if all three are, else float64, native byte order."""
    columns = [np.asarray(records[name]) for name in "xyz"]
    single = all(column.dtype.kind == "f" and column.dtype.itemsize <= 4 for column in columns)
    points = np.empty((len(records), 3), np.float32 if single else np.float64)
    for axis, column in enumerate(columns):
        points[:, axis] = column
    return points
