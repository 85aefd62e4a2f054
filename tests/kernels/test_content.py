"""What no mapper makes is seen: as the references see it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from terrafuse.kernels import absorb, content, evidence
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


@given(seed=st.integers(0, 2**31), count=st.integers(0, 5))
def test_newest_are_the_largest(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    revisions, stamps = rng.integers(1, 2**32, count).astype(np.uint32), rng.integers(0, 2**62, count)
    assert content.newest_of(revisions, stamps) == (revisions.max(initial=0), stamps.max(initial=0))


@given(seed=st.integers(0, 2**31), count=st.integers(0, 9))
def test_looking_up_is_indexing(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    which, stamps, revisions = rng.integers(0, 3, count), rng.integers(0, 2**62, 3), rng.integers(0, 9, 3, np.uint32)
    cells = np.zeros(count, absorb.CELL)
    starts = np.array([0, len(which) // 2, len(which)])
    newest = np.empty((2, 2), np.int64)
    content.look_up(which, starts, revisions, stamps, cells["revision"], cells["stamp"], newest)
    assert (cells["stamp"].tolist(), cells["revision"].tolist()) == (stamps[which].tolist(), revisions[which].tolist())
    for (first, end), found in zip(pairwise(starts.tolist()), newest.tolist(), strict=True):
        assert tuple(found) == content.newest_of(cells["revision"][first:end], cells["stamp"][first:end])


def test_each_flaw_is_named() -> None:
    starts, one = np.zeros(1, np.int64), np.ones(2, np.uint32)
    rising, stamps = np.array([3, 4], np.int32), np.zeros(2, np.int64)
    assert content.flaw_of(starts, rising, one, stamps, AREA, 1) == content.SOUND
    assert content.flaw_of(starts, rising[::-1], one, stamps, AREA, 1) == content.POSITIONS
    assert content.flaw_of(np.arange(2), rising[::-1], one, stamps, AREA, 1) == content.SOUND  # of two tiles
    assert content.flaw_of(starts, rising, one * 2, stamps, AREA, 1) == content.REVISIONS
    assert content.flaw_of(starts, rising, one, stamps - 1, AREA, 1) == content.STAMPS


@given(seed=st.integers(0, 2**31), count=st.integers(1, 6))
def test_sound_elevation_cells_are_those_of_the_reference(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    cells = np.zeros(count, absorb.CELL)
    grounds = cells.view(absorb.GROUND_OF_CELL)
    for k in range(count):
        for records in (cells, grounds) if rng.random() < 0.5 else (cells,):
            for field, value in zip(evidence.EVIDENCE.names or (), sums(rng), strict=True):
                records[field][k] = value
    cells["merges"] = 1
    if rng.random() < 0.5:
        field = rng.choice(cells.dtype.names)
        cells[field][rng.integers(count)] += rng.integers(0, 3)
    assert absorb.sound(cells, grounds) == sound_reference(cells, grounds)


def sound_reference(cells: Array, grounds: Array) -> bool:
    none = grounds == np.zeros((), grounds.dtype)
    ground = none | evidence.consistent(grounds)
    return bool((evidence.consistent(cells) & ground & (cells["changes"] < cells["merges"])).all())


def sums(rng: np.random.Generator) -> tuple[int, ...]:
    """Of a few points, small numbers and large: n, z_min, z_max, sq_hi, z_sum, sq_lo."""
    heights = [int(z) for z in rng.integers(-(2**31), 2**31, rng.integers(1, 5)) >> int(rng.integers(0, 31))]
    square = sum(z * z for z in heights)
    return len(heights), min(heights), max(heights), square >> 64, sum(heights), square & (2**64 - 1)
