"""The five commands of docs/security.md, as they stand there but for addresses and the log."""

from __future__ import annotations

import re
import shlex
import subprocess
from pathlib import Path

import pytest

pytest.importorskip("zenoh")
pytest.importorskip("cryptography")

from tests.program import PROGRAM, record, terrafuse

PAGE = Path(__file__).parents[2] / "docs" / "security.md"


def commands(host: str, port: int) -> list[list[str]]:
    section = PAGE.read_text().partition("## In five commands")[2].partition("\n## ")[0]
    lines = re.findall(r"^    terrafuse (.*)$", section, re.MULTILINE)
    assert len(lines) == 5
    moved = [line.replace("192.168.1.10", host).replace("0.0.0.0", host).replace(":7447", f":{port}") for line in lines]
    return [shlex.split(line) for line in moved]


def test_five_commands_make_a_fleet_that_maps(tmp_path: Path) -> None:
    from tests.exchange.zenoh_nodes import LOOPBACK, free_port

    record(tmp_path / "monday.mcap", seed=1, scans=5)
    *keys, station, robot = commands(LOOPBACK, free_port())
    for line in keys:
        ran = terrafuse(*line, cwd=tmp_path)
        assert ran.code == 0, ran.err
    with subprocess.Popen([*PROGRAM, *station], cwd=tmp_path, stdout=subprocess.DEVNULL) as process:
        ran = terrafuse(*robot, cwd=tmp_path)
        assert ran.code == 0, ran.err
        process.terminate()
        assert process.wait(20) in (0, 130)
    held = terrafuse("info", "station.db", "--json", cwd=tmp_path)
    assert list(held.json["robots"]) == ["r4"]
    assert held.json["cells"] > 0
