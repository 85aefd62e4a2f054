"""Patrols: straight along their route, and over their map."""

from __future__ import annotations

import numpy as np

from terrafuse.lattice import Lattice
from terrafuse.navigate import Robot
from terrafuse.navigate.costs import CostMap, priced
from terrafuse.simulate.mission.behaviours.patrol import Patrol, PatrolSettings
from terrafuse.simulate.mission.situation import Situation
from terrafuse.simulate.motion import BODIES
from terrafuse.types import Bounds, Pose


def straight(*waypoints: tuple[float, float]) -> tuple[Patrol, Situation]:
    settings = PatrolSettings(planned=False, waypoints_m=waypoints, patience_s=1)
    return Patrol(settings, np.random.default_rng(0)), Situation("r1", BODIES["summit_xl"])


def test_a_route_that_ends_where_it_begins_is_driven() -> None:
    patrol, me = straight((10.0, 0.0), (0.5, 0.0))
    assert patrol.drive(me).speed_mps > 0
    assert patrol.facts()["goals_left"] == 2


def test_what_stands_in_the_way_makes_it_wait_and_leaves_the_route_whole() -> None:
    patrol, me = straight((10.0, 0.0), (10.0, 10.0))
    patrol.drive(me)
    me.stopped = True
    for me.now_s in (0.1, 2.0):
        assert patrol.drive(me).speed_mps <= 0
    assert patrol.facts()["detours"] == 1
    me.stopped, me.now_s = False, 10.0
    me.T_world_base = Pose.identity().shifted(-0.5, 0.0)
    assert patrol.drive(me).speed_mps > 0
    assert patrol.facts()["goals_left"] == 2


class Seen(Situation):
    """Knows a field of 60 m × 60 m around the origin, and on it what `occupied` says."""

    def hem_in(self, wall: bool) -> None:
        """A wall of a cell around where it stands."""
        self.occupied = np.zeros((120, 120))
        self.occupied[50:71, 50:71] = float(wall)
        self.occupied[51:70, 51:70] = 0.0

    def costs(self, robot: Robot, bounds: Bounds) -> CostMap:
        lattice = Lattice(0.5, 30.0)
        return CostMap(priced(self.occupied, None, robot, 0.5), np.zeros((120, 120), bool), lattice, -60, -60)


def test_who_is_hemmed_in_keeps_its_route_and_goes_on_when_it_can() -> None:
    settings = PatrolSettings(waypoints_m=((20.0, 0.0), (20.0, 20.0), (0.0, 20.0), (-20.0, 0.0)), patience_s=1)
    patrol, me = Patrol(settings, np.random.default_rng(0)), Seen("r1", BODIES["summit_xl"])
    me.hem_in(True)
    for me.now_s in np.arange(0, 5, 0.1).tolist():
        assert patrol.drive(me).speed_mps <= 0
    assert patrol.facts()["goals_left"] == 4
    me.hem_in(False)
    me.now_s = 20.0
    assert patrol.drive(me).speed_mps > 0
    assert patrol.facts() == {**patrol.facts(), "left_out": 0, "goals_left": 4}


def test_a_waypoint_to_which_no_way_leads_is_left_out_for_the_next() -> None:
    settings = PatrolSettings(waypoints_m=((20.0, 0.0), (-20.0, 0.0)))
    patrol, me = Patrol(settings, np.random.default_rng(0)), Seen("r1", BODIES["summit_xl"])
    me.hem_in(False)
    me.occupied[:, 70:] = 1.0  # all from x = 5 m on
    assert patrol.drive(me).speed_mps != 0 or patrol.drive(me).yaw_rate_radps != 0
    assert patrol.facts() == {**patrol.facts(), "left_out": 1, "goals_left": 1}


def test_the_last_waypoint_is_left_out_after_some_tries() -> None:
    settings = PatrolSettings(waypoints_m=((20.0, 0.0),), patience_s=1)
    patrol, me = Patrol(settings, np.random.default_rng(0)), Seen("r1", BODIES["summit_xl"])
    me.hem_in(True)
    for me.now_s in np.arange(0, 30, 0.5).tolist():
        patrol.drive(me)
    assert patrol.facts() == {**patrol.facts(), "left_out": 1, "goals_left": 0}
