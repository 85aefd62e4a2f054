"""The *patrol* paper's cell, and its one rule (section 3.4) by which two cells become one.

The rule serves twice: a robot's own cell takes in a scan's cell, and the global cell takes in the next robot's. What
one has seen before, it trusts less the older it is: confidence halves every half-life, worked out when two cells meet.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from terrafuse.kernels.memory import DISTANCE, prefetch_at, record_at
from terrafuse.types import Array, Floats, Stamp

CELL = np.dtype(
    [
        ("stamp", "<i8"),
        ("height", "<f8"),
        ("gradient_x", "<f4"),
        ("gradient_y", "<f4"),
        ("occupation", "<f4"),
        ("confidence", "<f4"),
        ("revision", "<u4"),
        ("flags", "<u2"),
        ("gps_quality", "u1"),
        ("communications", "u1"),
    ]
)
"""40 bytes without a gap. A quantity that its flag does not call known is 0. `confidence` counts from 0 to 1, as it was
at `stamp`. `gps_quality` and `communications` are stored as value + 1; 0: not given."""

HEIGHT, GRADIENT_X, GRADIENT_Y, OCCUPATION = (np.uint16(1 << bit) for bit in range(4))
"""Flags: which quantities are known. A cell of which nothing but static layers is known has PRIOR alone."""
PRIOR = np.uint16(1 << 4)
"""It was not measured but given, and does not age."""
COARSE = np.uint16(1 << 5)
"""It stands for several finer cells, and its occupation is the worst of theirs."""
HELD = np.uint16(1 << 6)
"""It was seen alike twice, or has replaced another: one look does not replace it."""
CONTRADICTED = np.uint16(1 << 7)
"""The last look that counted contradicted it: another one replaces it."""

KNOWN = HEIGHT | GRADIENT_X | GRADIENT_Y | OCCUPATION
LOOKS = HELD | CONTRADICTED
FLAGS = KNOWN | PRIOR | COARSE | LOOKS
FLAG_OF = {"height": HEIGHT, "gradient_x": GRADIENT_X, "gradient_y": GRADIENT_Y, "occupation": OCCUPATION}

MOST_CONFIDENT = np.float32(254 / 255)
"""Certainty is never reached: from 1, confidence would not change any more."""

BLEND, SURER, CHANGED = range(3)
"""Outcomes of the rule: mean of both; the surer of both; the newer of both."""


class Rules(NamedTuple):
    """The thresholds."""

    cos_similar: float
    """Cosine of the largest angle between similar cells' normals."""
    height_tolerance: float
    """metres"""
    confidence_gap: float
    confidence_high: float
    half_lives_per_ns: float
    """0: nothing ages."""
    max_slope: float
    coarse_confidence: float
    """The least with which a fine cell counts for a coarse one's occupation."""


_POWERS = tuple((-math.log(2.0)) ** k / math.factorial(k) for k in range(17))


@njit(nogil=True)
def half_power(x):
    """2⁻ˣ for x ≥ 0, of sums and products only: the same bits on every machine, which the C library's is not."""
    whole = math.floor(x)
    if whole > 1000.0:
        return 0.0
    share = x - whole
    power = 0.0
    for k in range(len(_POWERS) - 1, -1, -1):
        power = power * share + _POWERS[k]
    return math.ldexp(power, -int(whole))


@njit(inline="always")
def new_memo():
    """What `aged` remembers: an age in half-lives and what it leaves. Cells of one map share few ages."""
    return np.array([0.0, 1.0])


@njit(inline="always")
def aged(cell, stamp, later, rules, memo):
    """The confidence that a cell of this stamp has left at `later`."""
    if cell.flags & PRIOR or later <= stamp:
        return np.float64(cell.confidence)
    half_lives = (later - stamp) * rules.half_lives_per_ns
    if half_lives != memo[0]:
        memo[0], memo[1] = half_lives, half_power(half_lives)
    return cell.confidence * memo[1]


@njit(cache=True, nogil=True)
def aged_at(cells, later, rules):
    """(M,) float64: the confidence that each of (M,) CELL has left at `later`."""
    memo, out = new_memo(), np.empty(cells.shape[0])
    for k in range(cells.shape[0]):
        out[k] = aged(cells[k], cells[k].stamp, later, rules, memo)
    return out


