"""Newer cells into a tile: as the reference."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from terrafuse.kernels.newer import put_newer, put_newer_reference

RECORD = np.dtype([("value", "<u2"), ("revision", "<u4")])


@given(seed=st.integers(0, 2**31), count=st.integers(0, 12))
def test_equals_the_reference(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    dense, cells = np.zeros(16, RECORD), np.zeros(count, RECORD)
    for records in (dense, cells):
        records["value"], records["revision"] = rng.integers(0, 2, (2, len(records)))
        records["revision"] += rng.integers(0, 3, len(records)).astype("u4")
    at = np.sort(rng.choice(16, count, replace=False)).astype(np.int32)
    expected = dense.copy()
    ties = np.empty(count, np.int64)
    found = put_newer(as_bytes(dense), dense["revision"], at, as_bytes(cells), cells["revision"], ties)
    wanted = put_newer_reference(as_bytes(expected), expected["revision"], at, as_bytes(cells), cells["revision"])
    assert dense.tobytes() == expected.tobytes()
    assert ties[:found].tolist() == wanted.tolist()


def as_bytes(records: np.ndarray) -> np.ndarray:
    return records.view(np.uint8).reshape(len(records), RECORD.itemsize)
