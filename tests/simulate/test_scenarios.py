"""Scenario files: what is wrong in them is said with its line and a remedy."""

from __future__ import annotations

from pathlib import Path

import pytest

from terrafuse.errors import InputError
from terrafuse.simulate.mission.engine import Mission
from terrafuse.simulate.scenario import load_scenario, scenario_names, with_robots
from terrafuse.simulate.scenario.read import changed, read_scenario
from tests.simulate.missions import SMALL, small


@pytest.mark.parametrize("name", scenario_names())
def test_what_ships_is_sound(name: str) -> None:
    loaded = load_scenario(name)
    assert loaded.scenario.title
    assert loaded.scenario.study in {"map", name}
    assert loaded.world.bounds


def refusal(old: str, new: str, tmp_path: Path) -> str:
    assert old in SMALL
    with pytest.raises(InputError) as caught:
        Mission(small(SMALL.replace(old, new, 1)), folder=tmp_path)
    return str(caught.value)


def line_of(text: str) -> int:
    return SMALL[: SMALL.index(text)].count("\n") + 1


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("duration_s", "duration", "there is no key 'duration' here; did you mean 'duration_s'?"),
        ("duration_s: 6", "duration_s: -6", "duration_s = -6: input should be greater than 0"),
        ("duration_s: 6", "duration_s: yes", "give a number"),
        ("side_m: 120", "side_m: -120", "-120"),
        ("side_m: 120", "size: 120", "there is no key 'size' here"),
        ("kind: village", "kind: town", "world 'town'; there are village"),
        ("count: 2", "count: 0", "robots.0.count = 0: input should be greater than or equal to 1"),
        ("model: terrain", "model: terain", "terain"),
        ("resolution_m: 0.5", "resolution_m: 0.7", "0.7"),
        ("max_range_m: 15", "max_range_m: -1", "max_range_m = -1"),
        ("kind: patrol", "kind: patrole", "behaviour 'patrole'; there are"),
        ("kind: patrol", "kind: patrol, sped_mps: 3", "there is no key 'sped_mps' here"),
        ("kind: patrol", "kind: patrol, waypoints_m: [[900, 0]]", "waypoint (900.0, 0.0) of r1 lies off the world"),
        ("count: 2", "count: 2\n    places: [[900, 0, 0]]", "r1 at 900,0: something stands in its place"),
        ("range_m: 500", "range_km: 5", "there is no key 'range_km' here"),
    ],
)
def test_what_is_wrong_is_said_with_its_line(old: str, new: str, says: str, tmp_path: Path) -> None:
    message = refusal(old, new, tmp_path)
    assert says in message
    line = line_of(old) + new.count("\n")
    assert message.startswith(f"small.yaml:{line}:"), message


def test_a_robot_in_a_house_and_a_waypoint_in_one(tmp_path: Path) -> None:
    house = small().world.houses[0]
    place = f"[{house.x_m:.2f}, {house.y_m:.2f}"
    assert "something stands in its place" in refusal("count: 2", f"count: 2\n    places: [{place}, 0]]", tmp_path)
    there = f"kind: patrol, waypoints_m: [{place}]]"
    assert "lies in something that stands there; move it" in refusal("kind: patrol", there, tmp_path)


def test_two_kinds_of_robots_need_names_of_their_own(tmp_path: Path) -> None:
    text = SMALL + SMALL[SMALL.index("  - count: 2") :]
    with pytest.raises(InputError, match="two robots are called r1"):
        Mission(read_scenario(text, "small.yaml", "small", Path()), folder=tmp_path)


def test_a_walled_in_waypoint_can_not_be_reached(tmp_path: Path) -> None:
    """A place outside the office's outer wall."""
    text = """
duration_s: 1
world: {kind: hallway}
robots:
  - body: nomad
    places: [[6, 10, 0]]
    behaviour: {kind: patrol, waypoints_m: [[24, 10], [-0.8, 10]]}
    sensors: [{kind: sonar, description: nomad_200_sonar}]
map: {model: occupancy, resolution_m: 0.1}
"""
    with pytest.raises(InputError, match=r"walls.yaml:7: waypoint .* of r1 can't be reached"):
        Mission(read_scenario(text, "walls.yaml", "walls", Path()), folder=tmp_path)


def test_numbers_of_robots_and_other_changes() -> None:
    assert with_robots(small(), 5).scenario.robots[0].count == 5
    assert changed(small(), seed=4, duration_s=None).scenario.seed == 4
    with pytest.raises(InputError, match="0 robots: give 1 to 1000"):
        with_robots(small(), 0)
    with pytest.raises(InputError, match="duration_s = -1"):
        changed(small(), duration_s=-1.0)


def test_an_unknown_scenario_names_those_that_there_are() -> None:
    with pytest.raises(InputError, match=r"'vilage': neither a file nor one of .*village"):
        load_scenario("vilage")
