"""Paths in the world: over drawn maps, after the map has changed, and across a real building."""

from __future__ import annotations

from math import sqrt
from pathlib import Path as File
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from terrafuse import views
from terrafuse.errors import InputError, NoPath
from terrafuse.lattice import Lattice
from terrafuse.logs import open_log
from terrafuse.models import make_model
from terrafuse.navigate import Path, Robot, cost_map, first_blocked, path_between, plan, plan_path, still_good
from terrafuse.replica import Replica
from terrafuse.testing.deltas import deltas_of
from terrafuse.types import Bounds, Floats, Scan
from tests.navigate.drawn import letters, occupancy_map, reported

POINT = Robot(radius_m=0.0, keep_away_m=0.0, occupied_price=0.0)
SMALL = Robot(radius_m=0.2)

ROOMS = """
    .......
    ...#...
    ...#...
    ...#...
    ...#...
"""


def test_a_path_by_hand() -> None:
    """Cells of half a metre; the wall leaves row 4 free. From (0, 0) to (2, 4) 2 diagonals and 2 straight steps, 2
    along to (4, 4), and down as it came up: 6 + 4√2 cells."""
    path = plan_path(occupancy_map(ROOMS, 0.5), (0.25, 0.25), (3.1, 0.4), POINT)
    assert path.length_m == pytest.approx(0.5 * (6 + 4 * sqrt(2)))
    assert path.cost_m == pytest.approx(path.length_m)
    assert path.unknown_m == 0.0
    assert path.waypoints_m[0].tolist() == [0.25, 0.25]
    assert path.waypoints_m[-1].tolist() == [3.25, 0.25]
    assert len(path.cells) == 11
    assert [2, 4] in path.cells.tolist()
    assert [4, 4] in path.cells.tolist()


def test_at_any_angle_it_is_shorter() -> None:
    """In cells from (0, 0) to (2, 4): √20 in one line instead of 2√2 + 2, and as much down again; 2 along."""
    ways = [plan_path(occupancy_map(ROOMS, 0.5), (0.25, 0.25), (3.25, 0.25), POINT, any_angle=a) for a in (False, True)]
    assert ways[1].length_m == pytest.approx(0.5 * (2 + 2 * sqrt(20)))
    assert ways[1].waypoints_m.tolist() == [[0.25, 0.25], [1.25, 2.25], [2.25, 2.25], [3.25, 0.25]]
    assert ways[1].cost_m < ways[0].cost_m


def test_the_robots_width_closes_doors() -> None:
    """A door of one metre between walls: 0.5 m to either side of its middle."""
    house = occupancy_map("..#.. ..#.. ..... ..#.. ..#..")
    through = (0.5, 0.5), (4.5, 0.5)
    assert plan_path(house, *through, Robot(0.5)).length_m > 4
    with pytest.raises(NoPath, match="no way leads") as raised:
        plan_path(house, *through, Robot(0.51))
    assert raised.value.facts["reason"] == "not_connected"


@pytest.mark.parametrize(
    ("unknown", "unknown_m", "length"), [("free", 2.0, 3.0), ("avoid", 0.0, 1 + 2 * sqrt(2)), ("forbid", 0.0, 5.0)]
)
def test_the_unknown_is_gone_through_only_where_that_is_wanted(unknown: Any, unknown_m: float, length: float) -> None:
    """Straight on through 2 cells of unknown ground, or past them; where it is forbidden, its corners are not cut."""
    robot = Robot(0.0, unknown, keep_away_m=0.0, occupied_price=0.0)
    path = plan_path(occupancy_map(".??. ...."), (0.5, 1.5), (3.5, 1.5), robot)
    assert path.unknown_m == pytest.approx(unknown_m)
    assert path.length_m == pytest.approx(length)


def test_dear_unknown_ground_is_crossed_where_there_is_no_other() -> None:
    """½ + 4·2 + ½, the robot stepping from the middle of a free cell over two of them."""
    robot = Robot(0.0, "avoid", keep_away_m=0.0, occupied_price=0.0)
    path = plan_path(occupancy_map(".??."), (0.5, 0.5), (3.5, 0.5), robot)
    assert (path.cost_m, path.unknown_m) == (pytest.approx(9.0), pytest.approx(2.0))
    with pytest.raises(NoPath):
        plan_path(occupancy_map(".??."), (0.5, 0.5), (3.5, 0.5), Robot(0.0, "forbid"))


