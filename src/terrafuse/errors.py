"""The one error hierarchy. Every message names the value and the remedy; only the command line prints."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

SHOWN_LETTERS = 80


class TerrafuseError(Exception):
    """Base of everything terrafuse raises on purpose. `exit_code` is what the command line ends with, `facts` what it
    says as JSON beside the message."""

    exit_code = 1
    facts: Mapping[str, Any] = MappingProxyType({})


class InputError(TerrafuseError):
    """What the user gave can't be used: a file, a record in it, an option. Nothing was written."""

    exit_code = 2


class LatticeError(InputError):
    """A resolution, tile side or coordinate that no lattice can have."""


class PoseError(InputError):
    """A pose that is not a rigid motion, or a trajectory that can't be used."""


class LogError(InputError):
    """A recording that is missing, of no known format, or damaged. Names the file and, where known, the record."""


class MissingExtra(InputError):  # noqa: N818, what is missing is an extra
    """An optional dependency is not installed. The message has the `pip install` line that brings it."""

    def __init__(self, what: str, package: str, extra: str) -> None:
        super().__init__(f"{what} needs the package '{package}': pip install 'terrafuse[{extra}]'")


class CodecError(TerrafuseError):
    """Bytes that are not a delta of a version that we read. Nothing was applied."""


class DeltaError(TerrafuseError):
    """A well-formed delta that does not belong here: another lattice, another model, a cell outside its tile."""


class StoreError(TerrafuseError):
    """The store can't be read or written."""


class StoreMismatch(StoreError, InputError):  # noqa: N818, reads as one
    """A store that can't be used as asked: a newer schema, another lattice or model, not a store at all."""

    exit_code = 2


class OutputError(InputError):
    """A result can't be written: no space, no permission. What existed before is untouched."""


class Interrupted(TerrafuseError):  # noqa: N818, that it is so is the error
    """The user stopped it, and nothing is left of it."""

    exit_code = 130


class NoPath(TerrafuseError):  # noqa: N818, the lack of one is the error
    """No way leads from the start to the goal. `facts["reason"]` is outside, obstacle, too_near or unknown, of the
    `facts["end"]` start or goal; or not_connected. `facts["nearest"]` is the nearest place of which that is not so."""

    def __init__(self, message: str, **facts: Any) -> None:
        super().__init__(message)
        self.facts = facts


def shown(value: Any) -> str:
    """A value as errors show it, cut where it is long."""
    text = value if isinstance(value, str) and "\n" not in value else repr(value)
    return text if len(text) <= SHOWN_LETTERS else f"{text[:SHOWN_LETTERS]}…"
