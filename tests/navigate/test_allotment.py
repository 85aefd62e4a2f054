"""Allotting streets to robots: everything is visited once, and nobody's route is much longer than it must be."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from terrafuse.errors import InputError
from terrafuse.navigate.allotment import Visit, allot, along, least_longest_m, nearest_takes, patrol
from terrafuse.navigate.street_net import street_distances
from terrafuse.simulate.streets import Streets
from terrafuse.simulate.worlds import village
from terrafuse.types import Floats
from tests.navigate.patrols import middle, random_net, seen_at_s, seen_share_at_s

LINE_M = np.array([[0.0, 0], [100, 0], [200, 0], [300, 0]])
LINE = np.array([[0, 1], [1, 2], [2, 3]])
WORST = 2.0
"""So many times the lower bound: that is a tree, of which an open route may have to drive every branch twice."""


def longest_m(distances: Floats, starts: Sequence[int], routes: list[list[int]]) -> float:
    return max(float(distances[[start, *route][:-1], route].sum()) for start, route in zip(starts, routes, strict=True))


def test_two_robots_part_in_the_middle() -> None:
    distances, _ = street_distances(LINE_M, LINE)
    assert sorted(allot(distances, [1, 1], [0, 2, 3])) == [[0], [2, 3]]


def test_of_several_places_one_is_visited() -> None:
    distances, _ = street_distances(LINE_M, LINE)
    assert allot(distances, [1], [(0, 3), 2]) == [[2, 3]]
    assert allot(distances, [1], [(0, 3)]) == [[0]]


nets = st.tuples(st.integers(0, 10**6), st.integers(1, 20))


@settings(max_examples=30)
@given(nets, st.lists(st.integers(0, 19), min_size=1, max_size=5), st.lists(st.integers(0, 19), max_size=25))
def test_every_visit_is_in_one_route(net: tuple[int, int], starts: list[int], visits: list[int]) -> None:
    distances, _ = street_distances(*random_net(*net))
    starts, visits = ([node % len(distances) for node in nodes] for nodes in (starts, visits))
    routes = allot(distances, starts, visits)
    assert len(routes) == len(starts)
    assert sorted(node for route in routes for node in route) == sorted(set(visits))


@settings(max_examples=10)
@given(nets, st.integers(1, 6))
def test_the_same_again_is_the_same(net: tuple[int, int], robots: int) -> None:
    distances, _ = street_distances(*random_net(*net))
    visits = range(len(distances))
    assert allot(distances, [0] * robots, visits) == allot(distances, np.zeros(robots, int), np.array(visits))


@settings(max_examples=15)
@given(st.integers(0, 10**6), st.integers(2, 60), st.integers(1, 8))
def test_no_route_is_much_longer_than_it_must_be(seed: int, count: int, robots: int) -> None:
    distances, _ = street_distances(*random_net(seed, count))
    starts, visits = [0] * robots, range(count)
    least = least_longest_m(distances, starts, visits)
    found = longest_m(distances, starts, allot(distances, starts, visits))
    assert least <= found * (1 + 1e-9)
    assert found <= WORST * least


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("starts", [(0, 0), (0, 1)])
def test_two_robots_on_a_tiny_net_have_the_best_routes(seed: int, starts: tuple[int, int]) -> None:
    distances, _ = street_distances(*random_net(seed, 8))
    visits = [n for n in range(8) if n not in starts]
    found = longest_m(distances, starts, allot(distances, starts, visits))
    assert found == pytest.approx(optimum_m(distances, starts, visits), abs=0.01)


def optimum_m(distances: Floats, starts: tuple[int, int], visits: list[int]) -> float:
    """The shorter longest route of two robots: all ways to share the visits out, each half by dynamic programming."""
    shares = range(2 ** len(visits))

    @cache
    def shortest(share: int, last: int) -> float:
        """From a start (node -1 - start) through a share of the visits."""
        here = -1 - last if last < 0 else visits[last]
        ahead = [v for v in range(len(visits)) if share >> v & 1]
        return min((distances[here, visits[v]] + shortest(share & ~(1 << v), v) for v in ahead), default=0.0)

    first, second = (-1 - start for start in starts)
    return min(max(shortest(share, first), shortest(shares[-1] - share, second)) for share in shares)


def test_the_bound_by_hand() -> None:
    """The tree from 1 joins 0, 2 and 3 by 100 m each: 300 m, 150 m for each of two. 3 is 200 m away."""
    distances, _ = street_distances(LINE_M, LINE)
    assert least_longest_m(distances, [1], [0, 2, 3]) == 300
    assert least_longest_m(distances, [1, 1], [0, 2, 3]) == 200
    assert least_longest_m(distances, [1], [1]) == 0


def test_a_hundred_robots_for_three_places() -> None:
    distances, _ = street_distances(LINE_M, LINE)
    routes = allot(distances, [1] * 100, [0, 2, 3])
    assert sorted(node for route in routes for node in route) == [0, 2, 3]
    assert longest_m(distances, [1] * 100, routes) == 200


def test_nothing_to_visit() -> None:
    assert allot(np.zeros((1, 1)), [0, 0], []) == [[], []]


def test_robots_in_two_nets_each_take_their_own() -> None:
    distances, _ = street_distances(LINE_M, LINE[[0, 2]])
    assert allot(distances, [3, 0, 0], [0, 1, 2])[0] == [2]


def test_no_robots() -> None:
    with pytest.raises(InputError, match="at least one start"):
        allot(np.zeros((1, 1)), [], [0])


@pytest.mark.parametrize(
    ("starts", "visits", "named"),
    [
        ([0], [0, 3], "nodes 3:"),
        ([0], [2, 3], "nodes 2, 3:"),
        ([0], [(2, 3)], "nodes 2 or 3:"),
        ([0], [9], r"\[9\] of a net of 4"),
        ([-1], [0], r"\[-1\] of a net of 4"),
    ],
)
def test_what_no_robot_reaches_is_named(starts: list[int], visits: list[Visit], named: str) -> None:
    distances, _ = street_distances(LINE_M, LINE[:1])
    with pytest.raises(InputError, match=named):
        allot(distances, starts, visits)


@cache
def streets() -> Streets:
    return village(0).streets


@cache
def seen_s(robots: int, gap_m: float = 20.0) -> Floats:
    net = streets()
    ways = patrol(net.nodes_m, net.edges, [middle(net.nodes_m)] * robots, 55.0, net.width_m / 4, gap_m)
    return seen_at_s(net.nodes_m, net.edges, ways)


def test_a_patrol_without_gaps_sees_every_metre() -> None:
    """But for what the lane's offset and the steps of the study cost where sights meet."""
    assert np.isfinite(seen_s(3, gap_m=0.0)).mean() > 0.995


