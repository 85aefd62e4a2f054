"""The *patrol* paper's one rule (section 3.4) by which two cells become one.

It serves twice: a robot's own cell takes in a scan's cell (`terrain_merge`), and the global cell takes in the next
robot's (`terrain_fuse`).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from terrafuse.kernels.terrain import (
    COARSE,
    GRADIENT_X,
    GRADIENT_Y,
    GRADIENTS,
    HEIGHT,
    KNOWN,
    MOST_CONFIDENT,
    OCCUPATION,
    PLANE,
    PRIOR,
    SHAPES,
    WALL,
    Rules,
)
from terrafuse.types import Array, Floats

BLEND, SURER, CHANGED, WALLS, GLIMPSE = range(5)
"""Outcomes of the rule: mean of both; the surer of both; the newer of both; two that are one wall; a wall, and loose
points that may well be on it."""
UPRIGHT = HEIGHT | OCCUPATION | WALL
"""What is known of a wall: it has no slope, and is occupied."""

SURE = 3.0
"""What is further off than so many standard errors is not noise."""


@njit(inline="always")
def occupy(cell, max_slope):
    """Set the occupation from the gradients.

    Unknown where a gradient is unknown, or the slope's error so large, that the cell might as well be level or
    impassable; known where it is impassable all the same.
    """
    east, north = np.float64(cell.gradient_x), np.float64(cell.gradient_y)
    slope, doubt = math.sqrt(east * east + north * north), SURE * cell.gradient_error
    told = cell.flags & GRADIENT_X and cell.flags & GRADIENT_Y and doubt <= max_slope
    wall = cell.flags & WALL != 0
    known = told or wall or slope - doubt >= max_slope
    share = 1.0 if wall else min(slope / max_slope, 1.0)
    cell.occupation = np.float32(share if known else 0.0)
    cell.flags = (cell.flags | OCCUPATION) if known else (cell.flags & ~OCCUPATION)


@njit(inline="always")
def similar(a, b, rules):
    """Whether two cells show one surface: near in height, and the angle between their normals small, or no larger than
    the errors of their gradients make it.

    A gradient that one of them does not know can't tell them apart.
    """
    if abs(a.height - b.height) > rules.height_tolerance:
        return False
    both = a.flags & b.flags
    x, y = np.float64(both & GRADIENT_X != 0), np.float64(both & GRADIENT_Y != 0)
    ax, bx, ay, by = x * a.gradient_x, x * b.gradient_x, y * a.gradient_y, y * b.gradient_y
    lengths2 = (1.0 + ax * ax + ay * ay) * (1.0 + bx * bx + by * by)
    if 1.0 + ax * bx + ay * by >= rules.cos_similar * math.sqrt(lengths2):
        return True
    error_a, error_b = np.float64(a.gradient_error), np.float64(b.gradient_error)
    doubt2 = SURE * SURE * (error_a * error_a + error_b * error_b)
    return (ax - bx) * (ax - bx) + (ay - by) * (ay - by) <= doubt2


@njit(inline="always")
def outcome(a, b, confidence_a, confidence_b, rules):
    """What becomes of two cells. What was given, or stands for finer cells, is never part of a wall."""
    if (a.flags | b.flags) & WALL and not (a.flags | b.flags) & (PRIOR | COARSE):
        if a.flags & b.flags & WALL:
            return WALLS
        if not (a.flags | b.flags) & PLANE:
            return GLIMPSE
        if abs(a.height - b.height) <= rules.height_tolerance:
            return WALLS  # and its roof
    if similar(a, b, rules):
        return BLEND
    if abs(confidence_a - confidence_b) > rules.confidence_gap:
        return SURER
    if confidence_a < rules.confidence_high and confidence_b < rules.confidence_high:
        return SURER
    return CHANGED


@njit(inline="always")
def weighted(a, b, weights):
    """The mean of two values by confidence (eq. 11)."""
    total = weights[0] + weights[1]
    return (a * weights[0] + b * weights[1]) / total if total > 0.0 else (a + b) / 2


@njit(inline="always")
def weighted_gradient(a, b, known_a, known_b, weights):
    """The mean of what is known."""
    if known_a and known_b:
        return np.float32(weighted(np.float64(a), np.float64(b), weights))
    return a if known_a else b


@njit(inline="always")
def weighted_error(own, new, weights):
    """The standard error of such a mean of gradients; the larger of both where not each cell knows what either does."""
    error_own, error_new = np.float64(own.gradient_error), np.float64(new.gradient_error)
    if (own.flags ^ new.flags) & GRADIENTS:
        return np.float32(max(error_own, error_new))
    total = weights[0] + weights[1]
    a, b = (weights[0] / total, weights[1] / total) if total > 0.0 else (0.5, 0.5)
    return np.float32(math.sqrt(a * error_own * (a * error_own) + b * error_new * (b * error_new)))


@njit(inline="always")
def blend(own, new, confidence_own, confidence_new, rules):
    """own := the mean of both by confidence; its stamp and revision are the caller's to set."""
    weights = (confidence_own, confidence_new)
    one, other = own.flags, new.flags
    x, y = GRADIENT_X, GRADIENT_Y
    own.gradient_error = weighted_error(own, new, weights)
    own.height = weighted(own.height, new.height, weights)
    own.gradient_x = weighted_gradient(own.gradient_x, new.gradient_x, one & x != 0, other & x != 0, weights)
    own.gradient_y = weighted_gradient(own.gradient_y, new.gradient_y, one & y != 0, other & y != 0, weights)
    own.confidence = min(np.float32(1.0 - (1.0 - confidence_own) * (1.0 - confidence_new)), MOST_CONFIDENT)
    own.rival = np.float32(0.0)
    own.flags = (one | other) & (KNOWN | COARSE | SHAPES) | (one & other & PRIOR)
    if own.flags & COARSE:
        own.occupation = max(own.occupation, new.occupation)
    else:
        occupy(own, rules.max_slope)


