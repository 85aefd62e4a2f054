"""What the commands take: text in, checked values out."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

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
        if name and name not in robots_:
            raise InputError(f"{option} {text}: there is no robot '{name}'; there are {', '.join(robots_)}")
        if name in out:
            whose = f"robot '{name}'" if name else "all robots"
            raise InputError(f"{option} is given twice for {whose} ({out[name]} and {value}); keep one")
        out[name] = value
    bare = out.pop("", None)
    return out if bare is None else dict.fromkeys(robots_, bare) | out


def numbers(text: str | None, names: str) -> tuple[float, ...] | None:
    """`1,2,…` → floats, as many as `names` (like "EAST,NORTH") has; raises InputError."""
    if text is None:
        return None
    count = names.count(",") + 1
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != count or not all(map(math.isfinite, values)):
        raise InputError(f"'{text}': give {count} finite numbers, {names}")
    return values


def bounds(text: str | None) -> Bounds | None:
    from terrafuse.types import Bounds

    values = numbers(text, "WEST,SOUTH,EAST,NORTH")
    if values is None:
        return None
    out = Bounds(*values)
    if not (out.west < out.east and out.south < out.north):
        raise InputError(
            f"'{text}': the bounds are empty; give WEST,SOUTH,EAST,NORTH with west < east and south < north"
        )
    return out
