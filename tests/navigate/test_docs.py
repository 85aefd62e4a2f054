"""What docs/planning.md shows is so."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from terrafuse.navigate import Robot
from terrafuse.navigate.robot import read_robot

PAGE = (Path(__file__).parents[2] / "docs" / "planning.md").read_text()


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)


def test_the_description_has_the_defaults() -> None:
    (text,) = blocks("yaml")
    assert read_robot(text, "docs/planning.md") == Robot(max_slope=0.3)


def test_the_python_runs(capsys: pytest.CaptureFixture[str]) -> None:
    (code,) = blocks("python")
    exec(compile(code, "planning.md", "exec"), {})
    before, now, reason = capsys.readouterr().out.splitlines()
    assert before == "3.16 m over 2 waypoints"
    assert 3.5 < float(now.split()[0]) < 4.5
    assert reason == "outside"
