"""What docs/sensors.md shows is so."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from terrafuse.cli import arguments
from terrafuse.logs import Source, open_log
from terrafuse.sense import load_sensor, preset_names
from terrafuse.sense.describe import read_sensor
from terrafuse.types import Scan
from tests.logs.support import pose

PAGE = (Path(__file__).parents[2] / "docs" / "sensors.md").read_text()


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)


def test_the_description_is_read() -> None:
    (text,) = blocks("yaml")
    sensor = read_sensor(text, "docs/sensors.md")
    assert sensor.beams.count == 8
    assert sensor.sentinels_m == ((5.11, "ignore"),)


def test_the_python_runs(capsys: pytest.CaptureFixture[str]) -> None:
    (code,) = blocks("python")
    exec(compile(code, "sensors.md", "exec"), {})
    assert "(15, 3) (1, 3) (16, 3)" in capsys.readouterr().out


def test_every_preset_is_listed() -> None:
    table = PAGE.split("## Presets")[1].split("## In Python")[0]
    assert sorted(re.findall(r"`(\w+)`", table)) == preset_names()


def test_the_commands_sensors_are_robots_and_presets_or_files() -> None:
    lines = re.findall(r"^    terrafuse (map .*)$", PAGE, re.MULTILINE)
    assert len(lines) == 3
    for line in lines:
        words = shlex.split(line)
        names = arguments.robots([word for word in words[1:] if re.match(r"r\d=[^ ]*\.(log\.gz|mcap|csv)$", word)])
        given = [words[i + 1] for i, word in enumerate(words) if word == "--sensor"]
        for sensor in arguments.by_robot("--sensor", given, names).values():
            assert sensor == "my.yaml" or load_sensor(sensor).name == sensor


def test_the_table_of_ranges_is_read(tmp_path: Path) -> None:
    """At 12.5 s the fourth sonar heard something at 1.9 m; before, nothing is no reading."""
    (text,) = re.findall(r"```\n(stamp_s.*?)```", PAGE, re.DOTALL)
    (tmp_path / "ring.csv").write_text(text)
    first, second = open_log(Source(tmp_path / "ring.csv", aimed=True)).scans()
    assert isinstance(first, Scan)
    assert isinstance(second, Scan)
    assert (first.stamp_ns, second.stamp_ns) == (12_250_000_000, 12_500_000_000)
    assert np.allclose(first.readings.ranges_m, [0.84, 2.5, np.inf, np.nan], equal_nan=True)
    assert np.allclose(second.readings.ranges_m, [0.80, 2.5, np.inf, 1.9])
    assert np.allclose(first.T_world_sensor.matrix, pose(1.5, -0.5, yaw=np.pi / 2).matrix)
