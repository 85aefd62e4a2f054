"""Soccer: places of roles and cells under robots by hand; a game of a few seconds; false echoes, by the codes."""

from dataclasses import replace
from itertools import pairwise
from math import dist, pi

import numpy as np
import pytest

from terrafuse.exchange.grey_frame import HEADER
from terrafuse.lattice import Lattice
from terrafuse.sense import Beams, Mounting
from terrafuse.sense.describe import load_sensor
from terrafuse.simulate import RayCaster
from terrafuse.simulate.mission.behaviours.soccer import NEAR_BOARD_M, Ball, keeper, role_of, striker, supporter
from terrafuse.simulate.mission.engine import Mission
from terrafuse.simulate.mission.studies.soccer import (
    Game,
    covered,
    echo_table,
    frame_table,
    robots_said,
    whole_map,
    with_pulses,
)
from terrafuse.simulate.movers import NO_BODIES
from terrafuse.simulate.scenario import Loaded, load_scenario
from terrafuse.simulate.sensors import Sonar
from terrafuse.simulate.sensors.codes import walsh_hadamard
from terrafuse.simulate.sensors.crosstalk import Ping, false_echoes
from terrafuse.simulate.worlds import soccer_field
from terrafuse.types import pose_of
from terrafuse.views import mosaic

FIELD = (0, 0, 24, 36)


def game(duration_s: float, loaded: Loaded | None = None) -> Mission:
    loaded = loaded or load_scenario("soccer")
    return Mission(replace(loaded, scenario=loaded.scenario.model_copy(update={"duration_s": duration_s})))


# --- motion ----------------------------------------------------------------------------------------------------------


def test_the_ball_rolls_on_at_its_speed_and_stays_in_the_field():
    ball, same, other = Ball(3, (6.0, 9.0), 0.6), Ball(3, (6.0, 9.0), 0.6), Ball(4, (6.0, 9.0), 0.6)
    places = [ball.at(k / 10) for k in range(1200)]
    assert places[0] == (3.0, 4.5)
    assert all(dist(a, b) <= 0.06 + 1e-9 for a, b in pairwise(places))
    assert sum(dist(a, b) for a, b in pairwise(places)) > 0.99 * 0.6 * 119.9
    east, north = np.array(places).T
    assert NEAR_BOARD_M <= east.min() < east.max() <= 6.0 - NEAR_BOARD_M
    assert NEAR_BOARD_M <= north.min() < north.max() <= 9.0 - NEAR_BOARD_M
    assert [same.at(k / 10) for k in (1199, 600, 0)] == [places[k] for k in (1199, 600, 0)]  # in any order
    assert other.at(60.0) != ball.at(60.0)


def test_places_of_the_roles():
    goal, ball = (3.0, 0.0), (3.0, 4.5)
    assert keeper(ball, goal) == pytest.approx((3.0, 0.9))
    assert supporter(ball, goal) == pytest.approx((1.8, 2.25))
    assert supporter((2.0, 4.0), goal) == pytest.approx((2.5 + 1.2, 2.0))
    assert striker(ball, goal) == pytest.approx((3.0, 4.1))
    assert keeper(goal, goal) == striker(goal, goal) == goal
    assert [role_of(name) for name in ("a1", "b2", "a3", "b4", "x")] == [
        "keeper", "supporter", "striker", "keeper", "striker"
    ]  # fmt: skip


def test_a_game_stays_on_the_field_and_moves():
    mission, places = game(12.0, with_pulses(load_scenario("soccer"), "off", "random")), []
    mission.run([lambda m: places.append([m.fleet.position_m(v.number)[:2].copy() for v in m.vehicles])])
    track = np.array(places)
    assert (track > 0.2 - 0.01).all()
    assert (track < np.array([6.0, 9.0]) - 0.2 + 0.01).all()
    apart = np.hypot(*(track[:, :, None] - track[:, None]).transpose(3, 0, 1, 2)) + 9 * np.eye(6)
    assert apart.min() > 0.35  # middles of robots 0.4 m wide; both may move within a tick
    ways = {vehicle.name: vehicle.way_m for vehicle in mission.vehicles}
    assert min(ways["a3"], ways["b3"]) > 2


def test_a_game_is_the_same_whatever_the_threads():
    one, two = game(2.5), game(2.5)
    one.run()
    two.run(threads=2)
    assert one.station.replica.digest() == two.station.replica.digest()
    assert [v.facts() for v in one.vehicles] == [v.facts() for v in two.vehicles]
    assert one.station.places_m == two.station.places_m


# --- the whole map ---------------------------------------------------------------------------------------------------


