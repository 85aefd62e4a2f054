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
    start = 0
    for field in range(len(sizes)):
        offset, size = offsets[field], sizes[field]
        # The usual sizes as constants: their loops are unrolled then, which is half again as fast.
        if size == 8:
            split(records, offset, 8, columns, start)
        elif size == 4:
            split(records, offset, 4, columns, start)
        else:
            split(records, offset, size, columns, start)
        start += size * records.shape[0]


@njit(cache=True, nogil=True)
def from_columns(columns, offsets, sizes, records):
    """The inverse of `to_columns`, into records of zeros."""
    start = 0
    for field in range(len(sizes)):
        offset, size = offsets[field], sizes[field]
        if size == 8:
            join(columns, start, 8, records, offset)
        elif size == 4:
            join(columns, start, 4, records, offset)
        else:
            join(columns, start, size, records, offset)
        start += size * records.shape[0]


@njit(inline="always")
def split(records, offset, size, columns, start):
    """One field's column."""
    count, before = records.shape[0], np.uint64(0)
    for k in range(count):
        value = np.uint64(0)
        for byte in range(size):
            value |= np.uint64(records[k, offset + byte]) << np.uint64(8 * byte)
        difference = value - before
        for byte in range(size):
            columns[start + byte * count + k] = (difference >> np.uint64(8 * byte)) & np.uint64(255)
        before = value


@njit(inline="always")
def join(columns, start, size, records, offset):
    """One column's field."""
    count, value = records.shape[0], np.uint64(0)
    for k in range(count):
        for byte in range(size):
            value += np.uint64(columns[start + byte * count + k]) << np.uint64(8 * byte)
        for byte in range(size):
            records[k, offset + byte] = (value >> np.uint64(8 * byte)) & np.uint64(255)


def to_columns_reference(records: Array) -> bytes:
    """What `to_columns` must equal, of records (K,)."""
    return b"".join(_column(np.ascontiguousarray(records[name])) for name in records.dtype.names or ())


def _column(values: Array) -> bytes:
    unsigned = values.view(f"<u{values.dtype.itemsize}")
    differences = np.diff(unsigned, prepend=unsigned.dtype.type(0))
    return differences.view(np.uint8).reshape(-1, values.dtype.itemsize).T.tobytes()
