"""Plans over small grids by hand, and over benchmark maps whose shortest ways are known."""

from __future__ import annotations

from math import sqrt
from pathlib import Path

import numpy as np
import pytest

from terrafuse.errors import InputError, NoPath
from terrafuse.navigate import nearest_free, plan
from tests.navigate.drawn import costs
from tests.navigate.movingai import scenarios


def test_no_corner_is_cut() -> None:
    """A diagonal past the obstacle would have it beside the step: 4 straight steps. Without the obstacle, 2√2."""
    blocked = plan(costs("... .#. ..."), (0, 0), (2, 2))
    assert blocked.cost == pytest.approx(4.0)
    assert len(blocked.cells) == 5
    assert plan(costs("... ... ..."), (0, 0), (2, 2)).cost == pytest.approx(2 * sqrt(2))


def test_nor_squeezed_through() -> None:
    with pytest.raises(NoPath) as raised:
        plan(costs(".# #."), (1, 0), (0, 1))
    assert raised.value.facts == {"reason": "not_connected", "nearest": (1, 0)}


def test_a_step_costs_the_mean_of_its_cells() -> None:
    """. 3 . in a row: (1 + 3)/2 + (3 + 1)/2 = 4; with a free row below it two diagonals, each 1·√2, are cheaper."""
    assert plan(costs(".3."), (0, 0), (2, 0)).cost == pytest.approx(4.0)
    detour = plan(costs(".3. ..."), (0, 1), (2, 1))
    assert detour.cost == pytest.approx(2 * sqrt(2))
    assert detour.cells.tolist() == [[0, 1], [1, 0], [2, 1]]
    # 2 in the middle costs 1.5 + 1.5 = 3, still more than 2√2 = 2.83; alone it is 3.
    assert plan(costs(".2. ..."), (0, 1), (2, 1)).cost == pytest.approx(2 * sqrt(2))
    assert plan(costs(".2. ###"), (0, 1), (2, 1)).cost == pytest.approx(3.0)


def test_a_detour_is_taken_while_it_is_cheaper() -> None:
    """Through the mud: (1 + 9)/2 + 9 + 9 + (9 + 1)/2 = 28. Round it, whose corners may be cut, as mud can be entered:
    √2 down, 2 straight, √2 up."""
    field = costs(".....  .999.  .999.  .....")
    assert plan(field, (0, 1), (4, 1)).cost == pytest.approx(2 + 2 * sqrt(2))
    assert plan(costs(".999."), (0, 0), (4, 0)).cost == pytest.approx(28.0)


def test_being_there_already() -> None:
    here = plan(costs("..."), (1, 0), (1, 0))
    assert (here.cells.tolist(), here.cost, here.expanded) == ([[1, 0]], 0.0, 1)


def test_of_equal_ways_always_the_same() -> None:
    """From (0, 0) to (2, 1) a straight and a diagonal step, in either order. Both first cells promise 1 + √2 in all;
    from (1, 1) a straight step is left, from (1, 0) a diagonal: (1, 1) is nearer, and is taken first."""
    assert plan(costs("... ..."), (0, 0), (2, 1)).cells.tolist() == [[0, 0], [1, 1], [2, 1]]
    rough = np.random.default_rng(1).integers(1, 4, (40, 40)).astype(np.int16) * 100
    first = plan(rough, (0, 0), (39, 39))
    for _ in range(3):
        again = plan(rough.copy(), (0, 0), (39, 39))
        assert again.cells.tobytes() == first.cells.tobytes()


MAZE = """
    .....
    .##?.
    .#.#.
    .###.
    .....
"""


@pytest.mark.parametrize(
    ("goal", "facts", "words"),
    [
        ((5, 0), {"reason": "outside", "end": "goal"}, "cells go from 0,0 to 4,4"),
        ((0, -1), {"reason": "outside", "end": "goal"}, "goal 0,-1 lies outside"),
        ((1, 1), {"reason": "obstacle", "end": "goal", "nearest": (1, 0)}, "nearest place for it is 1,0"),
        ((3, 3), {"reason": "unknown", "end": "goal", "nearest": (4, 3)}, "nobody has seen"),
        ((2, 2), {"reason": "not_connected", "nearest": (2, 0)}, "no way leads from 0,0 to 2,2"),
    ],
)
def test_why_there_is_no_way(goal: tuple[int, int], facts: dict[str, object], words: str) -> None:
    with pytest.raises(NoPath, match=words) as raised:
        plan(costs(MAZE), (0, 0), goal)
    assert raised.value.facts == facts
    if "end" in facts:
        with pytest.raises(NoPath) as raised:
            plan(costs(MAZE), goal, (0, 0))
        assert raised.value.facts == facts | {"end": "start"}


def test_too_near_is_a_reason_of_its_own() -> None:
    grid = costs("...")
    grid[0, 1] = -2
    with pytest.raises(NoPath, match="radius_m") as raised:
        plan(grid, (0, 0), (1, 0))
    assert raised.value.facts["reason"] == "too_near"


def test_a_map_without_a_free_cell() -> None:
    grid = costs("## ##")
    assert nearest_free(grid, (0, 0)) is None
    with pytest.raises(NoPath, match="no place for it"):
        plan(grid, (0, 0), (1, 1))


@pytest.mark.parametrize("bad", [np.ones((2, 2)), np.ones(4, np.int16), np.ones((0, 3), np.int16)])
def test_costs_of_another_kind_are_refused(bad: np.ndarray) -> None:
    with pytest.raises(InputError, match="int16"):
        plan(bad, (0, 0), (1, 1))


def test_every_benchmark_problem_has_its_stated_length(recordings: Path) -> None:
    problems = 0
    for name, grid, cases in scenarios(recordings):
        lengths = np.array([plan(grid, case.start, case.goal).cost for case in cases])
        np.testing.assert_allclose(lengths, [case.length for case in cases], rtol=0, atol=1e-3, err_msg=name)
        problems += len(cases)
    assert problems >= 1485
