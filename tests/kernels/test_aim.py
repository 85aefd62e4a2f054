"""Where beams end: against whole arrays."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from terrafuse.kernels.aim import ends, ends_reference


@given(seed=st.integers(0, 2**31), count=st.integers(0, 40), radius=st.sampled_from([0.0, 0.3]))
def test_as_the_reference(seed: int, count: int, radius: float) -> None:
    rng = np.random.default_rng(seed)
    outward, directions = rng.normal(size=(2, 10, 3))
    beams, lengths, origin = rng.integers(0, 10, count), rng.uniform(0, 60, count), rng.normal(size=3)
    given_ = (origin, radius, outward, directions, beams, lengths)
    np.testing.assert_array_equal(ends(*given_), ends_reference(*given_))
