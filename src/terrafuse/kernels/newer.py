"""Of two states of a cell the one with the newer revision counts."""

from __future__ import annotations

import numpy as np
from numba import njit

from terrafuse.types import Array


@njit(cache=True, nogil=True)
def put_newer(dense, dense_revisions, at, cells, revisions, ties):
    """Put cells[k], bytes (K, S), into dense[at[k]], (T², S), where their revision is newer; at (K,) are distinct.

    Into `ties` goes each k of an equal revision and other bytes; returns how many there are.
    """
    count = 0
    for k in range(at.shape[0]):
        own = dense[at[k]]
        if revisions[k] > dense_revisions[at[k]]:
            for byte in range(own.shape[0]):
                own[byte] = cells[k, byte]
        elif revisions[k] == dense_revisions[at[k]]:
            for byte in range(own.shape[0]):
                if own[byte] != cells[k, byte]:
                    ties[count] = k
                    count += 1
                    break
    return count


def put_newer_reference(dense: Array, dense_revisions: Array, at: Array, cells: Array, revisions: Array) -> Array:
    """What `put_newer` must equal; returns the ties."""
    newer, equal = revisions > dense_revisions[at], revisions == dense_revisions[at]
    ties = np.flatnonzero(equal & (dense[at] != cells).any(axis=1))
    dense[at[newer]] = cells[newer]
    return ties
