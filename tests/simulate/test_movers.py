"""Where what moves is at a time, and what it is made of."""

from __future__ import annotations

import math

import numpy as np
import pytest

from terrafuse.errors import InputError
from terrafuse.simulate.movers import Mover, Part, Route, body, drive
from terrafuse.simulate.terrain import Terrain
from terrafuse.simulate.world import World
from terrafuse.simulate.worlds.net import offset_loop

WAY = [(0.0, 0.0), (10.0, 0.0), (10.0, 5.0)]


def test_a_drive_goes_at_its_speed_and_waits_where_told() -> None:
    """2 m/s from 100 s on: 10 m take 5 s, then 4 s of waiting, then 5 m take 2.5 s."""
    route = drive(WAY, 2.0, start_s=100.0, waits_s={1: 4.0})
    assert route.times_s.tolist() == [100.0, 105.0, 109.0, 111.5]
    assert route.at(102.0) == (4.0, 0.0, 0.0)
    assert route.at(107.0) == (10.0, 0.0, 0.0)
    assert route.at(110.0) == (10.0, 2.0, math.pi / 2)
    assert route.at(111.5) == (10.0, 5.0, math.pi / 2)
    assert route.at(99.9) is None
    assert route.at(111.6) is None


def test_what_repeats_is_always_there() -> None:
    route = drive([*WAY, WAY[0]], 1.0, start_s=-3.0, repeats=True)
    period = 15.0 + math.hypot(10, 5)
    for time_s in (0.0, 4.5, 20.0):
        assert route.at(time_s) == pytest.approx(route.at(time_s + 7 * period), abs=1e-9)
    assert route.at(-4.0) is not None


def test_what_has_not_yet_moved_looks_where_it_will_go() -> None:
    route = drive(WAY, 2.0, waits_s={0: 3.0})
    assert route.at(1.0) == (0.0, 0.0, 0.0)
    still = Route(np.array([0.0, 1.0]), np.array([(2.0, 3.0), (2.0, 3.0)]))
    assert still.at(0.5) == (2.0, 3.0, 0.0)


def test_bodies_stand_on_the_ground_turned_and_moved() -> None:
    """A car at (5, 2) on ground that rises 1 in 10 to the east, so at z = 0.5, going north: its cabin, 0.3 m behind its
    middle, is 0.3 m to the south, from 0.9 to 1.5 m above the ground."""
    ground = Terrain(0.0, 0.0, 10.0, np.array([[0.0, 1.0], [0.0, 1.0]]))
    route = drive([(5.0, 0.0), (5.0, 4.0)], 1.0)
    world = World("slope", ground.bounds, ground, movers=(Mover("car", "car", route),))
    hull, cabin = world.bodies(2.0)
    assert (hull["x"], hull["y"]) == pytest.approx((5.0, 2.0))
    assert (cabin["x"], cabin["y"]) == pytest.approx((5.0, 1.7))
    assert (cabin["bottom"], cabin["top"]) == pytest.approx((1.4, 2.0))
    assert (hull["cos"], hull["sin"]) == pytest.approx((0.0, 1.0))
    assert len(world.bodies(5.0)) == 0


def test_a_shape_of_ones_own() -> None:
    (cone,) = body((Part(0.4, 0.4, 0.0, 0.7, round=True),), 1.0, 2.0, 3.0, 0.0)
    assert cone.tolist() == (1.0, 2.0, 3.0, 3.7, 0.2, 0.2, 1.0, 0.0, 1)


def test_ways_keep_to_the_right_there_and_back() -> None:
    """Along x to (10, 0), north to (10, 10), and back, 1 m to the right: below going east, above coming back."""
    loop = offset_loop(np.array([(0, 0), (10, 0), (10, 10), (10, 0), (0, 0)], float), 1.0)
    expected = [(0, 1), (0, -1), (11, -1), (11, 10), (9, 10), (9, 1), (0, 1)]
    np.testing.assert_allclose(loop, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("times", "where", "says"),
    [
        ([0.0], [(0, 0)], "two or more"),
        ([0.0, 0.0], [(0, 0), (1, 0)], "do not rise"),
        ([0.0, np.nan], [(0, 0), (1, 0)], "finite"),
        ([0.0, 1.0], [(0, 0)], "two or more"),
    ],
)
def test_what_is_no_route_is_refused(times: list[float], where: list[tuple[float, float]], says: str) -> None:
    with pytest.raises(InputError, match=says):
        Route(np.array(times), np.array(where, float))


def test_wrong_shapes_and_speeds_are_refused() -> None:
    with pytest.raises(InputError, match="shape 'tank': there are car"):
        Mover("x", "tank", drive(WAY, 1.0))
    with pytest.raises(InputError, match="speed 0 m/s"):
        drive(WAY, 0)
    ground = Terrain(0.0, 0.0, 10.0, np.zeros((2, 2)))
    twice = (Mover("x", "car", drive(WAY, 1.0)), Mover("x", "car", drive(WAY, 1.0)))
    with pytest.raises(InputError, match="two movers have one name"):
        World("w", ground.bounds, ground, movers=twice)
