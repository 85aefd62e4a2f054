"""Ways along streets: as long as worked out by hand, on the right side, with places to look out from."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from terrafuse.errors import InputError
from terrafuse.navigate.street_net import street_distances, way, waypoints, with_lookouts
from tests.navigate.patrols import random_net

LINE_M = np.array([[0.0, 0], [100, 0], [200, 0], [300, 0]])
LINE = np.array([[0, 1], [1, 2], [2, 3]])


def test_distances_count_along_the_streets() -> None:
    distances, next_hop = street_distances(LINE_M, LINE)
    assert distances[0].tolist() == [0, 100, 200, 300]
    assert way(next_hop, [3, 0, 1]) == [3, 2, 1, 0, 1]


def test_what_no_street_joins_is_infinitely_far() -> None:
    distances, next_hop = street_distances(LINE_M, LINE[:2])
    assert distances[0, 3] == np.inf
    assert next_hop[0, 3] == -1


def test_a_net_without_streets() -> None:
    assert street_distances(LINE_M[:1], np.empty((0, 2), np.int64))[0].tolist() == [[0.0]]


@given(st.integers(0, 10**6), st.integers(2, 25))
def test_a_way_is_as_long_as_its_streets(seed: int, count: int) -> None:
    nodes, edges = random_net(seed, count)
    distances, next_hop = street_distances(nodes, edges)
    joined = {frozenset(edge) for edge in edges.tolist()}
    for a, b in np.random.default_rng(seed).integers(0, count, (5, 2)).tolist():
        found = way(next_hop, [a, b])
        assert all(frozenset(leg) in joined for leg in pairwise(found))
        legs = np.hypot(*np.diff(nodes[found], axis=0).T).sum()
        assert legs == pytest.approx(distances[a, b])
    assert np.array_equal(distances, distances.T)


@pytest.mark.parametrize(("edge", "named"), [((0, 4), "0 to 4"), ((-1, 2), "-1 to 2")])
def test_edges_of_other_nodes(edge: tuple[int, int], named: str) -> None:
    with pytest.raises(InputError, match=named):
        street_distances(LINE_M, np.array([edge]))


def test_nodes_nowhere() -> None:
    with pytest.raises(InputError, match=r"nodes \[1\]"):
        street_distances(np.array([[0, 0], [np.nan, 0]]), LINE[:1])


def test_the_right_lane_of_a_bend_to_the_left_and_back() -> None:
    """East, north, and back south: 2 m to the right is south of the first leg, east of the second, west of the third.
    Where it bends, both hold at once: (100 + 2, 0 - 2). Where it turns back, first east then west of the node."""
    nodes = np.array([[0.0, 0], [100, 0], [100, 50]])
    found = waypoints(nodes, [0, 1, 2, 1], 2.0)
    assert np.allclose(found, [[0, -2], [102, -2], [102, 50], [98, 50], [98, 0]])


def test_waypoints_without_a_lane_are_the_nodes() -> None:
    assert waypoints(LINE_M, [1, 0, 1]).tolist() == [[100, 0], [0, 0], [100, 0]]
    assert waypoints(LINE_M, [2], 1.5).tolist() == [[200, 0]]


def test_legs_of_no_length_are_left_out() -> None:
    places = np.array([[0.0, 0], [50, 0], [50, 0], [100, 0]])
    assert waypoints(places, [0, 1, 2, 3], 1.0).tolist() == [[0, -1], [50, -1], [100, -1]]


def test_lookouts_see_what_lies_between() -> None:
    """Of 150 m, 55 m are seen from either end: 40 m are missing, so 40 m from one end one sees to 95 m, where the
    other end's sight begins. Of 240 m 130 m are missing: the lookout from a lies behind that from b."""
    nodes = np.array([[0.0, 0], [150, 0], [390, 0], [500, 0]])
    places, edges, lookouts = with_lookouts(nodes, np.array([[0, 1], [1, 2], [2, 3]]), 55.0, 10.0)
    assert lookouts.tolist() == [[4, 6], [5, 7]]
    assert np.allclose(places[lookouts, 0], [[40, 110], [280, 260]])
    assert sorted(map(tuple, edges.tolist())) == [(0, 4), (1, 7), (2, 3), (4, 6), (5, 2), (6, 1), (7, 5)]


def test_small_gaps_are_left() -> None:
    places, edges, lookouts = with_lookouts(LINE_M, LINE, 45.0, 10.0)
    assert (len(places), len(lookouts)) == (4, 0)
    assert edges.tolist() == LINE.tolist()