@njit(inline="always")
def join_walls(own, new, confidence_own, confidence_new):
    """own := the wall that both are, up to the higher top; its stamp and revision are the caller's to set."""
    own.height = max(own.height, new.height)
    own.gradient_x = own.gradient_y = own.gradient_error = own.rival = np.float32(0.0)
    own.occupation = np.float32(1.0)
    own.confidence = min(np.float32(1.0 - (1.0 - confidence_own) * (1.0 - confidence_new)), MOST_CONFIDENT)
    own.flags = UPRIGHT


@njit(inline="always")
def glimpse(own, new, stamp):
    """own := the wall that one of both is, up to the higher of both. Returns whether anything changed.

    The wall's confidence and stamp stay: loose points might be on something else.
    """
    top = max(own.height, new.height)
    changed = not own.flags & WALL
    if changed:
        take(own, new, stamp)
    changed |= top > own.height
    own.height = top
    return changed


@njit(inline="always")
def take(own, new, stamp):
    """own := what new says of the surface, as of `stamp`."""
    own.stamp = stamp
    own.height = new.height
    own.gradient_x = new.gradient_x
    own.gradient_y = new.gradient_y
    own.gradient_error = new.gradient_error
    own.occupation = new.occupation
    own.confidence = new.confidence
    own.rival = new.rival
    own.flags = new.flags


# --- the same, as slowly as it reads ---------------------------------------------------------------------------------

SURFACE = (
    "stamp", "height", "gradient_x", "gradient_y", "gradient_error", "occupation", "confidence", "rival", "flags",
)  # fmt: skip
"""What `take` takes."""


def occupation_reference(
    east: Floats, north: Floats, error: Floats, both_known: Array, wall: Array, max_slope: float
) -> tuple[Floats, Array]:
    """(occupation, whether it is known): |∇z| / max_slope, at most 1, of a wall 1. One gradient alone tells only that
    it is 1."""
    slope, doubt = np.sqrt(east * east + north * north), SURE * error
    known = (both_known & (doubt <= max_slope)) | (slope - doubt >= max_slope) | wall
    return np.where(wall, 1.0, np.where(known, np.minimum(slope / max_slope, 1.0), 0.0)), known


