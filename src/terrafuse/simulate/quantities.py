"""The numbers that a scenario may give. All have limits, far beyond what makes sense and far below what overflows, so
that no arithmetic on them has to look."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Field


def _number(value: Any) -> Any:
    """`true` and "5" are no numbers."""
    if isinstance(value, bool | str):
        raise ValueError("give a number")
    return value


def _file(value: Any) -> Any:
    if not (isinstance(value, str) and value):
        raise ValueError("give a file's name")
    return value


Number = Annotated[float, BeforeValidator(_number)]
Count = Annotated[int, BeforeValidator(_number)]
Flag = Annotated[bool, Field(strict=True)]
Share = Annotated[Number, Field(ge=0, le=1)]
Seed = Annotated[Count, Field(ge=0, lt=10**18)]
"""As many digits as a whole number in YAML may have."""
Length = Annotated[Number, Field(ge=0.001, le=1e6)]
Resolution = Annotated[Number, Field(ge=0.001, le=100)]
Height = Annotated[Number, Field(ge=0, le=10_000)]
Error = Annotated[Number, Field(ge=0, le=1)]
"""Standard deviation of a reading: metres, radians, or a share."""
Speed = Annotated[Number, Field(ge=0.01, le=100)]
Rate = Annotated[Number, Field(ge=0.001, le=1000)]
Period = Annotated[Number, Field(ge=0.001, le=1e6)]
Delay = Annotated[Number, Field(ge=0, le=1e6)]
File = Annotated[Path | str, BeforeValidator(_file)]
Coordinate = Annotated[Number, Field(ge=-1e8, le=1e8)]
"""Metres; projected ones have eight digits."""
Place = tuple[Coordinate, Coordinate]
"""East and north, metres."""
