"""Allotting streets to robots: everything is visited once, and nobody's route is much longer than it must be."""

from __future__ import annotations

import numpy as np
import pytest

from terrafuse.errors import InputError
from terrafuse.navigate.allotment import allot, street_distances, way

LINE_M = np.array([[0.0, 0], [100, 0], [200, 0], [300, 0]])
LINE = np.array([[0, 1], [1, 2], [2, 3]])


def test_distances_count_along_the_streets() -> None:
    distances, next_hop = street_distances(LINE_M, LINE)
    assert distances[0].tolist() == [0, 100, 200, 300]
    assert way(next_hop, [3, 0, 1]) == [3, 2, 1, 0, 1]


def test_two_robots_in_the_middle_part() -> None:
    distances, _ = street_distances(LINE_M, LINE)
    assert sorted(allot(distances, [1, 1], [0, 2, 3])) == [[0], [2, 3]]


def test_no_robots() -> None:
    with pytest.raises(InputError, match="at least one start"):
        allot(np.zeros((1, 1)), [], [0])
