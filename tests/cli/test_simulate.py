"""`terrafuse simulate` and `demo`, as users run them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.program import terrafuse
from tests.simulate.missions import SMALL

for module in ("embreex", "rasterio", "matplotlib", "PIL", "mcap", "rosbags"):
    pytest.importorskip(module)


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scenario") / "hamlet.yaml"
    path.write_text(SMALL.replace("duration_s: 6", "duration_s: 1"))
    return path


def test_without_a_scenario_it_lists_them() -> None:
    ran = terrafuse("simulate")
    assert ran.code == 0
    assert "village  Village patrol" in ran.out
    assert "village" in terrafuse("simulate", "--json").json["scenarios"]


def test_an_unknown_scenario_is_bad_input_and_lists_them() -> None:
    ran = terrafuse("simulate", "vilage")
    assert ran.code == 2
    assert "Village patrol" in ran.err
    assert "error: scenario 'vilage'" in ran.err
    assert ran.out == ""


def test_a_folder_is_no_scenario_and_lists_them(tmp_path: Path) -> None:
    ran = terrafuse("simulate", tmp_path)
    assert ran.code == 2
    assert "Village patrol" in ran.err
    assert "neither a file nor one of" in ran.err


def test_a_missing_file_says_so(tmp_path: Path) -> None:
    ran = terrafuse("simulate", tmp_path / "mine.yaml")
    assert ran.code == 2
    assert "mine.yaml': neither a file nor one of" in ran.err


def test_a_run(scenario: Path, tmp_path: Path) -> None:
    ran = terrafuse("simulate", scenario, "--robots", "1", "--seed", "3", "--duration", "0.5", "--record", cwd=tmp_path)
    assert ran.code == 0, ran.err
    report = json.loads((tmp_path / "hamlet" / "report.json").read_text())
    assert list(report["robots"]) == ["r1"]
    assert report["seed"] == 3
    assert report["simulated_s"] == 0.5
    assert ran.out.startswith("Small village: 1 robot, 0.5 s simulated at ")
    for file in ("hamlet/world.png", "hamlet/map.png", "hamlet/film.gif", "hamlet/report.html"):
        assert file in ran.out
    assert "terrafuse map r1=hamlet/r1.mcap --sensor r1=hamlet/r1.sensor.yaml" in ran.out
    again = terrafuse("simulate", scenario, cwd=tmp_path)
    assert again.code == 2
    assert "--overwrite" in again.err


def test_json(scenario: Path, tmp_path: Path) -> None:
    ran = terrafuse("simulate", scenario, "--duration", "0.2", "--out", tmp_path / "out", "--json")
    assert ran.code == 0, ran.err
    assert ran.json["simulated_s"] == 0.2
    assert "simulate …" in ran.err


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--robots", "0"), "0 robots: give 1 to 1000"),
        (("--duration", "-1"), "duration_s = -1"),
        (("--duration", "1e300"), "duration_s = 1e+300: give 1e+06 or less"),
        (("--duration", "0.01"), "duration_s: 0.01 s are less than a tick; give 0.1 or more"),
        (("--seed", "-1"), "seed = -1"),
        (("--seed", "12345678901234567890123"), "give less than 1e+18"),
        (("--threads", "0"), "--threads"),
    ],
)
def test_wrong_options(scenario: Path, tmp_path: Path, options: tuple[str, str], says: str) -> None:
    ran = terrafuse("simulate", scenario, *options, "--out", tmp_path / "out")
    assert ran.code == 2
    assert says in ran.err
    assert not (tmp_path / "out").exists()


def test_a_broken_scenario_names_its_line(tmp_path: Path) -> None:
    path = tmp_path / "broken.yaml"
    path.write_text(SMALL.replace("side_m: 120", "side_m: -120"))
    ran = terrafuse("simulate", path, "--out", tmp_path / "out")
    assert ran.code == 2
    assert "broken.yaml:5:" in ran.err
    assert not (tmp_path / "out").exists()


def test_the_demo_is_the_village_with_three_robots(tmp_path: Path) -> None:
    ran = terrafuse("demo", "--headless", "--duration", "0.2", "--out", tmp_path / "demo")
    assert ran.code == 0, ran.err
    report = json.loads((tmp_path / "demo" / "report.json").read_text())
    assert list(report["robots"]) == ["r1", "r2", "r3"]
    assert report["scenario"]["study"] == "village"
    assert any("Milliseconds a stage" in table["title"] for table in report["timings"]["tables"])
