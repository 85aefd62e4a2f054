"""`terrafuse models`: the cell models and what can be set."""

from __future__ import annotations

import textwrap
from typing import Any

from terrafuse.cli.commands import Json
from terrafuse.cli.output import say, say_json
from terrafuse.cli.plugins import Plugins

WIDTH = 100


def models_(plugin: Plugins = None, json: Json = False) -> None:
    """List the cell models and their settings, with defaults, as `map --model NAME?key=value&key=value` takes them."""
    from terrafuse.models import MODELS
    from terrafuse.settings import settings_of

    facts = {
        name: {
            setting.name: {"default": setting.default, "takes": setting.takes, "about": setting.about}
            for setting in settings_of(make).values()
        }
        for name, make in sorted(MODELS.items())
    }
    if json:
        say_json(facts)
        return
    for name, settings in facts.items():
        say(name)
        for key, setting in settings.items():
            _tell(key, setting)


def _tell(key: str, setting: dict[str, Any]) -> None:
    from terrafuse.settings import shown

    written = f"{key}={shown(setting['default'])}"
    say(f"  {written:34}{setting['takes']}")
    for line in textwrap.wrap(setting["about"], WIDTH - 6):
        say(f"      {line}")
