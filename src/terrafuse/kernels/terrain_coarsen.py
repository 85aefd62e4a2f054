"""k×k cells → one: the *patrol* paper's way from its high-resolution to its low-resolution map."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from terrafuse.kernels.terrain import (
    CELL,
    COARSE,
    GRADIENT_X,
    GRADIENT_Y,
    HEIGHT,
    OCCUPATION,
    PRIOR,
    Rules,
    aged,
    aged_reference,
    new_memo,
)
from terrafuse.kernels.terrain_fuse import STATICS
from terrafuse.types import Array


@njit(cache=True, nogil=True)
def coarsen(cells, factor, rules, out):
    """cells (H, W) CELL, out (H/k, W/k) CELL of zeros.

    Height and gradients are means by confidence, confidence the mean over all k×k cells with the unknown ones as 0,
    as of the newest stamp. The occupation is the worst of the cells that are sure enough, of all where none is.
    Of what is given, it promises the least that any of its cells does.
    """
    some, memo = np.empty(factor * factor + 1, np.int64), new_memo()
    flat = cells.reshape(-1)
    for j in range(out.shape[0]):
        for i in range(out.shape[1]):
            own, count = out[j, i], list_known(flat, (j * cells.shape[1] + i) * factor, cells.shape[1], factor, some)
            for k in range(count):
                cell = flat[some[k]]
                own.stamp = max(own.stamp, cell.stamp)
                own.revision = max(own.revision, cell.revision)
                own.flags |= cell.flags
                own.gps_quality = least(own.gps_quality, cell.gps_quality)
                own.communications = least(own.communications, cell.communications)
            if own.flags & HEIGHT:
                average(flat, some, count, factor, rules, memo, own)


@njit(inline="always")
def list_known(cells, first, width, factor, some):
    """Write the indices of the known cells of the square from `first` on to `some` (k² + 1,); returns how many."""
    count = 0
    for row in range(factor):
        for column in range(factor):
            some[count] = first + row * width + column
            count += cells[some[count]].flags != 0
    return count


@njit(inline="always")
def least(a, b):
    """The smaller of two that are given; 0 is not given."""
    return b if a == 0 else (a if b == 0 else min(a, b))


@njit(inline="always")
def variance_of_mean(weighed, plain, weight, count):
    """Of a mean of `count` values by weights: weighed = Σ(w·σ)², weight = Σw; of a plain mean where weights are 0."""
    if weight > 0.0:
        return weighed / (weight * weight)
    return plain / (count * count) if count > 0.0 else 0.0


@njit(inline="always")
def average(cells, some, count, factor, rules, memo, own):
    """Fill in the surface of a coarse cell from its known cells, one of which at least knows its height."""
    known = weight = height = weight_x = weight_y = x = y = 0.0
    plain = plain_x = plain_y = 0.0
    known_x = known_y = 0.0
    errors_x = errors_y = plain_errors_x = plain_errors_y = 0.0
    sure, worst = np.float32(-1.0), np.float32(-1.0)
    prior = True
    for k in range(count):
        cell = cells[some[k]]
        if not cell.flags & HEIGHT:
            continue
        confidence = aged(cell, cell.stamp, own.stamp, rules, memo)
        prior &= cell.flags & PRIOR != 0
        known += 1.0
        plain += cell.height
        weight += confidence
        height += confidence * cell.height
        error2 = np.float64(cell.gradient_error) * np.float64(cell.gradient_error)
        if cell.flags & GRADIENT_X:
            known_x += 1.0
            plain_x += cell.gradient_x
            weight_x += confidence
            x += confidence * cell.gradient_x
            errors_x += confidence * confidence * error2
            plain_errors_x += error2
        if cell.flags & GRADIENT_Y:
            known_y += 1.0
            plain_y += cell.gradient_y
            weight_y += confidence
            y += confidence * cell.gradient_y
            errors_y += confidence * confidence * error2
            plain_errors_y += error2
        if cell.flags & OCCUPATION:
            worst = max(worst, cell.occupation)
            if confidence >= rules.coarse_confidence:
                sure = max(sure, cell.occupation)
    own.height = height / weight if weight > 0.0 else plain / known
    if known_x > 0.0:
        own.gradient_x = np.float32(x / weight_x if weight_x > 0.0 else plain_x / known_x)
    if known_y > 0.0:
        own.gradient_y = np.float32(y / weight_y if weight_y > 0.0 else plain_y / known_y)
    variance_x = variance_of_mean(errors_x, plain_errors_x, weight_x, known_x)
    variance_y = variance_of_mean(errors_y, plain_errors_y, weight_y, known_y)
    own.gradient_error = np.float32(math.sqrt(max(variance_x, variance_y)))
    own.confidence = np.float32(weight / (factor * factor))
    own.occupation = max(sure if sure >= 0.0 else worst, np.float32(0.0))
    own.flags &= HEIGHT | GRADIENT_X | GRADIENT_Y | OCCUPATION
    own.flags |= COARSE | (PRIOR if prior else np.uint16(0))


def coarsen_reference(cells: Array, factor: int, rules: Rules) -> Array:
    """What `coarsen` must equal."""
    rows, columns = cells.shape[0] // factor, cells.shape[1] // factor
    squares = cells.reshape(rows, factor, columns, factor).swapaxes(1, 2).reshape(rows, columns, factor**2)
    out = np.zeros((rows, columns), CELL)
    out["stamp"], out["revision"] = squares["stamp"].max(axis=2), squares["revision"].max(axis=2)
    for name in STATICS:
        least_given = np.where(squares[name] > 0, squares[name], 255).min(axis=2)
        out[name] = np.where(least_given < 255, least_given, 0)
    has = squares["flags"] & HEIGHT != 0
    confidence = np.where(has, aged_reference(squares, out["stamp"][..., None], rules), 0.0)
    out["confidence"] = confidence.mean(axis=2)
    flags = np.where(has.any(axis=2), COARSE, np.bitwise_or.reduce(squares["flags"], axis=2))
    given = (~has | (squares["flags"] & PRIOR != 0)).all(axis=2)
    flags |= np.where(given & has.any(axis=2), PRIOR, 0).astype(np.uint16)
    for name, flag in (("height", HEIGHT), ("gradient_x", GRADIENT_X), ("gradient_y", GRADIENT_Y)):
        known = squares["flags"] & flag != 0
        weight = np.where(known, confidence, 0.0)
        weight = np.where(weight.sum(axis=2, keepdims=True) > 0, weight, known)
        total = weight.sum(axis=2)
        out[name] = np.where(total > 0, (weight * squares[name]).sum(axis=2) / np.where(total > 0, total, 1.0), 0.0)
        flags |= np.where(known.any(axis=2), flag, 0).astype(np.uint16)
        if name != "height":
            weighed = np.sqrt(((weight * squares["gradient_error"]) ** 2).sum(axis=2))
            error = np.where(total > 0, weighed / np.where(total > 0, total, 1.0), 0.0)
            out["gradient_error"] = np.maximum(out["gradient_error"], error)
    known = squares["flags"] & OCCUPATION != 0
    sure = known & (confidence >= rules.coarse_confidence)
    counts = np.where(sure.any(axis=2, keepdims=True), sure, known)
    out["occupation"] = np.where(counts, squares["occupation"], 0.0).max(axis=2)
    out["flags"] = flags | np.where(known.any(axis=2), OCCUPATION, 0).astype(np.uint16)
    return out
