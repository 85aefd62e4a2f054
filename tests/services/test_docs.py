"""The commands and the file of docs/services.md work as they stand there, but for addresses and logs."""

from __future__ import annotations

import re
import shlex
import signal
from pathlib import Path

import pytest

from terrafuse.services.settings import chosen, load_fleet
from tests.services.processes import Processes, answers, cells_in, digest, free_port
from tests.test_docs import ROOT

TEXT = (ROOT / "docs" / "services.md").read_text()
COMMANDS = [shlex.split(line) for line in re.findall(r"^    terrafuse (.*)$", TEXT, re.MULTILINE)]
ALONE = ["station", "station", "robot", "robot"]
"""Other fleets, which tests of their own run."""
(FLEET,) = re.findall(r"```yaml\n(.*?)```", TEXT, re.DOTALL)


def here(text: str, port: int) -> str:
    return re.sub(r"tcp/[\d.]+:7447", f"tcp/127.0.0.1:{port}", text)


@pytest.fixture
def folder(tmp_path: Path, logs: dict[str, Path]) -> Path:
    for name, log in zip(("monday", "tuesday"), logs.values(), strict=True):
        (tmp_path / f"{name}.mcap").symlink_to(log)
    return tmp_path


def named(words: list[str], port: int) -> list[str]:
    return [here(word, port) for word in words]


def test_its_commands(folder: Path) -> None:
    pytest.importorskip("zenoh")
    pytest.importorskip("embreex")
    port = free_port()
    assert [words[0] for words in COMMANDS] == [
        "station",
        "robot",
        "robot",
        "services",
        "get",
        "get",
        "correct",
        *ALONE,
        *["fleet"] * 3,
    ]
    station, *robots = COMMANDS[:3]
    with Processes(folder) as fleet:
        fleet.start("station", *named(station, port))
        fleet.until(lambda: answers(port), "that the station listens")
        fleet.start("r1", *named(robots[0], port))
        fleet.until(lambda: fleet.code("r1") is not None, "that r1 ends")
        fleet.start("r2", *named(robots[1], port))
        for name, words in zip(("services", "get"), COMMANDS[3:5], strict=True):
            fleet.start(name, *named(words, port))
            fleet.until(lambda name=name: fleet.code(name) is not None, f"that {name} ends")  # type: ignore[misc]
            assert fleet.code(name) == 0
        assert "map-manager" in fleet.text("services")
        assert '"contract": "terrafuse/mapping/1"' in fleet.text("get")
        fleet.start("part", *named(COMMANDS[5], port))
        fleet.until(lambda: fleet.code("part") == 0, "that a part of the map comes")
        assert (folder / "part.png").stat().st_size > 1000
        fleet.start("correct", *named(COMMANDS[6], port))
        fleet.until(lambda: fleet.code("correct") == 0, "that the station takes a correction")
        fleet.until(lambda: fleet.code("r2") is not None, "that r2 ends")
        assert [fleet.code("r1"), fleet.code("r2")] == [0, 0]


def test_its_file_in_one_process_and_in_two(folder: Path) -> None:
    pytest.importorskip("zenoh")
    port = free_port()
    whole, station, robots = COMMANDS[-3:]
    (folder / "fleet.yaml").write_text(here(FLEET, port))
    with Processes(folder) as fleet:
        fleet.start("whole", *whole)
        fleet.until(lambda: fleet.code("whole") is not None, "that it ends")
        assert fleet.code("whole") == 0
    expected = digest(folder / "station.db")
    for store in folder.glob("*.db*"):
        store.unlink()
    (folder / "fleet.yaml").write_text(here(FLEET, port).replace("kind: memory", "kind: zenoh"))
    with Processes(folder) as fleet:
        fleet.start("station", *station)
        fleet.start("robots", *robots)
        fleet.until(lambda: fleet.code("robots") is not None, "that they end")
        assert fleet.code("robots") == 0
        assert fleet.stop("station", signal.SIGINT)[0] == 0
    assert cells_in(folder / "station.coarse.db") > 0
    assert digest(folder / "station.db") == expected


def test_its_file_is_read(folder: Path) -> None:
    (folder / "fleet.yaml").write_text(FLEET)
    settings = load_fleet(folder / "fleet.yaml")
    assert settings.nodes == ["station", "r1", "r2"]
    assert settings.robots["r1"].source == str(folder / "monday.mcap")
    assert settings.robots["r2"].bytes_per_s == 50000
    assert chosen(settings, []) == ["station", "r1", "r2"]
