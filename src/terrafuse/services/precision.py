"""How precisely a robot reports its map: all of it alike, or replicas would hold different cells of one revision."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from terrafuse.errors import InputError
from terrafuse.exchange.channel import as_it_is
from terrafuse.exchange.delta import Delta
from terrafuse.exchange.profiles import EXACT, report
from terrafuse.models.base import Model
from terrafuse.store.base import Store


def projection(precision: str, model: Model) -> Callable[[Delta], Delta]:
    """What becomes of a robot's contribution where it is reported."""
    return as_it_is if precision == EXACT else partial(report, profile=precision, model=model)


def keep_to(precision: str, file: Path, archive: Store) -> None:
    """Remember beside the robot's store by what it reports. Raises InputError if that was something else before."""
    beside = file.with_name(f"{file.stem}.precision")
    before = beside.read_text() if beside.exists() else EXACT
    if before != precision and archive.robots():
        raise InputError(
            f"precision {precision}: what {file} holds was reported with {before}; keep to that, or take another store"
        )
    if before != precision:
        beside.write_text(precision)
