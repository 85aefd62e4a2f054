"""`WHAT?key=value&key=value`: how logs, windows and prior maps are named together with their options."""

from __future__ import annotations

from pathlib import Path

from terrafuse.errors import InputError


def split_query(text: str) -> tuple[str, dict[str, str]]:
    """(what, options). A path that exists as written may contain `?`. Raises InputError for what is no key=value."""
    if _is_there(text):
        return text, {}
    what, _, query = text.partition("?")
    options: dict[str, str] = {}
    for part in filter(None, query.split("&")):
        key, equals, value = part.partition("=")
        if not equals or not key:
            raise InputError(f"{text}: '{part}' after the '?' is not key=value")
        if key in options:
            raise InputError(f"{text}: {key} is given twice; give it once")
        options[key] = value
    return what, options


def _is_there(text: str) -> bool:
    try:
        return Path(text).exists()
    except (OSError, ValueError):  # too long for a path, or with a null byte
        return False
