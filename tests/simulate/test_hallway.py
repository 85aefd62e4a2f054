"""The hallway's study: shares of the floor, claims of windows, pauses; and that windows page, and change no map."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest

from terrafuse.simulate.mission.engine import Mission, lattice_of, model_of
from terrafuse.simulate.mission.studies.hallway import Growth, pause_table, sweep, window_table
from terrafuse.simulate.scenario import Loaded, load_scenario, with_robots
from terrafuse.store.sqlite import SqliteStore


def hallway(duration_s: float, robots: int, window: str | None = None) -> Loaded:
    loaded = with_robots(load_scenario("hallway"), robots)
    part = loaded.scenario.map.model_copy(update={"window": window or loaded.scenario.map.window})
    return replace(loaded, scenario=loaded.scenario.model_copy(update={"duration_s": duration_s, "map": part}))


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory):
    loaded = hallway(60.0, 2)
    path: Path = tmp_path_factory.mktemp("hallway") / "map.db"
    mission = Mission(loaded, SqliteStore.create(path, lattice_of(loaded), model_of(loaded)))
    growth = Growth(mission)
    mission.run([growth])
    yield mission, growth
    mission.store.close()


def test_the_floor_fills(ended):
    _, growth = ended
    shares = [share for _, share in growth.rows]
    assert all(b >= a for a, b in pairwise(shares))
    # Two robots see some 3 m wide at up to 0.5 m/s: no more than 2 · 60 s · 1.5 m²/s of 552 m², and their first discs.
    assert 0.03 < shares[-1] < 0.37
    assert growth.reached_s(0.9) is None
    assert growth.reached_s(shares[2]) == growth.rows[2][0]
    assert "was not reached" in growth.table().note


def test_both_windows_are_held_against_the_same_scans(ended):
    mission, _ = ended
    table = window_table(mission)
    rows = {(row[0], row[1]): row for row in table.rows}
    assert set(rows) == {(name, window) for name in ("r1", "r2") for window in ("nine_block", "radius")}
    for vehicle in mission.vehicles:
        nine, radius = rows[vehicle.name, "nine_block"], rows[vehicle.name, "radius"]
        own = vehicle.mapper.allocation()
        assert (nine[2], nine[4]) == (9 * 2500, own.observed_cells)  # nine blocks of 50 × 50 cells
        assert radius[3] == own.window_cells  # what its own window claimed as it went
        assert nine[3] > radius[3] >= nine[6] == own.allocated_cells
        assert 0 < nine[5] < radius[5] <= radius[7] <= 1


def test_windows_page_and_robots_hardly_pause(ended):
    mission, _ = ended
    for row in pause_table([mission]).rows:
        _, _, window, longest_ms, mean_ms, round_ms, missed, written, _, commits, _ = row
        assert window == "radius"
        assert round_ms == pytest.approx(200)
        assert 0 < mean_ms
        assert missed == int(longest_ms // round_ms)
        assert min(written, commits) > 0


def test_a_window_changes_no_map():
    digests = set()
    for window in ("nine_block", "radius?range_m=1.5&period_s=0.2&speed_mps=0.5", "all"):
        mission = Mission(hallway(15.0, 1, window))
        mission.run()
        digests.add(mission.station.replica.digest())
    assert len(digests) == 1


def test_a_sweep_has_a_row_for_each_fleet_and_window():
    told: list[str] = []
    fleets, pauses = sweep(hallway(1.0, 3), fleets=(1, 2), longest_s=8.0, tell=told.append)
    assert told == ["1 robots, radius", "2 robots, radius", "2 robots, nine_block"]
    assert [row[:2] for row in fleets.rows] == [(1, "radius"), (2, "radius"), (2, "nine_block")]
    assert fleets.rows[1][-1] == fleets.rows[2][-1] != fleets.rows[0][-1]
    assert [row[2] for row in fleets.rows] == [None, None, None]  # 90 % takes longer than 8 s
    assert len(pauses.rows) == 1 + 2 + 2
