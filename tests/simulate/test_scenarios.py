"""Scenario files: what is wrong in them is said with its line and a remedy."""

from __future__ import annotations

import math
from itertools import combinations
from pathlib import Path

import pytest

from terrafuse.errors import InputError
from terrafuse.simulate.mission.engine import Mission
from terrafuse.simulate.mission.parts import sensor_of
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
        ("duration_s: 6", "duration_s: -6", "duration_s = -6: give 0.01 or more"),
        ("duration_s: 6", "duration_s: yes", "give a number"),
        ("side_m: 120", "side_m: -120", "side_m = -120: give 50 or more"),
        ("side_m: 120", "side_m: 1e9", "side_m = 1000000000.0: give 5000 or less"),
        ("side_m: 120", "side_m: '5'", "side_m = '5': give a number"),
        ("side_m: 120", "seed: abc", "seed = 'abc': give a number"),
        ("side_m: 120", "seed: -1", "seed = -1: give 0 or more"),
        ("village, side_m: 120", "dem", "'file' is missing"),
        ("village, side_m: 120", "dem, file: no.tif", "no.tif: there is no such file"),
        ("village, side_m: 120", "dem, file: 5", "file = 5: give a file's name"),
        ("village, side_m: 120", "dem, file: a, bounds: 7", "bounds = 7: give a list"),
        ("village, side_m: 120", "image, file: no.png, resolution_m: fine", "resolution_m = 'fine': give a number"),
        ("{kind: village, side_m: 120}", "village", "world = 'village': give keys: kind"),
        ("duration_s: 6", "duration_s: 1e308", "duration_s = 1e+308: give 1e+06 or less"),
        ("duration_s: 6", "duration_s: 1e-9", "duration_s = 1e-09: give 0.01 or more"),
        ("duration_s: 6", "duration_s: 0.05", "duration_s: 0.05 s are less than a tick; give 0.1 or more"),
        ("duration_s: 6", "duration_s: '6'", "duration_s = '6': give a number"),
        ("duration_s: 6", "seed: 99999999999999999999", "is too large"),
        ("rate_hz: 5", "rate_hz: 1e-300", "rate_hz = 1e-300: give 0.001 or more"),
        ("pose: {kind: filtered}", "pose: {gnss_hz: 1e-300}", "gnss_hz = 1e-300: give 0.001 or more"),
        ("pose: {kind: filtered}", "pose: {odometry: {forward_m: 1e300}}", "forward_m = 1e+300: give 1 or less"),
        *(
            ("report_s: 1", f"{key}: 1e300", f"{key} = 1e+300: give 1e+06 or less")
            for key in ("report_s", "place_s", "latency_s", "jitter_s")
        ),
        ("range_m: 500", "bytes_per_s: 1e-300", "bytes_per_s = 1e-300: give 1 or more"),
        ("range_m: 500", "frame_bytes: 64", "frame_bytes = 64: give 76 or more"),
        ("range_m: 500", "cuts: [{from_s: 3, to_s: 2}]", "to_s: a cut from 3 to 2 s; give a to_s beyond from_s"),
        ("range_m: 500", "cuts: {from_s: 3}", "give a list"),
        ("resolution_m: 0.5", "resolution_m: 1e300", "resolution_m = 1e+300: give 100 or less"),
        ("resolution_m: 0.5", "resolution_m: 1e-300", "resolution_m = 1e-300: give 0.001 or more"),
        ("prior_building_height_m: 10", "prior_building_height_m: 1e300", "give 1000 or less"),
        ("count: 2", "count: 2\n    places: [[1e308, 0, 0]]", "places.0.0 = 1e+308: give 1e+08 or less"),
        ("count: 2", "count: 2\n    places: [[0, 0]]", "places.0 has 2 values, too few"),
        ("count: 2", "count: 2\n    places: [[0, 0, 0, 0]]", "give 3 of them at most"),
        ("count: 2", "count: 2\n    places: [[0, 0, 0], [9, 0, 0], [0, 9, 0]]", "3 places for 2 robots"),
        ("count: 2", "spread: 1", "spread = 1: give true or false"),
        ("kind: patrol", "kind: patrol, waypoints_m: [[0, 1e308]]", "waypoints_m.0.1 = 1e+308: give 1e+08 or less"),
        ("kind: patrol", "kind: patrol, occupied_from: 7", "occupied_from = 7: give 1 or less"),
        ("kind: patrol", "kind: patrol, radius_m: 500", "radius_m = 500: give 5 or less"),
        ("kind: patrol", "kind: patrol, speed_mps: 1e300", "speed_mps = 1e+300: give 100 or less"),
        ("model: terrain", "model: terrain\n  settings: {subcells: 1.5}", "subcells 1.5: give a whole number"),
        ("model: terrain", "model: elevation\n  settings: {static: 17}", "static 17: give true or false"),
        ("description:\n          name: small", "description: nowhere.yaml\n        foo:", "there is no key 'foo'"),
        ("max_range_m: 15", "max_rang_m: 15", "mounting; did you mean max_range_m?"),
        (
            "max_range_m: 15",
            "max_range_m: 1e300",
            "max_range_m = 1e+300: input should be less than or equal to 1000000",
        ),
        ("z_m: 1.2", "z_m: 1e300", "mounting.z_m = 1e+300: input should be less than or equal to 1000"),
        ("count: 2", "altitude_m: 50", "a summit_xl does not fly; leave it out, or take a drone"),
        ("kind: lidar", "kind: lidarr", "kind = 'lidarr': give 'lidar' or 'sonar'"),
        ("side_m: 120", "size: 120", "there is no key 'size' here"),
        ("kind: village", "kind: town", "world 'town'; there are village"),
        ("count: 2", "count: 0", "robots.0.count = 0: give 1 or more"),
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


