"""A robot's own terrain cells take in a scan's: the rule, with memory."""

from __future__ import annotations

import numpy as np
from numba import njit

from terrafuse.kernels.memory import DISTANCE, prefetch_at, record_at
from terrafuse.kernels.terrain import (
    CELL,
    CONTRADICTED,
    HEIGHT,
    HELD,
    RIVAL_WALL,
    WALL,
    Rules,
    aged,
    aged_reference,
    new_memo,
)
from terrafuse.kernels.terrain_rule import (
    BLEND,
    CHANGED,
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
from terrafuse.types import Array, Stamp


@njit(inline="always")
def look(own, new, stamp, rules, memo):
    """A robot's own known cell takes in what it sees of it at `stamp`. Returns whether the cell changed.

    What is HELD is replaced only by a look that is surer by far, or by two in a row that found the same height; and two
    such sure looks always replace; two walls agree whatever their tops. By the rule alone, scans that disagree would
    replace each other for ever, and a change under a surface that was looked at often enough would stay unseen until
    that had aged.
    """
    later = max(own.stamp, stamp)
    confidence_own = aged(own, own.stamp, later, rules, memo)
    confidence_new = aged(new, stamp, later, rules, memo)
    verdict = outcome(own, new, confidence_own, confidence_new, rules)
    if verdict == BLEND:
        blend(own, new, confidence_own, confidence_new, rules)
        own.flags |= HELD
        own.stamp = later
        return True
    if verdict == WALLS:
        join_walls(own, new, confidence_own, confidence_new)
        own.flags |= HELD
        own.stamp = later
        return True
    if verdict == GLIMPSE:
        return glimpse(own, new, stamp)
    wins = confidence_new > confidence_own or verdict == CHANGED
    if stamp < own.stamp:
        replaced = verdict == SURER and wins
    else:
        wins |= confidence_new == confidence_own
        close = abs(confidence_own - confidence_new) <= rules.confidence_gap
        replaced = wins and not (close and own.flags & HELD)
        wall = new.flags & WALL != 0
        # A wall is a line in its cell, which fills few sub-cells of it.
        least = rules.coarse_confidence if wall else rules.confidence_high
        if (wins or confidence_new >= least) and not replaced:
            near = abs(new.height - own.rival) <= rules.height_tolerance or (wall and own.flags & RIVAL_WALL != 0)
            replaced = own.flags & CONTRADICTED != 0 and near
            if not replaced:
                # And no more: nobody saw this surface at `stamp`.
                own.flags = (own.flags & ~RIVAL_WALL) | CONTRADICTED | (RIVAL_WALL if wall else np.uint16(0))
                own.rival = np.float32(new.height)
                return True
    if replaced:
        take(own, new, stamp)
        own.flags |= HELD
    return replaced


_CELLS = np.empty(0, CELL)
CELL_BYTES = CELL.itemsize


@njit(cache=True, nogil=True)
def merge(tiles, tile_of, at, patch, stamp, revision, rules):
    """A robot's tiles ← a scan's patch.

    tiles (T,) int64 addresses of the tiles' (T²,) CELL; patch (K,) CELL, of which record k belongs to position at[k] of
    tile tile_of[k], each once.
    """
    memo = new_memo()
    last = at.shape[0] - 1
    for k in range(at.shape[0]):
        ahead = min(k + DISTANCE, last)
        prefetch_at(tiles[tile_of[ahead]] + np.int64(at[ahead]) * CELL_BYTES)
        own, new = record_at(_CELLS, tiles[tile_of[k]] + np.int64(at[k]) * CELL_BYTES), patch[k]
        if own.flags & HEIGHT:
            if not look(own, new, stamp, rules, memo):
                continue
        else:
            take(own, new, stamp)
        own.revision = np.uint32(revision)


def merge_reference(own: Array, new: Array, stamp: Stamp, revision: int, rules: Rules) -> Array:
    """What `merge` must make of (K,) own cells and the scan's cells of the same places."""
    new = new.copy()
    new["stamp"], new["revision"] = stamp, revision
    later = np.maximum(own["stamp"], stamp)
    confidence_own, confidence_new = aged_reference(own, later, rules), aged_reference(new, later, rules)
    verdict = outcome_reference(own, new, confidence_own, confidence_new, rules)
    held = own["flags"] & HELD != 0
    wall = new["flags"] & WALL != 0
    agrees = (abs(new["height"] - own["rival"]) <= rules.height_tolerance) | (wall & (own["flags"] & RIVAL_WALL != 0))
    again = (own["flags"] & CONTRADICTED != 0) & agrees
    late = stamp < own["stamp"]
    joined, glimpsed = verdict == WALLS, verdict == GLIMPSE
    blended = (verdict == BLEND) | joined
    wins = (confidence_new > confidence_own) | (verdict == CHANGED) | (~late & (confidence_new == confidence_own))
    close = abs(confidence_own - confidence_new) <= rules.confidence_gap
    at_once = np.where(late, (verdict == SURER) & wins, wins & ~(close & held))
    least = np.where(wall, rules.coarse_confidence, rules.confidence_high)
    counts = ~late & ~blended & ~glimpsed & (wins | (confidence_new >= least))
    replaced = ~blended & ~glimpsed & (at_once | (counts & again))
    marked = counts & ~replaced
    mean = blend_reference(own, new, confidence_own, confidence_new, rules)
    mean[joined] = join_walls_reference(own, new, confidence_own, confidence_new)[joined]
    mean["flags"] |= HELD
    out = own.copy()
    seen = glimpse_reference(own, new)
    out[glimpsed] = seen[glimpsed]
    out["revision"] = np.where(glimpsed & (out["height"] == own["height"]) & (own["flags"] & WALL != 0),
                               own["revision"], np.where(glimpsed, revision, out["revision"]))  # fmt: skip
    unknown = own["flags"] & HEIGHT == 0
    for name in (*SURFACE, "revision"):
        after = np.where(blended, mean[name], np.where(replaced, new[name], out[name]))
        out[name] = np.where(unknown, new[name], after)
    out["flags"][replaced & ~unknown] |= HELD
    marked &= ~unknown
    out["flags"][marked] = (out["flags"][marked] & ~RIVAL_WALL) | CONTRADICTED
    out["flags"][marked & wall] |= RIVAL_WALL
    out["rival"][marked] = new["height"][marked]
    out["revision"][(marked | blended) & ~unknown] = revision
    return out