@njit(inline="always")
def occupy(cell, max_slope):
    """Set the occupation from the gradients. Unknown where one is unknown that could still make a difference."""
    east, north = np.float64(cell.gradient_x), np.float64(cell.gradient_y)
    share = min(math.sqrt(east * east + north * north) / max_slope, 1.0)
    known = (cell.flags & GRADIENT_X and cell.flags & GRADIENT_Y) or share >= 1.0
    cell.occupation = np.float32(share if known else 0.0)
    cell.flags = (cell.flags | OCCUPATION) if known else (cell.flags & ~OCCUPATION)


@njit(inline="always")
def similar(a, b, rules):
    """Whether two cells show one surface: near in height, and the angle between their normals small.

    A gradient that one of them does not know can't tell them apart.
    """
    if abs(a.height - b.height) > rules.height_tolerance:
        return False
    both = a.flags & b.flags
    x, y = np.float64(both & GRADIENT_X != 0), np.float64(both & GRADIENT_Y != 0)
    ax, bx, ay, by = x * a.gradient_x, x * b.gradient_x, y * a.gradient_y, y * b.gradient_y
    lengths2 = (1.0 + ax * ax + ay * ay) * (1.0 + bx * bx + by * by)
    return 1.0 + ax * bx + ay * by >= rules.cos_similar * math.sqrt(lengths2)


@njit(inline="always")
def outcome(a, b, confidence_a, confidence_b, rules):
    """What becomes of two cells: BLEND, SURER or CHANGED."""
    if similar(a, b, rules):
        return BLEND
    if abs(confidence_a - confidence_b) > rules.confidence_gap:
        return SURER
    if confidence_a < rules.confidence_high and confidence_b < rules.confidence_high:
        return SURER
    return CHANGED


@njit(inline="always")
def weighted(a, b, known_a, known_b, weight_a, weight_b):
    """The mean of what is known, by confidence (eq. 11)."""
    if known_a and known_b:
        total = weight_a + weight_b
        return (a * weight_a + b * weight_b) / total if total > 0.0 else (a + b) / 2
    return a if known_a else b


@njit(inline="always")
def blend(own, new, confidence_own, confidence_new, rules):
    """own := the mean of both by confidence; its stamp and revision are the caller's to set."""
    own_flags, new_flags = own.flags, new.flags
    own.height = weighted(own.height, new.height, True, True, confidence_own, confidence_new)
    own.gradient_x = np.float32(
        weighted(
            np.float64(own.gradient_x),
            np.float64(new.gradient_x),
            own_flags & GRADIENT_X != 0,
            new_flags & GRADIENT_X != 0,
            confidence_own,
            confidence_new,
        )
    )
    own.gradient_y = np.float32(
        weighted(
            np.float64(own.gradient_y),
            np.float64(new.gradient_y),
            own_flags & GRADIENT_Y != 0,
            new_flags & GRADIENT_Y != 0,
            confidence_own,
            confidence_new,
        )
    )
    own.confidence = min(np.float32(1.0 - (1.0 - confidence_own) * (1.0 - confidence_new)), MOST_CONFIDENT)
    own.flags = (own_flags | new_flags) & (KNOWN | COARSE) | (own_flags & new_flags & PRIOR)
    if own.flags & COARSE:
        own.occupation = max(own.occupation, new.occupation)
    else:
        occupy(own, rules.max_slope)


@njit(inline="always")
def take(own, new, stamp):
    """own := what new says of the surface, as of `stamp`."""
    own.stamp = stamp
    own.height = new.height
    own.gradient_x = new.gradient_x
    own.gradient_y = new.gradient_y
    own.occupation = new.occupation
    own.confidence = new.confidence
    own.flags = new.flags


@njit(inline="always")
def look(own, new, stamp, rules, memo):
    """A robot's own known cell takes in what it sees of it at `stamp`. Returns whether the cell changed.

    The rule, with memory: what is HELD is replaced only by a look that is surer by far, or by two in a row; and two
    sure looks in a row always replace. By the rule alone, two scans that disagree would replace each other for ever,
    and a change under a surface that was looked at often enough would stay unseen until that had aged.
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
    wins = confidence_new > confidence_own or verdict == CHANGED
    if stamp < own.stamp:
        replaced = verdict == SURER and wins
    else:
        wins |= confidence_new == confidence_own
        close = abs(confidence_own - confidence_new) <= rules.confidence_gap
        replaced = wins and not (close and own.flags & HELD)
        if (wins or confidence_new >= rules.confidence_high) and not replaced:
            replaced = own.flags & CONTRADICTED != 0
            if not replaced:
                own.flags |= CONTRADICTED  # and no more: nobody saw this surface at `stamp`
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


@njit(inline="always")
def meet(own, new, rules, memo):
    """The global cell takes in another robot's; both know the height. Which is newer, the stamps say."""
    later = max(own.stamp, new.stamp)
    confidence_own = aged(own, own.stamp, later, rules, memo)
    confidence_new = aged(new, new.stamp, later, rules, memo)
    verdict = outcome(own, new, confidence_own, confidence_new, rules)
    if verdict == BLEND:
        blend(own, new, confidence_own, confidence_new, rules)
        own.stamp = later
        return
    newer = new.stamp >= own.stamp
    surer = confidence_new > confidence_own or (newer and confidence_new == confidence_own)
    if surer if verdict == SURER else newer:
        take(own, new, new.stamp)