def test_complaints_are_in_metres() -> None:
    house = occupancy_map(ROOMS, 0.5)
    with pytest.raises(NoPath, match=r"start 1\.6,0\.1 lies in an obstacle to the robot; .* is 1\.25,0\.25"):
        plan_path(house, (1.6, 0.1), (0, 0), POINT)
    with pytest.raises(NoPath, match=r"goal 9,0 lies outside the map, whose cells go from 0\.25,0\.25 to 3\.25,2\.25"):
        plan_path(house, (0, 0), (9, 0), POINT)
    for nowhere in (float("nan"), float("inf"), 1e300):
        with pytest.raises(InputError, match="places on Earth"):
            plan_path(house, (0, 0), (nowhere, 0), POINT)


def test_bounds_keep_the_path_in() -> None:
    house, start, goal = occupancy_map(ROOMS, 0.5), (0.25, 0.25), (3.25, 0.25)
    with pytest.raises(NoPath, match="no way leads"):
        plan_path(house, start, goal, POINT, Bounds(0, 0, 3.5, 2.0))
    beyond = plan_path(house, (0.25, 0.25), (-3, 0.25), POINT, Bounds(-4, 0, 3.5, 2.0))
    assert beyond.unknown_m == pytest.approx(2.75)  # from x = 0 to the centre of the cell from -3 to -2.5


def checked(path: Path, robot: Robot, drawing: str) -> tuple[int | None, bool]:
    costs = cost_map(occupancy_map(drawing), robot)
    return first_blocked(path, costs), still_good(path, costs)


def test_a_changed_map_breaks_a_path() -> None:
    """Straight along the lower row, or the diagonal past a cell."""
    path = plan_path(occupancy_map("..... ....."), (0.5, 0.5), (4.5, 0.5), POINT)
    assert checked(path, POINT, "..... .....") == (None, True)
    assert checked(path, POINT, ".###. .....") == (None, True)
    assert checked(path, POINT, "..... ...#.") == (3, False)
    assert checked(path, POINT, "..... #..#.") == (0, False)
    costs = cost_map(occupancy_map("..... #..#."), POINT)
    assert first_blocked(path, costs, since=1) == 3
    assert first_blocked(path, costs, since=4) is None
    wider = Robot(0.6, keep_away_m=0.0)
    assert checked(path, wider, "...#. .....") == (3, False)


def test_so_does_a_corner_that_it_would_cut() -> None:
    path = plan_path(occupancy_map(".. .."), (0.5, 0.5), (1.5, 1.5), POINT)
    assert len(path.cells) == 2
    for drawing in ("#. ..", ".. .#"):
        assert checked(path, POINT, drawing) == (1, False)


def test_of_what_lies_beyond_the_window_nothing_is_said() -> None:
    path = plan_path(occupancy_map("....."), (0.5, 0.5), (4.5, 0.5), POINT)
    now = occupancy_map(".#..#")
    assert first_blocked(path, cost_map(now, POINT, Bounds(2, 0, 4, 1))) is None
    assert first_blocked(path, cost_map(now, POINT, Bounds(2, 0, 5, 1))) == 4


def test_a_robot_plans_again_when_it_hears_of_a_wall() -> None:
    """The same replica, before and after another delta: then down, 2 along, and up again."""
    replica = occupancy_map("..... ..... .....")
    path = plan_path(replica, (0.5, 1.5), (4.5, 1.5), POINT)
    replica.apply(reported(letters("..... ..#.. ....."), replica.lattice, revision=2))
    costs = cost_map(replica, POINT)
    assert not still_good(path, costs)
    again = path_between(costs, (0.5, 1.5), (4.5, 1.5))
    assert still_good(again, costs)
    assert again.length_m == pytest.approx(2 + 2 * sqrt(2))


