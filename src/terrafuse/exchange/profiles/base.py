"""How a robot's cells become a few whole numbers, and cells again: what is lost is lost here, where a robot reports.

`cells(numbers(·))` is a projection: doing it twice changes nothing. What a robot reports has gone through it, so that
every replica, its own too, holds the same bytes, and coding the numbers loses nothing more.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from terrafuse.kernels.entropy import ALWAYS, MOST, PLAIN, SIGNED, Plan
from terrafuse.lattice import Lattice
from terrafuse.tile import opaque
from terrafuse.types import Array


@dataclass(frozen=True)
class Quantity:
    """One number of a cell that travels."""

    name: str
    kind: int = PLAIN
    """PLAIN, SIGNED or PREDICTED from neighbours (kernels.entropy)."""
    most: int = MOST
    """The largest number."""
    where: str | None = None
    """It travels only where this quantity before it is not 0."""
    least: int = 0
    """The smallest number; of what is SIGNED -most."""


def _as_they_are(cells: Array, _: Any, __: Lattice) -> Array:
    return cells


@dataclass(frozen=True, eq=False)
class Profile:
    """What of a model's cells travels.

    `numbers`: (K,) known cells → (Q, K) int64, a row for each quantity. `cells`: its inverse, up to the rounding; of
    any numbers within bounds it makes some records, without stamps and revisions. How large errors may be stands in
    docs/delta-format.md.
    """

    quantities: tuple[Quantity, ...]
    numbers: Callable[[Array], Array]
    cells: Callable[[Array], Array]
    before: Callable[[Array, Any, Lattice], Array] = _as_they_are
    """`before(cells, model, lattice)`: what is left out first, by the model's own thresholds."""

    @cached_property
    def plan(self) -> Plan:
        """Its columns: which stamp and revision a cell has, then the quantities."""
        columns = (Quantity("seen"), *self.quantities)
        names = [column.name for column in columns]
        where = [ALWAYS if column.where is None else names.index(column.where) for column in columns]
        kinds = np.array([column.kind for column in columns], np.int64)
        most = np.array([column.most for column in columns], np.int64)
        least = np.array([column.least for column in columns], np.int64)
        return Plan(kinds, np.array(where, np.int64), np.where(kinds == SIGNED, -most, least), most)

    def holds(self, numbers: Array) -> bool:
        """Whether these numbers are within bounds."""
        lowest, highest = (bound[1:, None] for bound in (self.plan.lowest, self.plan.highest))
        return bool(((numbers >= lowest) & (numbers <= highest)).all())

    def report(self, cells: Array, model: Any, lattice: Lattice) -> Array:
        """(K,) cells of a model as a robot that reports by this profile holds them; what is unknown stays so."""
        known = cells["revision"] > 0
        some = np.ascontiguousarray(cells[known])
        rounded = self.cells(self.numbers(self.before(some, model, lattice)))
        rounded["stamp"], rounded["revision"] = some["stamp"], some["revision"]
        out = np.zeros(cells.shape, cells.dtype)
        opaque(out)[known] = opaque(rounded)
        return out


def steps(values: Array, step: float) -> Array:
    """Values in whole steps, the nearest."""
    return np.rint(np.clip(np.asarray(values, np.float64) / step, -MOST, MOST)).astype(np.int64)


# --- whole numbers to so many significant bits ------------------------------------------------------------------------


def level(values: Array, bits: int) -> Array:
    """Whole numbers ≥ 0 → the number of the nearest that has 1 + `bits` significant bits, counted from 0 up."""
    return _level(values, bits, _half)


def level_below(values: Array, bits: int) -> Array:
    """As `level`, the next lower."""
    return _level(values, bits, lambda shift: 0 * shift)


def level_above(values: Array, bits: int) -> Array:
    """As `level`, the next higher."""
    return _level(values, bits, lambda shift: (1 << shift) - 1)


def _half(shift: Array) -> Array:
    return (1 << shift) >> 1


def _level(values: Array, bits: int, rounding: Callable[[Array], Array]) -> Array:
    v = values.astype(np.int64)
    shift = np.maximum(_length(v) - 1 - bits, 0)
    return np.asarray((shift << bits) + ((v + rounding(shift)) >> shift))


def _length(values: Array) -> Array:
    """Bits of whole numbers below 2⁵³."""
    return np.frexp(values.astype(np.float64))[1].astype(np.int64)


def most_level(most: int, bits: int) -> int:
    """The level of the largest number that there is."""
    return int(level_above(np.array([most]), bits)[0])


def at_level(levels: Array, bits: int) -> Array:
    """The number of a level; `level(at_level(n)) == n`."""
    shift = np.maximum((levels >> bits) - 1, 0)
    return np.asarray((levels - (shift << bits)) << shift)
