"""Heights on triangles: against whole arrays."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from terrafuse.kernels.ground import on_triangles, on_triangles_reference


@given(seed=st.integers(0, 2**31), rows=st.integers(2, 5), columns=st.integers(2, 5), count=st.integers(0, 60))
def test_as_the_reference(seed: int, rows: int, columns: int, count: int) -> None:
    """Within, on edges and corners, and outside."""
    rng = np.random.default_rng(seed)
    heights = rng.normal(size=(rows, columns))
    x, y = (
        np.where(rng.random(count) < 0.3, rng.integers(-1, 8, count) * 0.5, rng.uniform(-1, 4, count)) for _ in range(2)
    )
    x[rng.random(count) < 0.1] = np.nan
    found = tuple(np.empty(count) for _ in range(3))
    on_triangles(heights, -0.5, 0.25, 0.5, x, y, *found)
    for part, expected in zip(found, on_triangles_reference(heights, -0.5, 0.25, 0.5, x, y), strict=True):
        np.testing.assert_array_equal(part, expected)
