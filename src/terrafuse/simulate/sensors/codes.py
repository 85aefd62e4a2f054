"""Pulses keyed by a code, and what a correlator makes of them (*grey*, section 4).

A ping is eight chips of ±1; robots' codes are rows of a Walsh–Hadamard matrix. A code s that arrives δ chips after the
receiver's clock began gives a receiver with the code c, at the lag m, R(m - δ), with R(x) = 1/8 Σₙ c[n] s[n + x] over
the chips that overlap; between whole shifts a chip is partly on either side, so R is straight there. R(0) is 1 for
one's own code and 0 for every other row: codes are orthogonal *when aligned*. At other shifts |R| reaches 7/8.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from terrafuse.errors import InputError
from terrafuse.types import Array, Floats

CHIPS = 8
CHIP_S = 25e-6
"""One period of 40 kHz, the paper's pulse."""
SOUND_M_S = 343.0


def walsh_hadamard(order: int = CHIPS) -> Array:
    """(order, order) int8 of ±1 with orthogonal rows, by Sylvester: [[H, H], [H, -H]]. `order` is a power of 2."""
    if order < 1 or order & (order - 1):
        raise InputError(f"{order} chips: give a power of 2")
    rows = np.ones((1, 1), np.int8)
    while len(rows) < order:
        rows = np.block([[rows, rows], [rows, -rows]])
    return rows


@dataclass(frozen=True, eq=False)
class Arrivals:
    """Pings that reach a receiver: `codes` (K, 8) of ±1, `delays_chips` (K,) from the receiver's own ping to the first
    chip, whole or not, and `strengths` (K,), 1 for what an own echo has."""

    codes: Array
    delays_chips: Floats
    strengths: Floats

    def __post_init__(self) -> None:
        count = len(self.delays_chips)
        if self.codes.shape != (count, CHIPS) or self.strengths.shape != (count,):
            raise InputError(
                f"{count} delays with codes of shape {self.codes.shape} and strengths of shape {self.strengths.shape}: "
                f"give (K, {CHIPS}) and (K,)"
            )


def arrivals(codes: Array, delays_chips: Floats) -> Arrivals:
    """Arrivals as strong as an own echo."""
    delays = np.asarray(delays_chips, np.float64)
    return Arrivals(np.asarray(codes), delays, np.ones(len(delays)))


def overlap_sums(own_code: Array, code: Array) -> Floats:
    """(17,): R at the whole shifts -8 … 8."""
    # np.correlate(s, c) gives Σ s[n + k] c[n], for k = -7 … 7; at ±8 nothing overlaps.
    return np.pad(np.correlate(np.asarray(code, float), np.asarray(own_code, float), "full") / CHIPS, 1)


def correlations(own_code: Array, heard: Arrivals, lags_chips: Floats) -> Floats:
    """(K, len(lags)): what each arrival alone gives the correlator at each lag; they add up."""
    shifts = np.asarray(lags_chips)[None, :] - heard.delays_chips[:, None]
    whole = np.arange(-CHIPS, CHIPS + 1)
    rows = [np.interp(x, whole, overlap_sums(own_code, code)) for x, code in zip(shifts, heard.codes, strict=True)]
    return np.array(rows).reshape(shifts.shape) * heard.strengths[:, None]


Receiver = Callable[[Array, Arrivals], Floats]
"""(own code, arrivals) → (K,): the most that each arrival alone gives it, 1 for an own echo."""


def _uncoded(own_code: Array, heard: Arrivals) -> Floats:
    """Listens for sound, whosever it is."""
    return np.asarray(abs(heard.strengths))


def _in_slots(own_code: Array, heard: Arrivals) -> Floats:
    """Looks once every eight chips, from its own ping on: what CDMA among synchronous stations does."""
    return _most(own_code, heard, float(CHIPS))


def _sliding(own_code: Array, heard: Arrivals) -> Floats:
    """Looks at every quarter of a chip: it finds an echo wherever it is."""
    return _most(own_code, heard, 0.25)


def _most(own_code: Array, heard: Arrivals, step_chips: float) -> Floats:
    """The largest |R| at the lags 0, step, 2·step, … that an arrival overlaps."""
    if not len(heard.delays_chips):
        return np.empty(0)
    first = np.floor((heard.delays_chips - CHIPS) / step_chips)
    around = step_chips * np.arange(2 * CHIPS / step_chips + 2)
    out = np.zeros(len(first))
    for k, start in enumerate(step_chips * first):
        lags = start + around
        alone = Arrivals(heard.codes[k : k + 1], heard.delays_chips[k : k + 1], heard.strengths[k : k + 1])
        out[k] = abs(correlations(own_code, alone, lags[lags >= 0])).max(initial=0.0)
    return out


RECEIVERS: dict[str, Receiver] = {"uncoded": _uncoded, "slots": _in_slots, "sliding": _sliding}


def let_through(receiver: str, own_code: Array, heard: Arrivals, threshold: float = 0.5) -> Array:
    """(K,) bool: which arrivals a receiver takes for echoes of its own ping: those that give it at least `threshold` of
    what an own echo does. Raises InputError for a receiver that there is not."""
    if receiver not in RECEIVERS:
        raise InputError(f"receiver '{receiver}': there are {', '.join(RECEIVERS)}")
    # A sum of eighths may be off by a bit.
    return np.asarray(RECEIVERS[receiver](own_code, heard) >= threshold - 1e-9)


def chips(delay_s: Floats) -> Floats:
    """Seconds as chips."""
    return np.asarray(delay_s) / CHIP_S


def range_of(delay_s: Floats) -> Floats:
    """Metres at which a sonar believes an echo that comes so long after its ping."""
    return np.asarray(delay_s) * SOUND_M_S / 2
