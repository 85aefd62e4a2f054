"""What the commands take: text in, checked values out."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from terrafuse.errors import InputError

if TYPE_CHECKING:
    from terrafuse.types import Bounds

_NAMED = re.compile(r"^([^=/?\\]+)=(.+)$", re.DOTALL)


def robots(arguments: Sequence[str]) -> dict[str, str]:
    """NAME=LOG… → {name: log}; raises InputError for a log without a name and for a name given twice."""
    out: dict[str, str] = {}
    for text in arguments:
        match = _NAMED.match(text)
        if match is None:
            raise InputError(f"'{text}': give each log a robot's name, like r1={text}")
        name, log = match.groups()
        if name in out:
            raise InputError(f"robot '{name}' is given twice ({out[name]} and {log}); names tell contributions apart")
        out[name] = log
    return out


def by_robot(option: str, texts: Sequence[str], names: Iterable[str]) -> dict[str, str]:
    """NAME=VALUE… and at most one bare VALUE, which is for all that are not named → {name: value}.

    Raises InputError for a name that is no robot's and for two values for one.
    """
    robots_ = list(names)
    out: dict[str, str] = {}
    for text in texts:
        match = _NAMED.match(text)
        name, value = match.groups() if match else ("", text)
        if not value.strip() or value.endswith("="):
            raise InputError(f"{option} '{text}': names nothing; give a file, or NAME=FILE for one robot")
        if name and name not in robots_:
            raise InputError(f"{option} {text}: there is no robot '{name}'; there are {', '.join(robots_)}")
        if name in out:
            whose = f"robot '{name}'" if name else "all robots"
            raise InputError(f"{option} is given twice for {whose} ({out[name]} and {value}); keep one")
        out[name] = value
    bare = out.pop("", None)
    return out if bare is None else dict.fromkeys(robots_, bare) | out


def numbers(option: str, text: str | None, names: str) -> tuple[float, ...] | None:
    """`1,2,…` → floats, as many as `names` (like "EAST,NORTH") has; raises InputError that names the option."""
    if text is None:
        return None
    count = names.count(",") + 1
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != count or not all(map(math.isfinite, values)):
        raise InputError(f"{option} '{text}': give {count} finite numbers, {names}")
    return values


def positive(option: str, value: float | None, unit: str = "metres") -> float | None:
    """The value, if it is a finite number over 0 or was not given; raises InputError."""
    if value is not None and not (math.isfinite(value) and value > 0):
        raise InputError(f"{option} {value:g}: give a number of {unit} over 0")
    return value


def bounds(text: str | None, option: str = "--bounds") -> Bounds | None:
    from terrafuse.types import Bounds

    values = numbers(option, text, "WEST,SOUTH,EAST,NORTH")
    if values is None:
        return None
    out = Bounds(*values)
    if not (out.west < out.east and out.south < out.north):
        raise InputError(
            f"{option} '{text}': the bounds are empty; give WEST,SOUTH,EAST,NORTH with west < east and south < north"
        )
    return out


def model(text: str, static: bool = False, max_range_m: float | None = None) -> tuple[str, dict[str, Any]]:
    """`NAME?key=value&key=value`, --static and --max-range → the model's name and its settings, typed and checked.

    Raises InputError that names the setting, or the option whose setting the model has not.
    """
    from terrafuse.models import MODELS, make_model
    from terrafuse.query import split_query
    from terrafuse.settings import typed_settings

    name, texts = split_query(text)
    if name not in MODELS:
        make_model(name)  # says which there are
    settings = typed_settings(name, MODELS[name], texts)
    if static:
        settings |= _by_option("--static", name, "static", True, texts)
    if positive("--max-range", max_range_m) is not None:
        settings |= _by_option("--max-range", name, "max_range_m", max_range_m, texts)
    try:
        make_model(name, settings)
    except InputError as error:
        raise InputError(f"--model {text}: {error}") from error
    return name, settings


def _by_option(option: str, name: str, key: str, value: Any, texts: dict[str, str]) -> dict[str, Any]:
    from terrafuse.models import MODELS
    from terrafuse.settings import settings_of, takes_any

    if key in texts:
        raise InputError(f"{option} and --model {name}?{key}={texts[key]} set the same; keep one")
    if key not in settings_of(MODELS[name]) and not takes_any(MODELS[name]):
        others = [other for other, make in sorted(MODELS.items()) if key in settings_of(make)]
        raise InputError(f"{option}: the model '{name}' has no such setting; it is one of {', '.join(others)}")
    return {key: value}


def store_file(path: Path) -> Path:
    """A store's file; raises InputError for a folder, with what of it may be meant."""
    if path.is_dir():
        stores = sorted(file.name for file in path.glob("*.db"))
        hint = f"give the store in it: {path / stores[0]}" if stores else "give a store, like map/map.db"
        raise InputError(f"{path}: is a folder; {hint}")
    return path
