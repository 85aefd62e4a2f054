"""The search for short routes equals its reference in lists, step by step."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from terrafuse.kernels.routes import HEADS, SHIFT, SWAP, TAILS, _moved_across, _moved_within, improve, improve_reference
from terrafuse.types import Array

STEPS = 300


def problem(robots: int, choices: list[int], seed: int) -> tuple[Array, Array, Array, list[list[int]]]:
    """(lengths, near, slots, routes): visits to one of so many places each, dealt out to the robots."""
    slots = np.repeat(np.arange(robots + len(choices)), [1] * robots + choices)
    places = np.random.default_rng(seed).integers(0, 10**6, (len(slots), 2))
    lengths = np.abs(places[:, None] - places).sum(axis=2)
    others = np.where(slots[:, None] == slots[robots:], 10**9, lengths[:, robots:])
    near = robots + np.argsort(others, axis=1, kind="stable")[:, : len(slots) - robots - max(choices)]
    firsts = np.searchsorted(slots, np.arange(robots, robots + len(choices))).tolist()
    return lengths, near, slots, [[r, *firsts[r::robots]] for r in range(robots)]


@settings(max_examples=30)
@given(st.integers(1, 3), st.lists(st.integers(1, 3), min_size=2, max_size=8), st.integers(1, 2**64 - 1))
def test_search_equals_the_reference(robots: int, choices: list[int], seed: int) -> None:
    given_ = problem(robots, choices, seed % 1000)
    assert improve(*given_, STEPS, seed) == improve_reference(*given_, STEPS, seed)


@settings(max_examples=30)
@given(st.integers(1, 3), st.lists(st.integers(1, 3), min_size=2, max_size=8), st.integers(1, 2**64 - 1))
def test_every_slot_keeps_one_option_and_every_robot_its_start(robots: int, choices: list[int], seed: int) -> None:
    lengths, near, slots, routes = problem(robots, choices, seed % 1000)
    found = improve(lengths, near, slots, routes, STEPS, seed)
    assert [route[0] for route in found] == list(range(robots))
    assert sorted(slots[[option for route in found for option in route]]) == list(range(robots + len(choices)))
    assert max(map(length(lengths), found)) <= max(map(length(lengths), routes))


def length(lengths: Array):  # type: ignore[no-untyped-def]
    return lambda route: int(lengths[route[:-1], route[1:]].sum())


@pytest.mark.parametrize(
    ("kind", "few", "after"),
    [
        (0, 2, [0, 1, 4, 5, 2, 3, 6]),
        (SHIFT - 1, 2, [0, 1, 5, 4, 2, 3, 6]),
        (TAILS, 1, [0, 1, 4, 3, 2, 5, 6]),
        (SWAP, 1, [0, 1, 4, 3, 2, 5, 6]),
        (7, 1, [0, 1, 2, 3, 4, 5, 6]),
    ],
)
def test_moves_within_a_route(kind: int, few: int, after: list[int]) -> None:
    """From 1, the stop at 1, to 4, the one at 4."""
    route = list(range(7))
    assert _moved_within(kind, few, route, 1, route, 4) == [after]


@pytest.mark.parametrize(
    ("kind", "few", "after"),
    [
        (0, 2, [[0, 1, 6, 7, 2, 3], [4, 5, 8]]),
        (SHIFT - 1, 3, [[0, 1, 8, 7, 6, 2, 3], [4, 5]]),
        (TAILS, 1, [[0, 1, 6, 7, 8], [4, 5, 2, 3]]),
        (HEADS, 1, [[0, 1, 6, 5], [4, 3, 2, 7, 8]]),
        (SWAP, 1, [[0, 1, 6, 3], [4, 5, 2, 7, 8]]),
    ],
)
def test_moves_between_routes(kind: int, few: int, after: list[list[int]]) -> None:
    """From the stop at 1 of the first to that at 2 of the second."""
    assert _moved_across(kind, few, [0, 1, 2, 3], 1, [4, 5, 6, 7, 8], 2) == after
