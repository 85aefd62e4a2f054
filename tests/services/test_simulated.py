"""A simulated robot as a source senses what it senses in the whole mission."""

from __future__ import annotations

from pathlib import Path

import pytest

from terrafuse import mapping
from terrafuse.config import map_settings
from terrafuse.errors import InputError
from terrafuse.logs import open_log
from terrafuse.replica import Replica
from terrafuse.services.simulated import source_text
from terrafuse.store.sqlite import SqliteStore

pytest.importorskip("embreex")
pytest.importorskip("rasterio")

SCENARIO = """
duration_s: 1.0
tick_s: 0.1
world: {kind: village, side_m: 200}
map: {model: elevation, resolution_m: 0.5}
robots:
  - count: 2
    sensors:
      - {kind: lidar, rate_hz: 5, description: {name: little, max_range_m: 30, ring: {count: 90, step_deg: 4,
         elevations_deg: [-20, -10]}, mounting: {z_m: 1.0}}}
    behaviour: {kind: patrol}
"""


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    path = tmp_path / "little.yaml"
    path.write_text(SCENARIO)
    return path


def test_its_map_is_that_of_the_mission(scenario: Path, tmp_path: Path) -> None:
    from terrafuse.simulate.mission.engine import Mission
    from terrafuse.simulate.scenario import load_scenario

    settings = map_settings(resolution_m=0.5)
    run = mapping.plan({"r2": source_text(f"{scenario}/r2", "r2")}, settings)
    with SqliteStore.create(tmp_path / "own.db", run.lattice, run.model) as own:
        reports = mapping.map_logs(run, own)
        mission = Mission(load_scenario(scenario))
        mission.run()
        assert reports["r2"].scans == 5  # 1 s at 5 Hz
        whole = Replica(store=mission.store, only=["r2"])
        assert Replica(store=own).digest() == whole.digest()


def test_texts_that_are_no_scenario_stay(tmp_path: Path) -> None:
    (tmp_path / "village").mkdir()
    (tmp_path / "village" / "r1").touch()
    for text in ("drive.mcap?topic=/points", "folder/r1", str(tmp_path / "village/r1")):
        assert source_text(text, "r1") == text


def test_a_scenario_alone_is_the_robot_of_the_nodes_name() -> None:
    assert "village.yaml?reader=scenario&robot=r1&robots=3" in source_text("village/r1?robots=3", "r2")
    assert "village.yaml?reader=scenario&robot=r2&robots=3" in source_text("village?robots=3", "r2")


def test_a_robot_that_is_not_there(scenario: Path) -> None:
    with pytest.raises(InputError, match=r"no robot 'r3' in it; there are r1, r2"):
        open_log(source_text(f"{scenario}/r3", "r1"))
    with pytest.raises(InputError, match=r"\?robots=many: give a number"):
        open_log(source_text(f"{scenario}/r3?robots=many", "r1"))
