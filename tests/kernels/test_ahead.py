"""What is in a robot's way: against whole arrays, and by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from terrafuse.kernels.ahead import in_the_way, in_the_way_reference
from terrafuse.types import Pose


@given(seed=st.integers(0, 2**31), count=st.integers(0, 50), single=st.booleans())
def test_as_the_reference(seed: int, count: int, single: bool) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-6, 6, (count, 3)).astype(np.float32 if single else np.float64)
    matrix = Pose.from_quaternion(rng.normal(size=3), rng.normal(size=4)).matrix
    limits = (5.0, 0.25, 0.15, 1.6)
    np.testing.assert_allclose(
        in_the_way(points, matrix, *limits), in_the_way_reference(points, matrix, *limits), atol=1e-9
    )


@pytest.mark.parametrize(
    ("point", "there"),
    [
        ((3.0, 4.0, 0.1), True),  # 5 m away; 1 m up with the sensor's 0.9: 0.25 + 0.15·5 = 1.0 at least
        ((3.0, 4.0, 0.09), False),
        ((3.0, 4.0, 0.7), False),  # 1.6 m up: passes beneath
        ((3.6, 4.8, 0.5), False),  # 6 m away
        ((0.0, 0.0, -0.64), True),  # 0.26 m up
        ((0.0, 0.0, -0.66), False),
    ],
)
def test_limits(point: tuple[float, float, float], there: bool) -> None:
    matrix = Pose.identity().shifted(0.0, 0.0, 0.901).matrix
    assert len(in_the_way(np.array([point]), matrix, 6.0, 0.25, 0.15, 1.6)) == there
