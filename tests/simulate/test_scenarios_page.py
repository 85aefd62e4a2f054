"""docs/scenarios.md: it names every key that there is, and its example is a scenario."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from pydantic import BaseModel

from terrafuse.simulate.mission.behaviours import BEHAVIOURS
from terrafuse.simulate.motion import BODIES
from terrafuse.simulate.scenario import model
from terrafuse.simulate.scenario.read import read_scenario
from terrafuse.simulate.worlds import WORLDS

PAGE = (Path(__file__).parents[2] / "docs" / "scenarios.md").read_text(encoding="utf-8")
PARTS = [part for part in vars(model).values() if isinstance(part, type) and issubclass(part, BaseModel)]
KEYS = sorted(
    {key for part in (*PARTS, *(settings for settings, _ in BEHAVIOURS.values())) for key in part.model_fields}
)


@pytest.mark.parametrize("key", [*KEYS, *BEHAVIOURS, *WORLDS, *BODIES])
def test_every_key_is_named(key: str) -> None:
    assert f"`{key}`" in PAGE


def test_the_example_is_a_scenario() -> None:
    (text,) = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    loaded = read_scenario(text, "scenarios.md", "example", Path())
    assert loaded.scenario.radio.cuts[0].node == "r2"
    assert len(loaded.world.houses) > 10
