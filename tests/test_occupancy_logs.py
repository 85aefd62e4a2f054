"""Occupancy maps of real logs: shared by robots they are the same bytes, and they agree with the readings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from terrafuse.replica import Replica
from terrafuse.types import Scan
from tests.accuracy_occupancy import LOGS, agreement, held_out, in_thirds, map_of, scans_of


@pytest.fixture(scope="module", params=LOGS)
def scans(request: pytest.FixtureRequest, recordings: Path) -> list[Scan]:
    return scans_of(recordings, request.param)


@pytest.fixture(scope="module")
def one_robot(scans: list[Scan]) -> Replica:
    return map_of([scans], 0.1)


def test_a_log_cut_by_time_into_three_robots_gives_the_same_bytes(scans: list[Scan], one_robot: Replica) -> None:
    """Whole records: sums, updates and stamps."""
    fused = map_of(in_thirds(scans), 0.1)
    assert fused.robots == ["r0", "r1", "r2"]
    assert fused.digest() == one_robot.digest()
    assert fused.keys == one_robot.keys
    for key in fused.keys:
        assert fused.cells(key).tobytes() == one_robot.cells(key).tobytes()


def test_so_does_one_that_robots_take_turns_at(scans: list[Scan], one_robot: Replica) -> None:
    turns = np.random.default_rng(0).integers(0, 3, len(scans))
    shared = map_of([[s for s, turn in zip(scans, turns, strict=True) if turn == k] for k in range(3)], 0.1)
    assert shared.digest() == one_robot.digest()


def test_the_map_agrees_with_the_readings(scans: list[Scan], one_robot: Replica) -> None:
    """Figures and what keeps them from 1 stand in docs/accuracy.md."""
    shares = agreement(one_robot, scans, 100)
    assert shares["known cells"] > 40_000
    assert shares["on occupied cells"] > 0.86
    assert shares["on or beside them"] > 0.97
    assert shares["free"] > 0.96


def test_it_foretells_readings_that_it_was_not_made_from(scans: list[Scan]) -> None:
    shares = held_out(scans, 0.1, 100)
    assert shares["on occupied cells"] > 0.84
    assert shares["on or beside them"] > 0.96
    assert shares["free"] > 0.96
