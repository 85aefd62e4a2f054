"""What no mapper makes is seen: as the references see it."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from terrafuse.kernels import content, evidence
from terrafuse.types import Array

AREA = 9


@given(seed=st.integers(0, 2**31), counts=st.lists(st.integers(1, 4), min_size=1, max_size=3))
def test_flaws_equal_the_reference(seed: int, counts: list[int]) -> None:
    rng = np.random.default_rng(seed)
    at = np.concatenate([np.sort(rng.choice(AREA, count, replace=False)) for count in counts]).astype(np.int32)
    starts = np.cumsum([0, *counts[:-1]])
    revisions, stamps = rng.integers(1, 6, len(at)).astype(np.uint32), rng.integers(0, 9, len(at))
    for values, wrong in ((at, (-1, AREA, at[0])), (revisions, (0, 6)), (stamps, (-1,))):
        if rng.random() < 0.3:
            values[rng.integers(len(at))] = rng.choice(wrong)
    given_ = starts, at, revisions, stamps, AREA, 5
    assert content.flaw_of(*given_) == content.flaw_of_reference(*given_)


def test_each_flaw_is_named() -> None:
    starts, one = np.zeros(1, np.int64), np.ones(2, np.uint32)
    rising, stamps = np.array([3, 4], np.int32), np.zeros(2, np.int64)
    assert content.flaw_of(starts, rising, one, stamps, AREA, 1) == content.SOUND
    assert content.flaw_of(starts, rising[::-1], one, stamps, AREA, 1) == content.POSITIONS
    assert content.flaw_of(np.arange(2), rising[::-1], one, stamps, AREA, 1) == content.SOUND  # of two tiles
    assert content.flaw_of(starts, rising, one * 2, stamps, AREA, 1) == content.REVISIONS
    assert content.flaw_of(starts, rising, one, stamps - 1, AREA, 1) == content.STAMPS


@given(seed=st.integers(0, 2**31), count=st.integers(1, 6), zeros_too=st.booleans())
def test_consistent_sums_equal_the_reference(seed: int, count: int, zeros_too: bool) -> None:
    rng = np.random.default_rng(seed)
    records = np.array([sums(rng) for _ in range(count)], evidence.EVIDENCE)
    if rng.random() < 0.5:
        records[rng.integers(count)] = 0
    if rng.random() < 0.5:
        field = rng.choice(records.dtype.names)
        records[rng.integers(count)][field] += rng.integers(0, 3)
    assert evidence.all_consistent(records, zeros_too) == all_consistent_reference(records, zeros_too)


def all_consistent_reference(records: Array, zeros_too: bool) -> bool:
    none = (records == np.zeros((), records.dtype)) & zeros_too
    return bool((none | evidence.consistent(records)).all())


def sums(rng: np.random.Generator) -> tuple[int, ...]:
    """Of a few points, small numbers and large: n, z_min, z_max, sq_hi, z_sum, sq_lo."""
    heights = [int(z) for z in rng.integers(-(2**31), 2**31, rng.integers(1, 5)) >> int(rng.integers(0, 31))]
    square = sum(z * z for z in heights)
    return len(heights), min(heights), max(heights), square >> 64, sum(heights), square & (2**64 - 1)
