"""Patrols that go straight along their route."""

from __future__ import annotations

import numpy as np

from terrafuse.simulate.mission.behaviours.patrol import Patrol, PatrolSettings
from terrafuse.simulate.mission.situation import Situation
from terrafuse.simulate.motion import BODIES
from terrafuse.types import Pose


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
