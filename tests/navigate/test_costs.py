"""What a map costs a robot."""

from __future__ import annotations

from math import sqrt

import numpy as np
import pytest

from terrafuse.errors import InputError
from terrafuse.lattice import Lattice
from terrafuse.models import make_model
from terrafuse.navigate import Robot, cost_map
from terrafuse.navigate.costs import FREE, MAX_CELLS, OBSTACLE, STRIP, TOO_NEAR, UNKNOWN, priced
from terrafuse.replica import Replica
from terrafuse.testing.deltas import deltas_of, scan_of
from terrafuse.types import Array, Bounds
from tests.navigate.drawn import occupancy_map

NAN = float("nan")
POINT = Robot(radius_m=0.0, keep_away_m=0.0)
ONE_WALL = np.array([[1.0] + [0.0] * 7])


def row(occupied: list[float], robot: Robot, resolution_m: float = 1.0) -> list[int]:
    costs: Array = priced(np.array([occupied]), None, robot, resolution_m)
    return list(costs[0].tolist())


def test_the_price_of_what_may_be_occupied() -> None:
    """1 + 1·(p/0.325 - 1) over 0.325: p = 0.39 costs 1.2, 0.4875 costs 1.5, 0.64 costs 1.969; from 0.65 on it is an
    obstacle."""
    assert row([0.0, 0.3, 0.39, 0.4875, 0.64, 0.65, 1.0], POINT) == [100, 100, 120, 150, 197, OBSTACLE, OBSTACLE]
    assert row([0.0, 0.5], Robot(0.0, keep_away_m=0.0, occupied_from=0.5)) == [100, OBSTACLE]
    assert row([0.6], Robot(0.0, keep_away_m=0.0, occupied_price=0.0)) == [100]


def test_obstacles_are_as_wide_as_the_robot_needs() -> None:
    """Centres stand 1, 2, 3 m from the wall's, whose face is half a metre nearer: 0.5, 1.5 and 2.5 m of room."""
    for radius_m, too_near in ((0.5, 0), (0.51, 1), (1.5, 1), (1.6, 2), (2.5, 2)):
        robot = Robot(radius_m, keep_away_m=0.0)
        assert row([1.0, 0.0, 0.0, 0.0], robot) == [OBSTACLE, *[TOO_NEAR] * too_near, *[FREE] * (3 - too_near)]


def test_fitting_exactly_is_enough_whatever_rounding_says() -> None:
    """A robot of 0.25 m fits 3 cells of 0.1 m from a wall's centre, though 3·0.1 - 0.05 - 0.25 is not 0 in floats."""
    assert row([1.0, 0.0, 0.0, 0.0], Robot(0.25, keep_away_m=0.0), 0.1) == [OBSTACLE, TOO_NEAR, TOO_NEAR, FREE]


def test_the_room_is_euclidean() -> None:
    """Around an obstacle in 7×7 cells, of radius 1.7 m: centres nearer than 2.2 are too near. √5 = 2.24 is not, nor is
    √8; 2 and √2 are."""
    occupied = np.zeros((7, 7))
    occupied[3, 3] = 1.0
    costs = priced(occupied, None, Robot(1.7, keep_away_m=0.0), 1.0)
    j, i = np.indices(costs.shape)
    away = np.hypot(j - 3, i - 3)
    np.testing.assert_array_equal(costs == TOO_NEAR, (away > 0) & (away < 2.2))
    assert costs[3, 3] == OBSTACLE
    assert sqrt(5) > 2.2


def test_near_obstacles_it_is_dearer() -> None:
    """Radius 0.5, and 2 m more for 2 the metre: gaps of 0, 1, 2 and 3 m cost 1 + 2, 1 + 1, 1 and 1."""
    robot = Robot(0.5, keep_away_m=2.0, keep_away_price=2.0)
    assert row([1.0, 0.0, 0.0, 0.0, 0.0], robot) == [OBSTACLE, 300, 200, 100, 100]