@pytest.mark.parametrize(
    ("old", "new", "at", "says"),
    [
        ("kind: lidar", "kind: sonar", "description", "the sensor small has rays; a sonar needs cone_half_angle_deg"),
        ("          ring: ", "          # ring: ", "description", "the sensor small has no beams; give it a 'ring'"),
        (
            "model: terrain",
            "model: occupancy",
            "prior",
            "can't be told what is known beforehand; leave it out, or take",
        ),
        ("0.5\n  tile_m: 10", "100\n  tile_m: 1000", "prior", "gives no cell of this map.*; leave it out, or take"),
        ("village, side_m: 120", "hallway", "prior", "this world has no buildings"),
        ("model: terrain", "model: grey\n  # ", "kind: lidar", "the model 'grey' is for sonars"),
    ],
)
def test_parts_that_do_not_go_together(old: str, new: str, at: str, says: str, tmp_path: Path) -> None:
    text = SMALL.replace(old, new, 1)
    if "'grey'" in says:
        text = text.replace("prior_building_height_m: 10", "# no prior")
    with pytest.raises(InputError, match=says) as caught:
        Mission(small(text), folder=tmp_path)
    line = next(number for number, one in enumerate(text.splitlines(), 1) if at in one)
    assert str(caught.value).startswith(f"small.yaml:{line}:")


FIELD = """
duration_s: 1
world: {kind: soccer_field}
robots:
  - body: soccer
    count: 4
    behaviour: {kind: wander}
    sensors: [{kind: sonar, description: soccer_robot_sonar}]
map: {model: grey, resolution_m: 0.25, tile_m: 10}
"""


def starts(text: str) -> list[tuple[float, float]]:
    mission = Mission(read_scenario(text, "f.yaml", "f", Path()))
    return [tuple(mission.fleet.position_m(number)[:2].tolist()) for number in range(len(mission.vehicles))]


def apart(places: list[tuple[float, float]]) -> float:
    return min(math.dist(one, other) for one, other in combinations(places, 2))


def test_robots_without_places_begin_on_free_ground_where_there_are_no_streets() -> None:
    """Soccer robots are 0.4 m wide."""
    places = starts(FIELD)
    assert apart(places) > 0.4
    assert all(0.2 < x < 5.8 and 0.2 < y < 8.8 for x, y in places)


@pytest.mark.parametrize(("defends", "least", "most"), [("south", 0.0, 4.5), ("north", 4.5, 9.0)])
def test_players_begin_in_their_own_half(defends: str, least: float, most: float) -> None:
    text = FIELD.replace("kind: wander", f"kind: soccer, defends: {defends}").replace(
        "count: 4", "count: 4\n    places: [[3, 4.5, 0]]"
    )
    first, *others = starts(text)
    assert first == (3, 4.5)
    assert apart([first, *others]) > 0.4
    assert all(least < y < most for _, y in others)


def test_more_robots_than_a_corridor_holds_begin_in_the_rooms() -> None:
    text = FIELD.replace("soccer_field", "hallway").replace("count: 4", "count: 20").replace("0.25", "0.1")
    places = starts(text)
    assert apart(places) > 0.4
    assert all(0 < x < 30 and 0 < y < 20 for x, y in places)


def test_a_full_world_says_so() -> None:
    with pytest.raises(InputError, match=r"f.yaml:5: no free place for r\d+; take fewer robots"):
        starts(FIELD.replace("count: 4", "count: 200"))


def test_a_description_lies_beside_its_scenario(tmp_path: Path) -> None:
    (tmp_path / "own.yaml").write_text(
        "name: own\nmax_range_m: 3\nring: {count: 8}\ncone_half_angle_deg: 10\nrange_error_m: 0.1\n"
    )
    loaded = read_scenario(FIELD.replace("soccer_robot_sonar", "own.yaml"), "f.yaml", "f", tmp_path)
    assert sensor_of(loaded, 0, 0).name == "own"
    with pytest.raises(InputError, match=r"f.yaml:8: sensor 'own.yaml': neither a file nor a preset"):
        sensor_of(read_scenario(FIELD.replace("soccer_robot_sonar", "own.yaml"), "f.yaml", "f", Path()), 0, 0)


@pytest.mark.parametrize("node", ["r3", "staton"])
def test_cuts_are_of_nodes_that_there_are(node: str) -> None:
    with pytest.raises(InputError, match=f"small.yaml:13: .*no node '{node}'; there are r1, r2, station"):
        small(SMALL.replace("radio: {", f"radio: {{cuts: [{{from_s: 1, to_s: 2, node: {node}}}], "))


def test_numbers_of_robots_and_other_changes() -> None:
    assert with_robots(small(), 5).scenario.robots[0].count == 5
    assert changed(small(), seed=4, duration_s=None).scenario.seed == 4
    with pytest.raises(InputError, match="0 robots: give 1 to 1000"):
        with_robots(small(), 0)
    assert len(with_robots(load_scenario("soccer"), 1).scenario.robots[0].places) == 1
    with pytest.raises(InputError, match="duration_s = -1"):
        changed(small(), duration_s=-1.0)


def test_an_unknown_scenario_names_those_that_there_are() -> None:
    with pytest.raises(InputError, match=r"'vilage': neither a file nor one of .*village"):
        load_scenario("vilage")
