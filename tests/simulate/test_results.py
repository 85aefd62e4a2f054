"""What a mission leaves behind: the same bytes for the same seed, files that open, and logs that make the same map."""

from __future__ import annotations

import json
import math
import shlex
from pathlib import Path
from typing import Any

import pytest

from terrafuse.errors import InputError, OutputError
from terrafuse.replica import Replica
from terrafuse.simulate.mission.recording import map_command
from terrafuse.simulate.mission.results import WORKSHOP, run
from terrafuse.simulate.mission.studies import STUDIES, Study
from terrafuse.simulate.mission.tables import Table
from terrafuse.simulate.scenario import with_robots
from terrafuse.simulate.scenario.read import changed, read_scenario
from terrafuse.store.sqlite import SqliteStore
from tests.program import terrafuse
from tests.simulate.missions import SMALL, small

Image = pytest.importorskip("PIL.Image")
for module in ("embreex", "rasterio", "matplotlib", "mcap", "rosbags"):
    pytest.importorskip(module)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """A recorded mission: its folder and its report."""
    out = tmp_path_factory.mktemp("mission") / "out"
    return out, run(small(), out, record=True)


def untimed(report: dict[str, Any]) -> str:
    return json.dumps({key: value for key, value in report.items() if key not in ("timings", "files")})


def test_every_file_of_the_report_is_there(recorded: tuple[Path, dict[str, Any]]) -> None:
    out, report = recorded
    assert sorted(report["files"].values()) == sorted(file.name for file in out.iterdir())
    assert {"map.db", "map.tif", "film.gif", "world.png", "map.png", "r1.png", "r2.png", "global.png", "report.html",
            "r1.mcap", "prior.geojson"} <= set(report["files"].values())  # fmt: skip
    assert json.loads((out / "report.json").read_text()) == report


