"""Wandering: free ways by hand, and in the hallway, where it must get about and touch nothing."""

from dataclasses import replace
from math import inf, radians

import numpy as np
import pytest

from terrafuse.sense.describe import load_sensor
from terrafuse.simulate import RayCaster, truth
from terrafuse.simulate.mission.behaviours.avoidance import (
    NARROW_M,
    Echoes,
    drive_towards,
    free_ways_m,
    nearest_free_rad,
)
from terrafuse.simulate.mission.behaviours.wander import BACK_MPS, Wander, WanderSettings
from terrafuse.simulate.mission.engine import Mission
from terrafuse.simulate.mission.fleet import Drive, Fleet, Start
from terrafuse.simulate.mission.situation import Situation, echoes_of, obstacles_of
from terrafuse.simulate.mission.surface import Surface
from terrafuse.simulate.motion import BODIES
from terrafuse.simulate.movers import NO_BODIES
from terrafuse.simulate.scenario import load_scenario, with_robots
from terrafuse.simulate.worlds import hallway as hallway_world
from terrafuse.types import Pose, pose_of

NOMAD = BODIES["nomad"]
NOWHERE = np.empty((0, 2))


def situation(**values) -> Situation:
    me = Situation("r1", NOMAD, **values)
    me.known_share = lambda bounds: 0.0  # type: ignore[method-assign]
    return me


def hallway(robots: int, duration_s: float, seed: int = 0) -> Mission:
    loaded = with_robots(load_scenario("hallway"), robots)
    changed = loaded.scenario.model_copy(update={"duration_s": duration_s, "seed": seed})
    return Mission(replace(loaded, scenario=changed))


# --- free ways -------------------------------------------------------------------------------------------------------


def test_how_far_a_strip_is_free():
    places = np.array([[1.0, 0.1], [0.5, 0.3], [-0.2, 0.0]])
    ahead, left, back = free_ways_m(places, 0.2, np.radians([0, 90, 180]))
    # Ahead, 0.5 m is 0.3 m aside: only the first counts. To the left, the first and second are 1 m and 0.5 m aside, the
    # third lies at 0 along, which is not ahead. Backwards, the third lies 0.2 m off.
    assert (ahead, left) == (1.0, inf)
    assert back == pytest.approx(0.2)


def test_nothing_heard_is_free_everywhere():
    assert (free_ways_m(NOWHERE, 0.3, np.radians([0, 45])) == inf).all()


def wall(distance_m: float) -> np.ndarray:
    """Across the way, ahead."""
    return np.column_stack([np.full(81, distance_m), np.linspace(-4, 4, 81)])


def test_the_free_direction_nearest_to_the_wanted_one():
    assert nearest_free_rad(situation(), NOWHERE, 0.3, 1) == pytest.approx(0.3)
    assert nearest_free_rad(situation(), wall(2.0), 0.0, 1) == pytest.approx(0.0)
    left, right = (nearest_free_rad(situation(), wall(0.5), 0.0, side) for side in (1, -1))
    assert left == pytest.approx(-right)
    assert radians(60) <= left <= radians(110)


def test_between_two_walls_there_may_be_no_way():
    around = np.column_stack([0.5 * np.cos(np.linspace(0, 6.3, 60)), 0.5 * np.sin(np.linspace(0, 6.3, 60))])
    assert nearest_free_rad(situation(), around, 0.0, 1) is None


def test_a_door_of_a_metre_is_wide_enough():
    jambs = np.array([[0.6, side * (0.5 + k / 10)] for side in (1, -1) for k in range(20)])
    assert nearest_free_rad(situation(), jambs, 0.0, 1) == pytest.approx(0.0)


def test_it_stops_before_what_is_ahead_and_turns_on_the_spot():
    me = situation()
    assert drive_towards(me, wall(NOMAD.radius_m + 0.05), 0.0, 0.5).speed_mps == 0.0
    assert drive_towards(me, wall(3.0), 0.0, 0.5).speed_mps == 0.5
    aside = drive_towards(me, NOWHERE, radians(90), 0.5)
    assert aside.speed_mps == 0.0
    assert aside.yaw_rate_radps > 0


def test_readings_are_remembered_where_they_were():
    me, echoes = situation(), Echoes(memory_s=2.0)
    me.obstacles_m = np.array([[1.0, 0.0]])
    assert echoes.around(me).tolist() == [[1.0, 0.0]]
    # A metre further it has turned left: what was a metre ahead of the start lies where it stands now.
    me.now_s, me.yaw_rad, me.T_world_base = 1.0, radians(90), pose_of(np.eye(3), np.array([1.0, 0.0, 0.0]))
    me.obstacles_m = np.array([[0.5, 0.0]])
    assert echoes.around(me) == pytest.approx(np.array([[0.0, 0.0], [0.5, 0.0]]))
    me.now_s = 2.5
    assert echoes.around(me) == pytest.approx(np.array([[0.5, 0.0]]))


