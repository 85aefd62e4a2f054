"""What is wrong with the cells of a delta that no mapper made."""

from __future__ import annotations

import numpy as np
from numba import njit

from terrafuse.types import Array

SOUND, POSITIONS, REVISIONS, STAMPS = range(4)


@njit(cache=True, nogil=True)
def flaw_of(starts, at, revisions, stamps, area, newest):
    """The first of POSITIONS, REVISIONS and STAMPS that any cell is wrong in, or SOUND.

    Positions at (K,) rise from 0 to below `area` within each tile, and tiles begin at starts; revisions are 1 to
    `newest`, stamps not negative.
    """
    tile, bad_revision, bad_stamp = 0, False, False
    for k in range(at.shape[0]):
        first = tile < starts.shape[0] and starts[tile] == k
        tile += first
        if at[k] < 0 or at[k] >= area or (not first and at[k] <= at[k - 1]):
            return POSITIONS
        bad_revision |= revisions[k] < 1 or revisions[k] > newest
        bad_stamp |= stamps[k] < 0
    return REVISIONS if bad_revision else STAMPS if bad_stamp else SOUND


@njit(cache=True, nogil=True)
def newest_of(revisions, stamps):
    """The largest revision and the largest stamp; 0 of none."""
    revision, stamp = np.int64(0), np.int64(0)
    for k in range(revisions.shape[0]):
        revision, stamp = max(revision, np.int64(revisions[k])), max(stamp, stamps[k])
    return revision, stamp


@njit(cache=True, nogil=True)
def look_up(which, starts, revisions, stamps, own_revisions, own_stamps, newest):
    """own_revisions[k] = revisions[which[k]], and of stamps likewise; `which` holds indices into the tables.

    newest (T, 2): the largest revision and the largest stamp of tile t, which has cells starts[t]:starts[t + 1].
    """
    for t in range(newest.shape[0]):
        revision, stamp = np.int64(0), np.int64(0)
        for k in range(starts[t], starts[t + 1]):
            own_revisions[k], own_stamps[k] = revisions[which[k]], stamps[which[k]]
            revision, stamp = max(revision, np.int64(revisions[which[k]])), max(stamp, stamps[which[k]])
        newest[t, 0], newest[t, 1] = revision, stamp


def flaw_of_reference(starts: Array, at: Array, revisions: Array, stamps: Array, area: int, newest: int) -> int:
    """What `flaw_of` must equal."""
    steps = np.diff(at.astype(np.int64), prepend=-1)
    steps[starts] = 1
    if at.min() < 0 or at.max() >= area or steps.min() <= 0:
        return POSITIONS
    if revisions.max() > newest or revisions.min() < 1:
        return REVISIONS
    return STAMPS if stamps.min() < 0 else SOUND
