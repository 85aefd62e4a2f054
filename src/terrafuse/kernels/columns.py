"""Records as columns of differences, and back: what makes neighbouring cells small for a compressor.

Of a column, each value is the difference to the value before, modulo 2^(8·size); its bytes are transposed: first the
lowest bytes of all values, then the next ones.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from terrafuse.types import Array


class Fields(NamedTuple):
    """Where the fields of a record lie, bytes: (F,) int64 each."""

    offsets: Array
    sizes: Array


@cache
def fields_of(dtype: np.dtype[Any]) -> Fields:
    """Those of a dtype, structured or not, in its order."""
    if dtype.fields is None:
        return Fields(np.zeros(1, np.int64), np.array([dtype.itemsize], np.int64))
    fields = [dtype.fields[name] for name in dtype.names or ()]
    return Fields(
        np.array([field[1] for field in fields], np.int64), np.array([field[0].itemsize for field in fields], np.int64)
    )


@njit(cache=True, nogil=True)
def to_columns(records, offsets, sizes, columns):
    """records (K, itemsize) uint8, little endian → columns (K·Σ sizes,) uint8."""
    count, start = records.shape[0], 0
    for field in range(len(sizes)):
        before = np.uint64(0)
        for k in range(count):
            value = np.uint64(0)
            for byte in range(sizes[field]):
                value |= np.uint64(records[k, offsets[field] + byte]) << np.uint64(8 * byte)
            difference = value - before
            for byte in range(sizes[field]):
                columns[start + byte * count + k] = (difference >> np.uint64(8 * byte)) & np.uint64(255)
            before = value
        start += sizes[field] * count


@njit(cache=True, nogil=True)
def from_columns(columns, offsets, sizes, records):
    """The inverse of `to_columns`, into records of zeros."""
    count, start = records.shape[0], 0
    for field in range(len(sizes)):
        value = np.uint64(0)
        for k in range(count):
            for byte in range(sizes[field]):
                value += np.uint64(columns[start + byte * count + k]) << np.uint64(8 * byte)
            for byte in range(sizes[field]):
                records[k, offsets[field] + byte] = (value >> np.uint64(8 * byte)) & np.uint64(255)
        start += sizes[field] * count


def to_columns_reference(records: Array) -> bytes:
    """What `to_columns` must equal, of records (K,)."""
    return b"".join(_column(np.ascontiguousarray(records[name])) for name in records.dtype.names or ())


def _column(values: Array) -> bytes:
    unsigned = values.view(f"<u{values.dtype.itemsize}")
    differences = np.diff(unsigned, prepend=unsigned.dtype.type(0))
    return differences.view(np.uint8).reshape(-1, values.dtype.itemsize).T.tobytes()