def test_the_unknown() -> None:
    """At its price, not at all, or as if it were free; beside an obstacle the robot does not fit there either."""
    cells = [1.0, NAN, NAN, 0.0]
    assert row(cells, Robot(0.6, "avoid", keep_away_m=0.0)) == [OBSTACLE, TOO_NEAR, 400, 100]
    assert row(cells, Robot(0.6, "avoid", keep_away_m=0.0, unknown_price=2.5)) == [OBSTACLE, TOO_NEAR, 250, 100]
    assert row(cells, Robot(0.6, "forbid", keep_away_m=0.0)) == [OBSTACLE, TOO_NEAR, UNKNOWN, 100]
    assert row(cells, Robot(0.6, "free", keep_away_m=0.0)) == [OBSTACLE, TOO_NEAR, 100, 100]


def test_strips_make_no_difference() -> None:
    rng = np.random.default_rng(0)
    occupied = rng.random((2 * STRIP + 7, 20)) * 0.66
    occupied[rng.random(occupied.shape) < 0.1] = NAN
    whole = priced(occupied, None, Robot(1.0), 0.5)
    turned = priced(np.ascontiguousarray(occupied.T), None, Robot(1.0), 0.5)
    np.testing.assert_array_equal(whole, turned.T)


def test_the_highest_prices_fit() -> None:
    dearest = Robot(0.0, "avoid", keep_away_m=100.0, keep_away_price=100, occupied_price=100, unknown_price=100)
    assert row([0.649999, NAN, 1.0], dearest, 1e-3) == [20_100, 20_000, OBSTACLE]


def test_a_window_sees_obstacles_beyond_its_edge() -> None:
    whole = occupancy_map("....#... ........ ........")
    robot = Robot(1.0, keep_away_m=2.0)
    full = cost_map(whole, robot)
    part = cost_map(whole, robot, Bounds(1, 0, 4, 2))
    assert (part.i0, part.j0) == (1, 0)
    np.testing.assert_array_equal(part.costs, full.costs[0:2, 1:4])
    assert part.costs.min() == TOO_NEAR


def test_a_window_may_reach_beyond_the_map() -> None:
    wide = cost_map(occupancy_map(".."), Robot(0.0, "forbid"), Bounds(-2, 0, 3, 2))
    assert wide.costs.tolist() == [[-1, -1, 100, 100, -1], [-1] * 5]
    assert wide.unknown.tolist() == [[True, True, False, False, True], [True] * 5]


def test_what_can_not_be_planned_on() -> None:
    with pytest.raises(InputError, match="empty"):
        cost_map(Replica(Lattice(1.0), make_model("occupancy")), POINT)
    with pytest.raises(InputError, match="give bounds of at most"):
        cost_map(occupancy_map(".."), POINT, Bounds(0, 0, MAX_CELLS, 1))
    with pytest.raises(InputError, match="knows no slopes"):
        cost_map(occupancy_map(".."), Robot(max_slope=0.2))


def hillside(model: str) -> Replica:
    """z = 0.15·x up to x = 4, and 0.3·x beyond; 20 × 20 points a cell of half a metre."""
    lattice = Lattice(0.5, 10.0)
    grid = (np.arange(320) + 0.5) * 0.025
    x, y = (axis.ravel() for axis in np.meshgrid(grid, grid))
    z = np.where(x < 4, 0.15 * x, 0.6 + 0.3 * (x - 4))
    replica = Replica(lattice, make_model(model))
    for delta in deltas_of("r1", [scan_of(np.column_stack([x, y, z]))], lattice, replica.model):
        replica.apply(delta)
    return replica


@pytest.mark.parametrize("model", ["elevation", "terrain"])
def test_too_steep_is_an_obstacle(model: str) -> None:
    """Where planes lie wholly on either side: columns 0 to 5 rise by 0.15, 10 to 15 by 0.3."""
    costs = {
        slope: cost_map(hillside(model), Robot(0.0, max_slope=slope, occupied_from=1.0), Bounds(0, 0, 8, 8)).costs
        for slope in (0.1, 0.2, 0.25)
    }
    for slope in (0.2, 0.25):
        assert (costs[slope][2:-2, 1:5] > 0).all()
        assert (costs[slope][2:-2, 11:14] == OBSTACLE).all()
    assert (costs[0.1][2:-2, 1:14] == OBSTACLE).all()