@njit(cache=True, nogil=True)
def fuse(own_cells, new_cells, rules):
    """The next step of the fold, in place: own_cells[k] takes new_cells[k] in. Both (M,) CELL."""
    memo = new_memo()
    for k in range(own_cells.shape[0]):
        own, new = own_cells[k], new_cells[k]
        if new.flags == 0:
            continue
        newer = new.stamp >= own.stamp
        if own.flags & HEIGHT and new.flags & HEIGHT:
            meet(own, new, rules, memo)
        elif new.flags & HEIGHT:
            take(own, new, new.stamp)
        elif not own.flags & HEIGHT:
            take(own, new, max(own.stamp, new.stamp))
        if new.gps_quality > 0 and (newer or own.gps_quality == 0):
            own.gps_quality = new.gps_quality
        if new.communications > 0 and (newer or own.communications == 0):
            own.communications = new.communications
        own.revision = max(own.revision, new.revision)


# --- the same, as slowly as it reads ---------------------------------------------------------------------------------


def aged_reference(cells: Array, later: Array | Stamp, rules: Rules) -> Floats:
    """c · 2^(-Δt / half-life), but for what is given and what is not older."""
    half_lives = np.maximum(np.subtract(later, cells["stamp"]), 0) * rules.half_lives_per_ns
    confidence = cells["confidence"].astype(np.float64)
    return np.where(cells["flags"] & PRIOR, confidence, confidence * np.exp2(-half_lives))


def occupation_reference(east: Floats, north: Floats, both_known: Array, max_slope: float) -> tuple[Floats, Array]:
    """(occupation, whether it is known): |∇z| / max_slope, at most 1. One gradient alone tells only that it is 1."""
    share = np.minimum(np.sqrt(east * east + north * north) / max_slope, 1.0)
    known = both_known | (share >= 1.0)
    return np.where(known, share, 0.0), known


def outcome_reference(a: Array, b: Array, confidence_a: Floats, confidence_b: Floats, rules: Rules) -> Array:
    """BLEND, SURER or CHANGED of each pair of cells."""
    both = a["flags"] & b["flags"]
    normals = [
        np.stack(
            [
                np.where(both & GRADIENT_X, cells["gradient_x"].astype(np.float64), 0.0),
                np.where(both & GRADIENT_Y, cells["gradient_y"].astype(np.float64), 0.0),
                np.ones(len(cells)),
            ]
        )
        for cells in (a, b)
    ]
    cosine = (normals[0] * normals[1]).sum(axis=0)
    lengths = np.sqrt((normals[0] ** 2).sum(axis=0) * (normals[1] ** 2).sum(axis=0))
    near = abs(a["height"] - b["height"]) <= rules.height_tolerance
    gap = abs(confidence_a - confidence_b) > rules.confidence_gap
    unsure = (confidence_a < rules.confidence_high) & (confidence_b < rules.confidence_high)
    return np.where(near & (cosine >= rules.cos_similar * lengths), BLEND, np.where(gap | unsure, SURER, CHANGED))


