import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from terrafuse.kernels.cones import cone, cone_capacity, cone_reference


@given(
    st.floats(-20, 20),
    st.floats(-20, 20),
    st.floats(-math.pi, math.pi) | st.integers(-8, 8).map(lambda k: k * math.pi / 8),
    st.floats(0.01, math.pi) | st.integers(1, 16).map(lambda k: k * math.pi / 16),
    st.floats(0.0, 3.0),
    st.sampled_from([1.0, 4.0, 10.0]),
)
def test_cone_equals_its_reference(
    x: float, y: float, heading: float, half_angle: float, reach: float, cells_per_m: float
) -> None:
    room = cone_capacity(reach, cells_per_m)
    i, j = np.empty(room, np.int64), np.empty(room, np.int64)
    rho, theta = np.empty(room), np.empty(room)
    count = cone(x, y, math.cos(heading), math.sin(heading), half_angle, reach, cells_per_m, i, j, rho, theta, 0)
    found = {(int(a), int(b)): (r, t) for a, b, r, t in zip(i[:count], j[:count], rho, theta, strict=False)}
    expected = cone_reference(x, y, heading, half_angle, reach, cells_per_m)
    close = 1e-9  # a cell right on the rim may fall either way
    for cell in found.keys() ^ expected.keys():
        r, t = (found | expected)[cell]
        assert min(abs(r - reach), abs(t - half_angle)) < close
    for cell in found.keys() & expected.keys():
        assert found[cell] == pytest.approx(expected[cell], abs=1e-7)


def test_a_cone_of_no_length_is_the_cell_of_its_apex() -> None:
    i, j = np.empty(9, np.int64), np.empty(9, np.int64)
    rho, theta = np.empty(9), np.empty(9)
    assert cone(0.31, 0.22, 1.0, 0.0, 0.2, 0.0, 10.0, i, j, rho, theta, 0) == 1
    assert (i[0], j[0], theta[0]) == (3, 2, 0.0)