def similar_reference(a: Array, b: Array, rules: Rules) -> Array:
    """Whether each pair of cells shows one surface."""
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
    errors = np.hypot(a["gradient_error"].astype(np.float64), b["gradient_error"].astype(np.float64))
    apart = np.sqrt(((normals[0] - normals[1]) ** 2).sum(axis=0))
    near = abs(a["height"] - b["height"]) <= rules.height_tolerance
    return np.asarray(near & ((cosine >= rules.cos_similar * lengths) | (apart <= SURE * errors)))


def outcome_reference(a: Array, b: Array, confidence_a: Floats, confidence_b: Floats, rules: Rules) -> Array:
    """What becomes of each pair of cells."""
    either, both = a["flags"] | b["flags"], a["flags"] & b["flags"]
    upright = (either & WALL != 0) & (either & (PRIOR | COARSE) == 0)
    gap = abs(confidence_a - confidence_b) > rules.confidence_gap
    unsure = (confidence_a < rules.confidence_high) & (confidence_b < rules.confidence_high)
    plain = np.where(similar_reference(a, b, rules), BLEND, np.where(gap | unsure, SURER, CHANGED))
    glimpsed = upright & (both & WALL == 0) & (either & PLANE == 0)
    near = abs(a["height"] - b["height"]) <= rules.height_tolerance
    joined = upright & ((both & WALL != 0) | near)
    return np.where(glimpsed, GLIMPSE, np.where(joined, WALLS, plain))


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
    errors = [cells["gradient_error"].astype(np.float64) for cells in (a, b)]
    alike = (a["flags"] ^ b["flags"]) & GRADIENTS == 0
    mean_error = np.hypot(errors[0] * (1 - weight), errors[1] * weight)
    error = np.where(alike, mean_error, np.maximum(*errors)).astype(np.float32)
    out["gradient_error"] = error
    out["confidence"] = np.minimum(1 - (1 - confidence_a) * (1 - confidence_b), MOST_CONFIDENT)
    flags = (a["flags"] | b["flags"]) & (KNOWN | COARSE | SHAPES) | (a["flags"] & b["flags"] & PRIOR)
    east, north = (out[name].astype(np.float64) for name in ("gradient_x", "gradient_y"))
    both_known = flags & GRADIENTS == GRADIENTS
    wall = flags & WALL != 0
    share, known = occupation_reference(east, north, error.astype(np.float64), both_known, wall, rules.max_slope)
    coarse = flags & COARSE != 0
    out["occupation"] = np.where(coarse, np.maximum(a["occupation"], b["occupation"]), share)
    out["flags"] = np.where(coarse, flags, np.where(known, flags | OCCUPATION, flags & ~OCCUPATION))
    out["rival"] = 0.0
    out["stamp"] = np.maximum(a["stamp"], b["stamp"])
    out["revision"] = np.maximum(a["revision"], b["revision"])
    return out


def join_walls_reference(a: Array, b: Array, confidence_a: Floats, confidence_b: Floats) -> Array:
    """Each pair of walls as one; stamps and revisions are the later ones."""
    out = a.copy()
    out["height"] = np.maximum(a["height"], b["height"])
    for name in ("gradient_x", "gradient_y", "gradient_error", "rival"):
        out[name] = 0.0
    out["occupation"], out["flags"] = 1.0, UPRIGHT
    out["confidence"] = np.minimum(1 - (1 - confidence_a) * (1 - confidence_b), MOST_CONFIDENT)
    out["stamp"] = np.maximum(a["stamp"], b["stamp"])
    out["revision"] = np.maximum(a["revision"], b["revision"])
    return out


def glimpse_reference(a: Array, b: Array) -> Array:
    """Of each pair the wall, up to the higher of both."""
    first = a["flags"] & WALL != 0
    out = a.copy()
    for name in SURFACE:
        out[name] = np.where(first, a[name], b[name])
    out["height"] = np.maximum(a["height"], b["height"])
    out["revision"] = np.maximum(a["revision"], b["revision"])
    return out
