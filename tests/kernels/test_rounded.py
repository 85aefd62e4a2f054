"""Records of numbers: as the arrays' way, bit by bit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from terrafuse.exchange.profiles import PROFILES, elevation, terrain
from terrafuse.tile import opaque

REFERENCES = {
    ("elevation", "full"): elevation.full_reference,
    ("elevation", "lean"): elevation.lean_reference,
    ("terrain", "full"): terrain.full_reference,
    ("terrain", "lean"): terrain.lean_reference,
}


@pytest.mark.parametrize(("model", "name"), REFERENCES)
@given(seed=st.integers(0, 2**31), most=st.sampled_from([1, 8, 1000, 2**20]))
@settings(max_examples=60, deadline=None)
def test_equals_the_reference(model: str, name: str, seed: int, most: int) -> None:
    profile = PROFILES[model][name]
    rng = np.random.default_rng(seed)
    lowest = np.maximum(profile.plan.lowest[1:], -most)[:, None]
    highest = np.minimum(profile.plan.highest[1:], most)[:, None]
    numbers = rng.integers(lowest, highest, (len(profile.quantities), 50), endpoint=True)
    for row, quantity in enumerate(profile.quantities):
        if quantity.where is not None:
            names = [other.name for other in profile.quantities]
            numbers[row, numbers[names.index(quantity.where)] == 0] = 0
    assert (opaque(profile.cells(numbers)) == opaque(REFERENCES[model, name](numbers))).all()
