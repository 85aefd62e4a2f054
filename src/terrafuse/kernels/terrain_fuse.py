"""The global terrain cell takes in the next robot's: the rule, to the letter."""

from __future__ import annotations

import numpy as np
from numba import njit

from terrafuse.kernels.terrain import HEIGHT, Rules, aged, aged_reference, new_memo
from terrafuse.kernels.terrain_rule import (
    BLEND,
    GLIMPSE,
    SURER,
    SURFACE,
    WALLS,
    blend,
    blend_reference,
    glimpse,
    glimpse_reference,
    join_walls,
    join_walls_reference,
    outcome,
    outcome_reference,
    take,
)
from terrafuse.types import Array

STATICS = ("gps_quality", "communications")


@njit(nogil=True)
def comes_after(new, own, new_bytes, own_bytes):
    """Whether `new` is the later of two cells: by stamps; of equal ones by confidence, then by the records' bytes, so
    that it is the same whichever comes first."""
    if new.stamp != own.stamp:
        return new.stamp > own.stamp
    if new.confidence != own.confidence:
        return new.confidence > own.confidence
    for k in range(new_bytes.shape[0]):
        if new_bytes[k] != own_bytes[k]:
            return new_bytes[k] > own_bytes[k]
    return False


@njit(inline="always")
def meet(own, new, newer, rules, memo):
    """The global cell takes in another robot's; both know the height."""
    later = max(own.stamp, new.stamp)
    confidence_own = aged(own, own.stamp, later, rules, memo)
    confidence_new = aged(new, new.stamp, later, rules, memo)
    verdict = outcome(own, new, confidence_own, confidence_new, rules)
    if verdict == BLEND:
        blend(own, new, confidence_own, confidence_new, rules)
        own.stamp = later
        return
    if verdict == WALLS:
        join_walls(own, new, confidence_own, confidence_new)
        own.stamp = later
        return
    if verdict == GLIMPSE:
        glimpse(own, new, new.stamp)
        return
    surer = confidence_new > confidence_own or (newer and confidence_new == confidence_own)
    if surer if verdict == SURER else newer:
        take(own, new, new.stamp)


@njit(cache=True, nogil=True)
def _fuse(own_cells, new_cells, own_bytes, new_bytes, rules):
    memo = new_memo()
    for k in range(own_cells.shape[0]):
        own, new = own_cells[k], new_cells[k]
        if new.flags == 0:
            continue
        newer = comes_after(new, own, new_bytes[k], own_bytes[k])
        if own.flags & HEIGHT and new.flags & HEIGHT:
            meet(own, new, newer, rules, memo)
        elif new.flags & HEIGHT:
            take(own, new, new.stamp)
        elif not own.flags & HEIGHT:
            take(own, new, max(own.stamp, new.stamp))
        if new.gps_quality > 0 and (newer or own.gps_quality == 0):
            own.gps_quality = new.gps_quality
        if new.communications > 0 and (newer or own.communications == 0):
            own.communications = new.communications
        own.revision = max(own.revision, new.revision)


def fuse(own: Array, new: Array, rules: Rules) -> None:
    """The next step of the fold, in place: own[k] takes new[k] in. Both (M,) CELL, contiguous."""
    own_bytes, new_bytes = (cells.view(np.uint8).reshape(-1, cells.itemsize) for cells in (own, new))
    _fuse(own, new, own_bytes, new_bytes, rules)


def comes_after_reference(new: Array, own: Array) -> Array:
    """Whether each new cell is the later one."""
    alike = new["stamp"] == own["stamp"]
    later: Array = (new["stamp"] > own["stamp"]) | (alike & (new["confidence"] > own["confidence"]))
    for k in np.flatnonzero(alike & (new["confidence"] == own["confidence"]) & (new["flags"] > 0)):
        later[k] = new[k].tobytes() > own[k].tobytes()
    return later


def fuse_reference(own: Array, new: Array, rules: Rules) -> Array:
    """What `fuse` must equal: (M,) CELL of what became of each pair."""
    later = np.maximum(own["stamp"], new["stamp"])
    confidence_own, confidence_new = aged_reference(own, later, rules), aged_reference(new, later, rules)
    verdict = outcome_reference(own, new, confidence_own, confidence_new, rules)
    newer = comes_after_reference(new, own)
    surer = (confidence_new > confidence_own) | (newer & (confidence_new == confidence_own))
    has_own, has_new = own["flags"] & HEIGHT != 0, new["flags"] & HEIGHT != 0
    choose_new = np.where(has_own & has_new, np.where(verdict == SURER, surer, newer), new["flags"] != 0)
    out = own.copy()
    mean = blend_reference(own, new, confidence_own, confidence_new, rules)
    joined = has_own & has_new & (verdict == WALLS)
    mean[joined] = join_walls_reference(own, new, confidence_own, confidence_new)[joined]
    glimpsed = has_own & has_new & (verdict == GLIMPSE)
    mean[glimpsed] = glimpse_reference(own, new)[glimpsed]
    blended = has_own & has_new & ((verdict == BLEND) | joined | glimpsed)
    chosen = choose_new & (has_new | ~has_own)
    for name in SURFACE:
        out[name] = np.where(blended, mean[name], np.where(chosen, new[name], own[name]))
    out["stamp"] = np.where(~has_own & ~has_new, later, out["stamp"])
    for name in STATICS:
        out[name] = np.where((new[name] > 0) & (newer | (own[name] == 0)), new[name], own[name])
    out["revision"] = np.maximum(own["revision"], new["revision"])
    return out
