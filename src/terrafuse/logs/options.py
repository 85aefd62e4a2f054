"""Text after the `?` → checked values. Everything past this border is typed."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from pathlib import Path

from terrafuse.errors import LogError
from terrafuse.logs.base import Source

NS = 1_000_000_000

MAX_GAP_S = 0.5
"""At 20 m/s and 1 rad/s a chord over 0.5 s is some decimetres off; beyond it a pose would be invented."""

MAX_GAP_HELP = f"longest time between two poses to interpolate over, seconds (default {MAX_GAP_S})"


def positive(source: Source, key: str, default: float) -> float:
    """The option as a finite number over zero."""
    text = source.options.get(key)
    if text is None:
        return default
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        raise LogError(f"{source.path}: ?{key}={text} is not a positive number")
    return value


def max_gap_ns(source: Source) -> int:
    return round(positive(source, "max_gap_s", MAX_GAP_S) * NS)


def whole_numbers(source: Source, key: str) -> list[int] | None:
    """A comma list of whole numbers, None where the option is not given."""
    text = source.options.get(key)
    if text is None:
        return None
    try:
        return [int(part) for part in text.split(",")]
    except ValueError:
        raise LogError(f"{source.path}: ?{key}={text} is not a comma list of whole numbers") from None


def choice(source: Source, key: str, choices: Collection[str], default: str) -> str:
    value = source.options.get(key, default)
    if value not in choices:
        raise LogError(f"{source.path}: ?{key}={value} is not one of {', '.join(choices)}")
    return value


def file_option(source: Source, key: str) -> Path | None:
    """The file that the option names, relative to the log's folder or absolute. LogError if missing."""
    text = source.options.get(key)
    if text is None:
        return None
    folder = source.path if source.path.is_dir() else source.path.parent
    path = folder / text
    if not path.is_file():
        raise LogError(f"{source.path}: ?{key}={text}: there is no file {path}")
    return path


def listed(names: Iterable[object]) -> str:
    return ", ".join(map(str, names)) or "none"