def blend_reference(a: Array, b: Array, confidence_a: Floats, confidence_b: Floats, rules: Rules) -> Array:
    """The mean of each pair of cells by confidence (eq. 11); stamps and revisions are the later ones."""
    out = a.copy()
    total = confidence_a + confidence_b
    weight = np.where(total > 0, confidence_b / np.where(total > 0, total, 1.0), 0.5)
    out["height"] = a["height"] * (1 - weight) + b["height"] * weight
    for name, flag in (("gradient_x", GRADIENT_X), ("gradient_y", GRADIENT_Y)):
        mean = a[name] * (1 - weight) + b[name] * weight
        in_a, in_b = a["flags"] & flag != 0, b["flags"] & flag != 0
        out[name] = np.where(in_a & in_b, mean, np.where(in_a, a[name], b[name]))
    out["confidence"] = np.minimum(1 - (1 - confidence_a) * (1 - confidence_b), MOST_CONFIDENT)
    flags = (a["flags"] | b["flags"]) & (KNOWN | COARSE) | (a["flags"] & b["flags"] & PRIOR)
    both = GRADIENT_X | GRADIENT_Y
    east, north = (out[name].astype(np.float64) for name in ("gradient_x", "gradient_y"))
    share, known = occupation_reference(east, north, flags & both == both, rules.max_slope)
    coarse = flags & COARSE != 0
    out["occupation"] = np.where(coarse, np.maximum(a["occupation"], b["occupation"]), share)
    out["flags"] = np.where(coarse, flags, np.where(known, flags | OCCUPATION, flags & ~OCCUPATION))
    out["stamp"] = np.maximum(a["stamp"], b["stamp"])
    out["revision"] = np.maximum(a["revision"], b["revision"])
    return out


SURFACE = ("stamp", "height", "gradient_x", "gradient_y", "occupation", "confidence", "flags")


def fuse_reference(own: Array, new: Array, rules: Rules) -> Array:
    """What `fuse` must equal: (M,) CELL of what became of each pair."""
    later = np.maximum(own["stamp"], new["stamp"])
    confidence_own, confidence_new = aged_reference(own, later, rules), aged_reference(new, later, rules)
    verdict = outcome_reference(own, new, confidence_own, confidence_new, rules)
    newer = new["stamp"] >= own["stamp"]
    surer = (confidence_new > confidence_own) | (newer & (confidence_new == confidence_own))
    has_own, has_new = own["flags"] & HEIGHT != 0, new["flags"] & HEIGHT != 0
    choose_new = np.where(has_own & has_new, np.where(verdict == SURER, surer, newer), new["flags"] != 0)
    out = own.copy()
    mean = blend_reference(own, new, confidence_own, confidence_new, rules)
    blended = has_own & has_new & (verdict == BLEND)
    chosen = choose_new & (has_new | ~has_own)
    for name in SURFACE:
        out[name] = np.where(blended, mean[name], np.where(chosen, new[name], own[name]))
    neither = ~has_own & ~has_new
    out["stamp"] = np.where(neither, later, out["stamp"])
    for name in ("gps_quality", "communications"):
        out[name] = np.where((new[name] > 0) & (newer | (own[name] == 0)), new[name], own[name])
    out["revision"] = np.maximum(own["revision"], new["revision"])
    return out


def merge_reference(own: Array, new: Array, stamp: Stamp, revision: int, rules: Rules) -> Array:
    """What `merge` must make of (K,) own cells and the scan's cells of the same places."""
    new = new.copy()
    new["stamp"], new["revision"] = stamp, revision
    later = np.maximum(own["stamp"], stamp)
    confidence_own, confidence_new = aged_reference(own, later, rules), aged_reference(new, later, rules)
    verdict = outcome_reference(own, new, confidence_own, confidence_new, rules)
    held, contradicted = (own["flags"] & flag != 0 for flag in (HELD, CONTRADICTED))
    late = stamp < own["stamp"]
    blended = verdict == BLEND
    wins = (confidence_new > confidence_own) | (verdict == CHANGED) | (~late & (confidence_new == confidence_own))
    close = abs(confidence_own - confidence_new) <= rules.confidence_gap
    at_once = np.where(late, (verdict == SURER) & wins, wins & ~(close & held))
    counts = ~late & ~blended & (wins | (confidence_new >= rules.confidence_high))
    replaced = ~blended & (at_once | (counts & contradicted))
    marked = counts & ~replaced
    mean = blend_reference(own, new, confidence_own, confidence_new, rules)
    mean["flags"] |= HELD
    out = own.copy()
    unknown = own["flags"] & HEIGHT == 0
    for name in (*SURFACE, "revision"):
        after = np.where(blended, mean[name], np.where(replaced, new[name], own[name]))
        out[name] = np.where(unknown, new[name], after)
    out["flags"][replaced & ~unknown] |= HELD
    marked &= ~unknown
    out["flags"][marked] |= CONTRADICTED
    out["revision"][(marked | blended) & ~unknown] = revision
    return out
