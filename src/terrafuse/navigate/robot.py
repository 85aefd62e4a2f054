"""What a planner must know of a robot: how wide it is, and what it would rather not drive on.

`Robot` is checked where a file is read; its fields' limits are those of the annotations.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from terrafuse import strict_yaml
from terrafuse.errors import InputError, shown
from terrafuse.strict_yaml import Document

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
    return _robot(strict_yaml.load(path))


def read_robot(text: str, where: str) -> Robot:
    """The robot that this YAML describes; `where` is what errors call it. Raises InputError."""
    return _robot(strict_yaml.parse(text, where))


def _robot(document: Document) -> Robot:
    values = document.value if document.value is not None else {}
    if not isinstance(values, dict):
        raise InputError(f"{document.where}: holds no keys, but a robot is described by them: {_known()}")
    for key in values:
        if key not in (field.name for field in fields(Robot)):
            raise document.error([key], f"there is no key '{shown(str(key))}'; known here: {_known()}")
    try:
        return ADAPTER.validate_python(values)
    except ValidationError as error:
        raise _complaint(error, document) from error


def _complaint(error: ValidationError, document: Document) -> InputError:
    """The first fault."""
    first: Any = error.errors()[0]
    message = str(first["msg"])
    return document.error(
        first["loc"][:1], f"{first['loc'][0]} = {shown(repr(first['input']))}: {message[0].lower()}{message[1:]}"
    )


def _known() -> str:
    return ", ".join(field.name for field in fields(Robot))