@st.composite
def drawings(draw: st.DrawFn) -> str:
    width, height = draw(st.integers(2, 12)), draw(st.integers(2, 12))
    rows = [draw(st.text("....#?", min_size=width - 2, max_size=width - 2)) for _ in range(height - 2)]
    return " ".join(["." * width, *(f".{row}." for row in rows), "." * width])


@given(drawings(), st.sampled_from([POINT, SMALL, Robot(0.0, "free"), Robot(0.6, "forbid")]), st.booleans())
def test_what_holds_of_every_path(drawing: str, robot: Robot, any_angle: bool) -> None:
    """Its cost is that of the search (at any angle no more), its cells are free, and its figures add up."""
    drawn = letters(drawing)
    costs = cost_map(occupancy_map(drawing), robot)
    start, goal = (0, 0), (drawn.shape[1] - 1, drawn.shape[0] - 1)
    try:
        found = plan(costs.costs, start, goal)
    except NoPath:
        return
    path = path_between(costs, (0.5, 0.5), (goal[0] + 0.5, goal[1] + 0.5), any_angle)
    assert still_good(path, costs)
    legs = np.hypot(*np.diff(path.waypoints_m, axis=0).T)
    assert path.length_m == pytest.approx(legs.sum())
    assert 0 <= path.unknown_m <= path.length_m <= path.cost_m * (1 + 1e-9)
    if any_angle:
        assert path.cost_m <= found.cost * (1 + 1e-8)
    else:
        assert path.cost_m == pytest.approx(found.cost)
        np.testing.assert_array_equal(path.cells, found.cells)


@pytest.fixture(scope="module")
def intel(recordings: File) -> tuple[Replica, Floats]:
    """(an occupancy map of offices, where the robot drove)."""
    log = f"{recordings}/lidar2d/ple_corrected/intel-corrected.log.gz?backwards=drop"
    scans = [record for record in open_log(log).scans() if isinstance(record, Scan)]
    lattice, model = Lattice(0.1), make_model("occupancy")
    replica = Replica(lattice, model)
    for delta in deltas_of("r1", scans, lattice, model, every=len(scans)):
        replica.apply(delta)
    return replica, np.array([scan.T_world_sensor.position[:2] for scan in scans])


def test_across_a_real_building(intel: tuple[Replica, Floats]) -> None:
    """Between the two ends of the robot's drive, for robots of three widths."""
    replica, drove = intel
    south_west, north_east = drove[drove.sum(axis=1).argmin()], drove[drove.sum(axis=1).argmax()]
    drive_m = float(np.hypot(*np.diff(drove, axis=0).T).sum())
    obstacles_m = obstacles(replica)
    costs_m = []
    for radius_m in (0.1, 0.2, 0.3):
        costs = cost_map(replica, Robot(radius_m, "forbid"))
        path = path_between(costs, tuple(south_west.tolist()), tuple(north_east.tolist()), any_angle=True)
        assert still_good(path, costs)
        assert path.unknown_m == 0
        assert np.hypot(*(north_east - south_west)) < path.length_m < drive_m
        # Centres of its cells keep radius + r/2; the line may leave a centre by r/√2.
        assert gap_m(path, obstacles_m) >= radius_m + 0.05 - 0.0708
        costs_m.append(path.cost_m)
    assert costs_m == sorted(costs_m)


def obstacles(replica: Replica) -> Floats:
    """Centres (N, 2) of the obstacles' cells."""
    layer, window = replica.model.occupied, views.window_of(replica, None)
    j, i = np.nonzero(views.mosaic(replica, [layer], window)[layer.name] >= 0.65)
    return np.asarray(replica.lattice.cell_centre(np.column_stack([i + window[0], j + window[1]])))


def gap_m(path: Path, obstacles_m: Floats) -> float:
    """The least distance of points every 5 cm of a path from obstacles."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path.waypoints_m, axis=0).T))])
    at = np.arange(0.0, along[-1], 0.05)
    points = np.column_stack([np.interp(at, along, axis) for axis in path.waypoints_m.T])
    return float(min(np.hypot(*(obstacles_m - point).T).min() for point in points))
