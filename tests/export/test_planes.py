"""The plane kernel equals NumPy's least squares."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from terrafuse.kernels.planes import fit_planes, fit_planes_reference
from terrafuse.types import Array


def assert_same(z: Array, cells: int) -> None:
    got, expected = fit_planes(z, cells), fit_planes_reference(z, cells)
    np.testing.assert_array_equal(got[3], expected[3])
    spread = float(np.nanmax(z) - np.nanmin(z)) if np.isfinite(z).any() else 0.0
    size = max(1.0, spread, float(np.nanmax(np.abs(z), initial=0.0)) * 1e-3)
    for name, ours, theirs, power in zip("ab²", got, expected, (1, 1, 2), strict=False):
        np.testing.assert_array_equal(np.isnan(ours), np.isnan(theirs), err_msg=name)
        np.testing.assert_allclose(ours, theirs, rtol=1e-7, atol=1e-9 * size**power, err_msg=name)


@settings(max_examples=60)
@given(
    st.integers(1, 14),
    st.integers(1, 14),
    st.sampled_from([3, 5, 7, 15]),
    st.sampled_from([0.0, 0.1, 0.5, 0.9, 1.0]),
    st.sampled_from([0.0, 1000.0, -9000.0]),
    st.sampled_from([0.001, 1.0, 100.0]),
    st.integers(0, 2**32 - 1),
)
def test_any_heights(height: int, width: int, cells: int, known: float, up: float, relief: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    z = up + relief * rng.normal(size=(height, width))
    z[rng.random(z.shape) >= known] = np.nan
    assert_same(z, cells)


@settings(max_examples=60)
@given(st.lists(st.tuples(st.integers(0, 8), st.integers(0, 8), st.integers(-5, 5)), max_size=12))
def test_few_and_collinear_cells(cells: list[tuple[int, int, int]]) -> None:
    z = np.full((9, 9), np.nan)
    for j, i, height in cells:
        z[j, i] = height
    assert_same(z, 5)


def test_lines_have_no_plane() -> None:
    z = np.full((40, 40), np.nan)
    z[np.arange(40), np.arange(40)] = np.arange(40.0) ** 1.5
    for cells in (3, 5, 31):
        a, b, residual2, count = fit_planes(z, cells)
        assert np.isnan([a, b, residual2]).all()
        assert count.max() == cells


def test_a_plane_is_found_a_kilometre_up() -> None:
    j, i = np.mgrid[0:20, 0:30]
    a, b, residual2, _ = fit_planes(1000.0 + 0.02 * i - 0.03 * j, 5)
    np.testing.assert_allclose(a, 0.02, atol=1e-12)
    np.testing.assert_allclose(b, -0.03, atol=1e-12)
    np.testing.assert_allclose(residual2, 0.0, atol=1e-12)