def test_same_seed_same_bytes_also_with_two_threads(recorded: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    out, report = recorded
    for name, threads in (("again", 1), ("threads", 2)):
        other = run(small(), tmp_path / name, threads=threads)
        assert untimed(other) == untimed(report)
        for file in ("film.gif", "world.png", "map.png", "r1.png", "global.png", "map.tif"):
            assert (tmp_path / name / file).read_bytes() == (out / file).read_bytes(), file


def test_another_seed_is_another_map(recorded: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    other = run(changed(small(), seed=1), tmp_path / "other")
    assert other["map"]["digest"] != recorded[1]["map"]["digest"]
    assert other["world"]["digest"] != recorded[1]["world"]["digest"]


def test_all_times_and_memory_are_under_one_key(recorded: tuple[Path, dict[str, Any]]) -> None:
    report = recorded[1]
    assert {"simulate", "pictures"} <= set(report["timings"]["stages_s"])
    stages = report["timings"]["robots_s"]["r1"]
    assert {"simulate", "map", "exchange", "decide", "observe", "merge", "coarsen"} <= set(stages)
    assert all(seconds >= 0 for seconds in stages.values())
    assert report["timings"]["resident_bytes"] > 10_000_000
    assert "resident_bytes" not in untimed(report)


def test_the_store_is_the_robots_map_paged_through(recorded: tuple[Path, dict[str, Any]]) -> None:
    """Windows of 20 m drop tiles of 10 m as robots move on; those are in the store, and so is the rest."""
    out, report = recorded
    with SqliteStore.open(out / "map.db") as store:
        assert store.robots() == ["prior", "r1", "r2"]
        assert Replica(store=store).digest() == report["map"]["digest"]
        assert len(store.poses("r1")) == report["robots"]["r1"]["scans"]
        coarse = Replica(store=store, factor=10)
        assert coarse.lattice.resolution_m == 5.0
    assert any(robot["paging"]["evictions"] > 0 for robot in report["robots"].values())


def test_the_report_has_what_robots_did_and_how_well(recorded: tuple[Path, dict[str, Any]]) -> None:
    report = recorded[1]
    assert report["simulated_s"] == 6.0
    assert report["scenario"]["map"]["prior_building_height_m"] == 10
    assert set(report["global"]["digests"]) == {"station", "r1", "r2"}
    assert report["measures"]["map"]["height_of_streets"]["rmse_m"] < 0.5
    assert 0 < report["mapped_share"] < 1
    assert report["radio"]["r1"]["bytes_sent"] > 1000


def test_the_page_needs_nothing_else(recorded: tuple[Path, dict[str, Any]]) -> None:
    page = (recorded[0] / "report.html").read_text()
    assert page.count('src="data:image/png;base64,') == 5  # the world, the map, the station's, two robots' own
    assert page.count('src="data:image/gif;base64,') == 1
    assert "http" not in page.replace("http-equiv", "")
    assert "<h2>Against the truth</h2>" in page
    assert "<h2>Milliseconds a scan, by stage</h2>" in page


def test_logs_make_the_same_map(recorded: tuple[Path, dict[str, Any]]) -> None:
    """With the prior's file and without, as the command line has it."""
    out, report = recorded
    words = shlex.split(map_command(report, out))[1:]
    ran = terrafuse(*words, "--json")
    assert ran.code == 0, ran.err
    assert ran.json["map"]["digest"] == report["map"]["digest"]
    without = [word for word in words if word != "--prior" and not word.endswith(".geojson")]
    alone = terrafuse(*without, "--overwrite", "--json")
    with SqliteStore.open(out / "map.db") as store:
        assert alone.json["map"]["digest"] == Replica(store=store, without=["prior"]).digest()


def test_a_finished_map_is_only_replaced_on_demand(recorded: tuple[Path, dict[str, Any]]) -> None:
    before = (recorded[0] / "map.db").read_bytes()
    with pytest.raises(OutputError, match="--overwrite"):
        run(small(), recorded[0])
    assert (recorded[0] / "map.db").read_bytes() == before


def test_what_fails_leaves_no_store(tmp_path: Path) -> None:
    def stop(*_: Any) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(small(), tmp_path / "new", record=True, progress=stop)
    assert not list(tmp_path.iterdir())


def test_what_can_not_be_set_up_leaves_nothing(tmp_path: Path) -> None:
    text = SMALL.replace("kind: patrol", "kind: patrol, waypoints_m: [[900, 0]]")
    with pytest.raises(InputError, match=r"small.yaml:17: waypoint"):
        run(small(text), tmp_path, record=True)
    assert not list(tmp_path.iterdir())


def test_an_earlier_run_s_files_go(tmp_path: Path) -> None:
    (tmp_path / "own.txt").write_text("mine")
    (tmp_path / f"{WORKSHOP}killed").mkdir()
    short = changed(small(), duration_s=0.2)
    run(short, tmp_path, record=True)
    assert (tmp_path / "r2.mcap").exists()
    fewer = run(with_robots(short, 1), tmp_path, overwrite=True)
    assert sorted([*fewer["files"].values(), "own.txt"]) == sorted(file.name for file in tmp_path.iterdir())


@pytest.mark.parametrize(
    ("study", "model", "says"),
    [
        ("village", "elevation", "needs the model terrain, not elevation; give study: map"),
        ("village", "occupancy", "needs the model terrain"),
        ("soccer", "grey", "needs the world soccer_field, not village"),
        ("soccer", "elevation", "needs the model grey"),
        ("parking", "terrain", "needs the model elevation"),
        ("hallway", "terrain", "needs the world hallway"),
    ],
)
def test_studies_say_first_what_they_need(tmp_path: Path, study: str, model: str, says: str) -> None:
    text = SMALL.replace("model: terrain", f"model: {model}").replace("duration_s: 6", f"duration_s: 6\nstudy: {study}")
    with pytest.raises(InputError, match=f"small.yaml:4: study '{study}' {says}"):
        run(small(text), tmp_path / "out")
    assert not list(tmp_path.iterdir())


def fails(*_: Any) -> Any:
    raise IndexError("nothing there")


@pytest.mark.parametrize(
    "study", [Study(tables=fails), Study(watchers=[fails]), Study(timed_tables=fails), Study(pictures=fails),
              Study(tables=lambda: [Table("of no number", ("a",), ((math.nan,),))])],
)  # fmt: skip
def test_a_study_that_fails_costs_its_tables_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, study: Study
) -> None:
    monkeypatch.setitem(STUDIES, "mine", lambda mission, timeline: study)
    text = SMALL.replace("duration_s: 6", "duration_s: 0.2\nstudy: mine")
    report = run(small(text), tmp_path)
    assert "nothing there" in report["study_failure"] or "JSON" in report["study_failure"]
    assert set(report["files"].values()) == {file.name for file in tmp_path.iterdir()}
    assert report["study_failure"].split(":")[0] in (tmp_path / "report.html").read_text()


def test_a_world_of_too_many_cells_is_refused(tmp_path: Path) -> None:
    text = SMALL.replace("side_m: 120", "side_m: 300").replace("resolution_m: 0.5", "resolution_m: 0.01")
    with pytest.raises(InputError, match=r"small.yaml:8: 9e\+08 cells in a world of 300 × 300 m; give 0.02 m or more"):
        run(small(text), tmp_path / "out")


LASER = """
duration_s: 2
world: {kind: hallway}
map: {model: occupancy, resolution_m: 0.1, tile_m: 10}
robots:
  - body: nomad
    places: [[10, 6, 0]]
    behaviour: {kind: wander}
    sensors:
      - kind: lidar
        rate_hz: 5
        dropout: 0.01
        description:
          name: laser
          max_range_m: 2
          min_range_m: 0.1
          no_return: clear
          noise_sigma_m: 0.01
          ring: {count: 180, step_deg: 2}
          mounting: {z_m: 0.4, yaw_deg: 10}
"""


@pytest.mark.parametrize("more", ["", "          origin_m: [0.1, 0, 0]\n          reliability: 0.8\n"])
def test_logs_keep_that_beams_met_nothing(tmp_path: Path, more: str) -> None:
    """Also where beams begin beside the sensor's origin, and how far it is to be believed. Twice: the command can be
    given again."""
    text = LASER.replace("count: 180", "radius_m: 0.2, count: 180") + more if more else LASER
    report = run(read_scenario(text, "laser.yaml", "laser", Path()), tmp_path, record=True)
    words = shlex.split(map_command(report, tmp_path))[1:]
    for _ in range(2):
        ran = terrafuse(*words, "--json")
        assert ran.code == 0, ran.err
        assert ran.json["map"]["digest"] == report["map"]["digest"]
    assert report["cells"] > 500


@pytest.mark.parametrize(
    ("before", "after", "line", "says"),
    [
        ("duration_s: 6", "duration_s: 6\nstudy: nothing", 4, "study 'nothing'"),
        ("- kind: lidar", "- kind: sonar", 19, "a sonar has cones"),
    ],
)
def test_errors_name_the_line(tmp_path: Path, before: str, after: str, line: int, says: str) -> None:
    with pytest.raises(InputError, match=f"small.yaml:{line}: .*{says}"):
        run(small(SMALL.replace(before, after)), tmp_path / "out", record=True)
    assert not (tmp_path / "out").exists()
