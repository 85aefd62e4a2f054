"""The figures of merit: pure functions of cells that lie upon each other."""

from __future__ import annotations

from typing import Any

import numpy as np

from terrafuse.types import Array, Floats

KINDS = ("free", "occupied", "unknown")
FREE, OCCUPIED, UNKNOWN = range(3)


def value_figures(differences: Floats) -> dict[str, float]:
    """Of A − B (K,), at least one: root mean square, mean, and of the distances the median, 95 % and the largest."""
    distances = np.abs(differences)
    return {
        "rmse": float(np.sqrt(np.mean(differences**2))),
        "bias": float(np.mean(differences)),
        "median_abs": float(np.median(distances)),
        "p95_abs": float(np.quantile(distances, 0.95)),
        "max_abs": float(distances.max()),
    }


def coverage(a: int, b: int, both: int, looked_at: int) -> dict[str, Any]:
    """Of how many cells are known in A, in B, in both, of all that were looked at. None is a share of nothing.

    Completeness of A: the share of what B knows that A knows, too. Overlap: both of either.
    """
    return {
        "cells": {"looked_at": looked_at, "a": a, "b": b, "both": both},
        "completeness_a": share(both, b),
        "completeness_b": share(both, a),
        "overlap": share(both, a + b - both),
    }


def kinds(probability: Floats, occupied_thresh: float, free_thresh: float) -> Array:
    """FREE, OCCUPIED or UNKNOWN, (…) int8; between the thresholds, and where NaN, is UNKNOWN."""
    sure = np.where(probability <= free_thresh, FREE, UNKNOWN)
    return np.where(probability >= occupied_thresh, OCCUPIED, sure).astype(np.int8)


def counts(a: Array, b: Array) -> Array:
    """(3, 3) cells of each kind in A (rows) and in B (columns)."""
    return np.bincount(3 * a.reshape(-1).astype(np.int64) + b.reshape(-1), minlength=9).reshape(3, 3)


def occupancy_figures(table: Array) -> dict[str, Any]:
    """Of a table of `counts`: the table by name, and the shares of cells, known in both, on which A and B agree; of
    all of them, and of those that one of the two calls occupied or free."""
    sure = table[:UNKNOWN, :UNKNOWN]
    of_a, of_b = sure.sum(axis=1), sure.sum(axis=0)
    return {
        "table": {KINDS[k]: {KINDS[m]: int(table[k, m]) for m in range(3)} for k in range(3)},
        "agreement": share(int(np.trace(sure)), int(sure.sum())),
        "agreement_occupied_a": share(int(sure[OCCUPIED, OCCUPIED]), int(of_a[OCCUPIED])),
        "agreement_occupied_b": share(int(sure[OCCUPIED, OCCUPIED]), int(of_b[OCCUPIED])),
        "agreement_free_a": share(int(sure[FREE, FREE]), int(of_a[FREE])),
        "agreement_free_b": share(int(sure[FREE, FREE]), int(of_b[FREE])),
    }


def share(part: int, whole: int) -> float | None:
    return part / whole if whole else None
