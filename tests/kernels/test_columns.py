"""Columns of records: as the reference, and back."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from terrafuse.kernels import columns
from terrafuse.kernels.absorb import SURFACE
from terrafuse.models import MODELS
from terrafuse.types import Array

DTYPES: dict[str, np.dtype[Any]] = {name: make().cell for name, make in MODELS.items()} | {
    "of all sizes": np.dtype([("a", "<u1"), ("b", "<i2"), ("c", "<f4"), ("d", "<i8"), ("e", "<f8"), ("f", "?")]),
    "with gaps": SURFACE,
}


def split(records: Array) -> bytes:
    offsets, sizes = columns.fields_of(records.dtype)
    out = np.empty(len(records) * int(sizes.sum()), np.uint8)
    columns.to_columns(records.view(np.uint8).reshape(len(records), -1), offsets, sizes, out)
    return out.tobytes()


def joined(raw: bytes, count: int, dtype: np.dtype[Any]) -> Array:
    records = np.zeros(count, dtype)
    view = records.view(np.uint8).reshape(count, dtype.itemsize)
    columns.from_columns(np.frombuffer(raw, np.uint8), *columns.fields_of(dtype), view)
    return records


@pytest.mark.parametrize("name", DTYPES)
@given(seed=st.integers(0, 2**31), count=st.integers(1, 40))
def test_equals_the_reference_and_is_undone(name: str, seed: int, count: int) -> None:
    records = np.zeros(count, DTYPES[name])
    rng = np.random.default_rng(seed)
    for field in records.dtype.names or ():
        size = records.dtype[field].itemsize
        records[field] = rng.integers(0, 256, (count, size), np.uint8).view(records.dtype[field])[:, 0]
    raw = split(records)
    assert raw == columns.to_columns_reference(records)
    assert joined(raw, count, records.dtype).tobytes() == records.tobytes()


def test_a_plain_column() -> None:
    # 3; 3 + 253 = 256, of which 0x0100 - 0x0003 = 0x00fd; 255 - 256 = -1 = 0xffff; lowest bytes first.
    values = np.array([3, 256, 255], "<u2")
    assert split(values) == bytes([0x03, 0xFD, 0xFF, 0x00, 0x00, 0xFF])
    assert joined(split(values), 3, values.dtype).tolist() == [3, 256, 255]
