"""A delta with cells that no mapper makes is refused whole, whatever the model."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from terrafuse.errors import DeltaError
from terrafuse.exchange.delta import Delta
from terrafuse.kernels import grey, terrain
from terrafuse.lattice import Lattice
from terrafuse.models import MODELS, make_model
from terrafuse.store.memory import MemoryStore
from terrafuse.testing.deltas import deltas_of
from terrafuse.testing.scans import mixed_scans
from terrafuse.types import Array

LATTICE = Lattice(0.5, 4.0)
SETTINGS: dict[str, dict[str, Any]] = {"grey": {"opening_angle_rad": 0.4}}
FLAWS: list[tuple[str, dict[str, Any], str]] = [
    ("elevation", {"n": 0}, "sums that no points have"),
    ("elevation", {"n": 2**32 - 1}, "sums that no points have"),
    ("elevation", {"z_min": 9, "z_max": 8}, "sums that no points have"),
    ("elevation", {"z_sum": 2**62}, "sums that no points have"),
    # Of two points from 1 to 3 ticks with the sum 4, Σz² is at most 1² + 3² = 10; of three with the sum 6, at least
    # 3·2² = 12.
    ("elevation", {"n": 2, "z_min": 1, "z_max": 3, "z_sum": 4, "sq_hi": 0, "sq_lo": 11}, "sums that no points have"),
    ("elevation", {"n": 3, "z_min": 1, "z_max": 3, "z_sum": 6, "sq_hi": 0, "sq_lo": 11}, "sums that no points have"),
    ("elevation", {"n": 2, "sq_hi": 2**32 - 1}, "sums that no points have"),
    ("elevation", {"ground_n": 7, "ground_z_sum": 7}, "a cached ground with sums"),
    ("elevation", {"ground_n": 0, "ground_z_max": 7}, "a cached ground with sums"),
    ("elevation", {"changes": 5, "merges": 5}, "more changes than merges allow"),
    ("terrain", {"height": np.nan}, "not finite"),
    ("terrain", {"gradient_x": np.inf}, "not finite"),
    ("terrain", {"confidence": 50}, "confidence outside 0 to 254/255"),
    ("terrain", {"confidence": np.nan}, "confidence outside 0 to 254/255"),
    ("terrain", {"flags": terrain.HEIGHT | terrain.OCCUPATION, "occupation": 2}, "occupation outside 0 to 1"),
    ("terrain", {"flags": terrain.PRIOR, "height": 3}, "their flags call unknown"),
    ("terrain", {"flags": terrain.HEIGHT | 2**15}, "one that there is not"),
    ("terrain", dict.fromkeys(terrain.FLAG_OF, 0) | {"flags": 0}, "no flag"),
    ("terrain", {"gps_quality": 200}, "gps_quality over 2"),
    ("terrain", {"communications": 3}, "communications over 1"),
    ("grey", {"a": 40_000, "c": grey.FULL - 39_999}, "an empty interval"),
    ("occupancy", {"updates": 0}, "no update"),
    ("occupancy", {"updates": 2, "sum": 2 * 7_450_000 + 1}, "more log-odds"),
    ("occupancy", {"sum": -(2**63)}, "more log-odds"),
]


def reported(name: str) -> Delta:
    (delta,) = deltas_of("r1", mixed_scans(1, 4), LATTICE, make_model(name, SETTINGS.get(name)), every=4)
    return delta


def spoilt(delta: Delta, fields: dict[str, Any]) -> Delta:
    """The delta with one cell of its last tile changed."""
    last = delta.tiles[-1]
    cells: Array = last.cells.copy()
    if fields.get("flags") is not None:
        for name in terrain.FLAG_OF:
            cells[name][0] = 0
    for name, value in fields.items():
        cells[name][0] = value
    return replace(delta, tiles=(*delta.tiles[:-1], replace(last, cells=cells)))


@pytest.mark.parametrize("name", MODELS)
def test_what_a_mapper_makes_is_accepted(name: str) -> None:
    assert MemoryStore(LATTICE, make_model(name, SETTINGS.get(name))).accept(reported(name))


@pytest.mark.parametrize(("name", "fields", "flaw"), FLAWS)
def test_what_no_mapper_makes_is_refused_whole(name: str, fields: dict[str, Any], flaw: str) -> None:
    delta = reported(name)
    store = MemoryStore(LATTICE, make_model(name, SETTINGS.get(name)))
    with pytest.raises(DeltaError, match=flaw) as error:
        store.accept(spoilt(delta, fields))
    assert str(tuple(delta.tiles[-1].key)) in str(error.value)
    assert store.keys() == []