def test_all_that_a_level_sonar_hears_arrives():
    points = np.array([[1.0, 0.0, 0.0], [0.0, 1.2, 0.0]])
    level = Pose.identity()
    assert len(obstacles_of(points, level, 12.0)) == 0  # to a lidar, what is as low as its own feet is ground
    assert len(echoes_of(points, level, 12.0)) == 2
    assert load_sensor("nomad_200_sonar").cone_half_angle_rad > 0


# --- one robot -------------------------------------------------------------------------------------------------------


def test_it_backs_off_when_it_bumped():
    wander = Wander(WanderSettings(), np.random.default_rng(0))
    me = situation()
    wander.drive(me)
    me.now_s, me.stopped = 1.0, True
    assert wander.drive(me).speed_mps == BACK_MPS
    me.now_s, me.stopped = 1.2, False
    assert wander.drive(me).speed_mps == BACK_MPS
    assert wander.facts()["bumps"] == 1
    me.now_s = 2.5
    assert wander.drive(me).speed_mps >= 0
    places = wander._echoes.around(me)
    assert np.hypot(*places.T).min() == pytest.approx(NOMAD.radius_m + NARROW_M)


def test_whims_are_those_of_the_seed():
    def headings(seed: int) -> list[float]:
        wander, me = Wander(WanderSettings(), np.random.default_rng(seed)), situation()
        out = []
        for k in range(200):
            me.now_s = float(k)
            wander.drive(me)
            out.append(wander._heading_rad)
        return out

    assert headings(1) == headings(1)
    assert headings(1) != headings(2)
    assert len(set(headings(1))) > 4  # it does not go one way for ever


@pytest.mark.parametrize("body", ["nomad", "soccer"])
@pytest.mark.parametrize(("x_m", "aside_m"), [(11.03, 0.05), (11.03, 0.0), (13.0, 0.0), (13.0, 0.3)])
def test_two_that_drive_into_each_other_stop_apart_and_get_away(body: str, x_m: float, aside_m: float) -> None:
    world, diameter_m = hallway_world(), 2 * BODIES[body].radius_m
    surface = Surface(world, RayCaster(world))
    fleet = Fleet([Start(body, 10.0, 6.0, 0.0), Start(body, x_m, 6.0 + aside_m, radians(180))], surface, world)
    for _ in range(60):
        fleet.step({0: Drive(0.6), 1: Drive(0.6)}, 0.1, NO_BODIES)
    assert fleet.stopped_by_something(0)
    assert fleet.stopped_by_something(1)
    assert gap(fleet) >= diameter_m - 0.02  # rims are looked at every 0.1 m
    for _ in range(20):
        fleet.step({0: Drive(-0.2), 1: Drive(-0.2)}, 0.1, NO_BODIES)
    assert gap(fleet) > diameter_m + 0.5


def gap(fleet: Fleet) -> float:
    return float(np.hypot(*(fleet.position_m(0) - fleet.position_m(1))[:2]))


# --- in the hallway --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, 1])
def test_it_gets_about_and_touches_nothing(seed):
    mission = hallway(1, 150.0, seed)
    track = []
    mission.run([lambda m: track.append(m.fleet.position_m(0)[:2].copy())])
    lattice = mission.lattice
    window = lattice.cell_window(mission.world.bounds)
    walls = truth.occupied(mission.world, lattice, window, (0.1, 2.0))
    j, i = np.nonzero(walls)
    middles = np.column_stack([lattice.cell_centre(i + window[0]), lattice.cell_centre(j + window[1])])
    nearest = min(np.hypot(*(middles - place).T).min() for place in track[::5])
    assert nearest > NOMAD.radius_m - lattice.resolution_m  # a cell's middle lies up to half a diagonal in the wall
    assert mission.vehicles[0].way_m > 30
    assert np.ptp(np.array(track), axis=0).max() > 4
    assert mission.vehicles[0].behaviour.facts()["bumps"] <= 1


def test_the_same_seed_is_the_same_mission_whatever_the_threads():
    one, two = hallway(3, 12.0), hallway(3, 12.0)
    one.run()
    two.run(threads=2)
    assert one.station.replica.digest() == two.station.replica.digest()
    assert one.station.replica.keys
    assert [v.facts() for v in one.vehicles] == [v.facts() for v in two.vehicles]