def test_more_robots_see_the_village_sooner() -> None:
    alone, three, twelve = (seen_share_at_s(seen_s(robots), 0.95) for robots in (1, 3, 12))
    assert alone / three >= 2.6
    assert alone / twelve >= 7


def test_a_robot_alone_drives_less_than_all_streets() -> None:
    """Each street once would be the least for one that sees nothing aside, and can seldom be done."""
    net = streets()
    (alone,) = patrol(net.nodes_m, net.edges, [middle(net.nodes_m)], 55.0)
    whole_m = np.hypot(*(net.nodes_m[net.edges[:, 0]] - net.nodes_m[net.edges[:, 1]]).T).sum()
    assert np.hypot(*np.diff(alone, axis=0).T).sum() < 0.85 * whole_m


def test_what_the_page_shows_runs() -> None:
    page = (Path(__file__).parents[2] / "docs" / "planning.md").read_text()
    (code,) = re.findall(r"```py\n(.*?)```", page, re.DOTALL)
    found: dict[str, Any] = {}
    exec(compile(code, "planning.md", "exec"), found)
    assert len(found["routes"]) == 3


def test_patrols_begin_where_robots_are() -> None:
    ways = patrol(LINE_M, LINE, [3, 1, 1, 1], 55.0)
    assert [way[0].tolist() for way in ways] == [[300, 0], [100, 0], [100, 0], [100, 0]]


def test_of_routes_from_one_place_each_goes_to_who_stands_nearest_to_its_beginning() -> None:
    """Routes to the east and to the north from node 0, and one from node 1: who stands in the east goes east."""
    east, north, other = (
        np.array(way, float) for way in ([[0, 0], [50, 0]], [[0, 0], [0, 9], [0, 50]], [[9, 9], [0, 0]])
    )
    taken = nearest_takes([north, east, other], [0, 0, 1], np.array([[14.0, 1.0], [1.0, 2.0], [14.0, 0.0]]))
    assert [way is one for way, one in zip(taken, [east, north, other], strict=True)] == [True] * 3
    assert along(north, 15.0).tolist() == [0.0, 15.0]
    assert along(north[:1], 15.0).tolist() == [0.0, 0.0]
