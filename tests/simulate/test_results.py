"""What a mission leaves behind: the same bytes for the same seed, files that open, and logs that make the same map."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any

import pytest

from terrafuse.errors import InputError, OutputError
from terrafuse.replica import Replica
from terrafuse.simulate.mission.recording import map_command
from terrafuse.simulate.mission.results import run
from terrafuse.simulate.scenario.read import changed
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
        run(small(), tmp_path, record=True, progress=stop)
    assert not list(tmp_path.glob("*.db*"))
    assert not list(tmp_path.glob("*.mcap"))


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