def test_cells_under_a_disc():
    lattice = Lattice(0.25, 10.0)
    # 0.2 m around a cell's middle reach 0.075 m into its four neighbours, not into those at the corners, whose nearest
    # places are √2 · 0.125 = 0.177 m away: into these, too.
    assert covered(lattice, (0, 0, 3, 3), (0.375, 0.375), 0.2).all()
    cross = covered(lattice, (0, 0, 3, 3), (0.375, 0.375), 0.15)
    assert cross.tolist() == [[False, True, False], [True, True, True], [False, True, False]]
    assert covered(lattice, (1, 1, 2, 2), (0.375, 0.375), 0.01).tolist() == [[True]]


def test_every_robot_s_cell_is_occupied_and_free_cells_are_mostly_free():
    mission = game(9.0)
    study = Game(mission)
    mission.run([study])
    rows = {row[0]: row[1:] for row in study.table().rows}
    samples, own, least, free, undecided, occupied = rows["robots drawn"]
    assert (samples, own, least) == (5, 1.0, 1.0)
    assert free > 0.7
    assert occupied < 0.15
    assert free + undecided + occupied == pytest.approx(1.0)
    assert rows["sonars alone"][1] < 0.6  # a robot's own sonars clear where it stands


def test_drawing_robots_is_a_view_and_no_evidence():
    mission = game(3.0)
    mission.run()
    replica = mission.station.replica
    before = replica.digest()
    drawn, plain = whole_map(replica, FIELD, robots_said(mission)), whole_map(replica, FIELD)
    assert len(robots_said(mission)) == 6
    changed = drawn != np.nan_to_num(plain, nan=-1.0)
    assert (drawn[changed & ~np.isnan(drawn)] == 1.0).all()
    layer = replica.model.occupied
    np.testing.assert_array_equal(plain, mosaic(replica, [layer], FIELD)[layer.name])
    assert replica.digest() == before


def test_a_sub_map_is_one_frame():
    mission = game(3.0)
    mission.run()
    table = frame_table(mission)
    for _, frames, size, error, so, as_deltas in table.rows:
        assert (frames, size) == (1, HEADER.size + 2 * 24 * 36) == (1, 1740)
        assert 0 < error <= 1 / 255
        assert so == pytest.approx(1740 / 0.3)
        assert 0 < as_deltas < 50_000


# --- false echoes ----------------------------------------------------------------------------------------------------


def pair(yaw: float, x: float, time_s: float) -> Ping:
    """A ring of two sonars, ahead and behind, that fire 20 ms apart."""
    sensor = replace(load_sensor("soccer_robot_sonar"), beams=Beams((0.0, pi), (0.0, 0.0)), mounting=Mounting(z_m=0.3))
    c, s = np.cos(yaw), np.sin(yaw)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    return Ping(Sonar(sensor), pose_of(turn, np.array([x, 4.5, 0.0])), time_s, walsh_hadamard()[1])


def test_sonars_that_fire_in_turn_hear_only_what_comes_while_they_listen():
    """Two rings 2 m apart, both looking east: the western one's sonar 0 faces the eastern one's 1. By way of the boards
    it is over 6 m, and too far."""
    caster, ear = RayCaster(soccer_field()), pair(0.0, 4.2, 0.0)

    def heard(time_s: float) -> list[float]:
        return false_echoes(caster, ear, [pair(0.0, 2.2, time_s)], NO_BODIES, "uncoded").tolist()

    # Rounds that begin together: the western 0 fires 20 ms before the eastern 1 listens.
    assert heard(0.0)[1] == np.inf
    # 20 ms later, also two rounds of 40 ms later: after 2/343 s, which reads as half the way.
    assert heard(0.02)[1] == heard(0.10)[1] == pytest.approx(1.0)
    # 3 ms later still: 0.003 · 343 / 2 m more.
    assert heard(0.023)[1] == pytest.approx(1.0 + 0.5145)


@pytest.fixture(scope="module")
def echoes() -> dict[tuple[str, str], tuple]:
    missions = []
    for crosstalk, pulses in (("uncoded", "random"), ("coded", "aligned"), ("coded", "random")):
        missions.append(game(6.0, with_pulses(load_scenario("soccer"), crosstalk, pulses)))
        missions[-1].run()
    return {row[:2]: row[2:] for row in echo_table(missions).rows}


def test_codes_keep_most_false_echoes_out(echoes):
    readings, uncoded, share, deceived = echoes["uncoded", "random"]
    assert readings == 6 * 19 * 16  # six rings of 16; a round each 0.32 s from 0 on, up to 5.9 s
    assert share == uncoded / readings > 0.01
    assert len(deceived.split(", ")) >= 4
    for pulses in ("aligned", "random"):
        assert echoes["coded", pulses][1] < uncoded / 2


def test_what_gets_through_is_between_the_two_codes_that_overlap(echoes):
    for pulses in ("aligned", "random"):
        assert set(echoes["coded", pulses][3].split(", ")) <= {"a3", "b3", "none"}
