"""What a planner must know of a robot: how wide it is, and what it would rather not drive on.

`Robot` is checked where a file is read; its fields' limits are those of the annotations.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import yaml
from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from terrafuse.errors import InputError

Number = Annotated[float, Field(strict=True)]
"""Yes and "1" are none."""
Price = Annotated[Number, Field(ge=0, le=100)]


@dataclass(frozen=True)
class Robot:
    """A round robot. Prices are in metres of free ground: a metre that costs 3 is worth a detour of 2 metres."""

    radius_m: Annotated[Number, Field(ge=0, le=100)] = 0.25
    """Obstacles come no nearer to its centre."""
    unknown: Literal["avoid", "forbid", "free"] = "avoid"
    """What it thinks of cells that nobody saw: each metre at `unknown_price`, no way through, or like free ground."""
    max_slope: Annotated[Number, Field(gt=0)] | None = None
    """Steepest ground, dz/dx, that it climbs; None leaves that to the map's own idea of an obstacle."""
    occupied_from: Annotated[Number, Field(gt=0, le=1)] = 0.65
    """A cell that is occupied this surely, 0 to 1, is an obstacle."""
    keep_away_m: Annotated[Number, Field(ge=0, le=100)] = 0.5
    """How much further than `radius_m` it would rather stay away from obstacles."""
    keep_away_price: Price = 2.0
    """What a metre costs more right beside an obstacle; falls to 0 over `keep_away_m`."""
    occupied_price: Price = 1.0
    """What a metre costs more that is nearly an obstacle; falls to 0 at half of `occupied_from`."""
    unknown_price: Annotated[Number, Field(ge=1, le=100)] = 4.0

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid", allow_inf_nan=False)


ADAPTER = TypeAdapter(Robot)


def load_robot(path: Path | str) -> Robot:
    """The robot that a YAML file describes. Raises InputError that names file, line, key and remedy."""
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"robot {path}: can't be read as text ({error}); give a YAML file") from error
    return read_robot(text, str(path))


def read_robot(text: str, where: str) -> Robot:
    """The robot that this YAML describes; `where` is what errors call it. Raises InputError."""
    lines = _lines(text, where)
    try:
        return ADAPTER.validate_python(yaml.safe_load(text) or {})
    except (ValidationError, yaml.YAMLError, ValueError) as error:
        raise InputError(_complaint(error, where, lines)) from error


def _lines(text: str, where: str) -> dict[str, int]:
    """The line of each key. Raises InputError for what is no mapping, and for keys given twice."""
    try:
        tree = yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.YAMLError as error:
        raise InputError(_complaint(error, where, {})) from error
    if tree is not None and not isinstance(tree, yaml.MappingNode):
        raise InputError(f"{where}: holds no keys, but a robot is described by them: {_known()}")
    lines: dict[str, int] = {}
    for key, _ in tree.value if tree is not None else ():
        if str(key.value) in lines:
            raise InputError(f"{where}:{key.start_mark.line + 1}: '{key.value}' is given twice; keep one")
        lines[str(key.value)] = key.start_mark.line + 1
    return lines


def _complaint(error: Exception, where: str, lines: dict[str, int]) -> str:
    if not isinstance(error, ValidationError):
        mark = getattr(error, "problem_mark", None)
        line = f":{mark.line + 1}" if mark else ""
        return f"{where}{line}: not YAML ({getattr(error, 'problem', None) or error}); see docs/planning.md"
    first: Any = error.errors()[0]
    key = str(first["loc"][0]) if first["loc"] else ""
    place = f"{where}:{lines[key]}" if key in lines else where
    if key not in (field.name for field in fields(Robot)):
        return f"{place}: there is no key '{key}'; known here: {_known()}"
    message = str(first["msg"])
    return f"{place}: {key} = {first['input']!r}: {message[0].lower()}{message[1:]}"


def _known() -> str:
    return ", ".join(field.name for field in fields(Robot))
