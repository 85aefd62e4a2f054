"""The terrain model against known truth. The figures stand in docs/accuracy.md; `accuracy_terrain` measures them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from terrafuse.models.terrain import Terrain
from tests import accuracy_terrain


@pytest.mark.parametrize(("points", "least"), [(3, 0.7), (4, 0.93), (5, 0.98), (20, 1.0)])
def test_planes_without_noise_are_exact(points: int, least: float) -> None:
    """For at least such a share of cells with points anywhere; the others are on a line by what 1 cm of noise makes."""
    error, _ = accuracy_terrain.plane_errors(points, 0.0)
    made = np.isfinite(error[:, 0])
    assert made.mean() >= least
    assert np.abs(error[made]).max() < 1e-6


@pytest.mark.parametrize("points", [3, 4, 20])
def test_a_perfect_sensor_makes_every_plane(points: int) -> None:
    error, _ = accuracy_terrain.plane_errors(points, 0.0, model=Terrain(max_range_m=1e8, point_sigma_m=1e-7))
    assert np.abs(error).max() < 1e-3


@pytest.mark.parametrize("points", [3, 5, 20, 200])
def test_planes_err_by_the_standard_error_of_least_squares(points: int) -> None:
    """With 1 cm of noise: errors over their standard errors have the deviation 1, and 95 % lie within 2."""
    error, standard = accuracy_terrain.plane_errors(points, 0.01)
    score = (error / standard)[np.isfinite(error[:, 0])]
    assert np.sqrt(np.mean(score**2, axis=0)) == pytest.approx([1, 1, 1], abs=0.12)
    assert (np.abs(score) <= 2).mean() == pytest.approx(0.954, abs=0.02)


def test_ten_thousand_points_give_slopes_to_a_thousandth() -> None:
    """1 cm of noise, standard deviation 0.144 m along an axis: 0.01/(0.144 · 100) = 0.0007."""
    error, standard = accuracy_terrain.plane_errors(10_000, 0.01, side=6)
    assert standard[:, 1:] == pytest.approx(0.0007, abs=0.00002)
    assert np.sqrt(np.mean(error[:, 1:] ** 2)) < 1e-3


@pytest.mark.parametrize("dem", [accuracy_terrain.surveyed_ground, accuracy_terrain.island])
def test_gradients_of_a_real_dem_are_numpys(recordings: Path, dem) -> None:
    differences = accuracy_terrain.dem_differences(*dem(recordings))
    assert differences["cells with both gradients of NumPy"] > 500
    assert differences["steepest slope"] > 0.1
    for name in ("gradient_x", "gradient_y", "occupation"):
        assert differences[f"largest difference of {name}"] < 1e-5


@pytest.mark.parametrize("tilt_deg", [0.0, 0.2])
def test_the_sure_cells_err_less_than_the_unsure_ones(tilt_deg: float) -> None:
    thirds = accuracy_terrain.calibration(12, tilt_deg, 0.1 * tilt_deg, 0.5, 1)
    bottom, top = thirds["bottom third"], thirds["top third"]
    for name in (
        "RMSE of height (m)", "95 % of height errors (m)", "gradient unknown", "occupation unknown",
        "95 % of gradient errors where there is an occupation",
    ):  # fmt: skip
        assert top[name] < bottom[name], name


def test_gradients_err_by_what_the_map_says() -> None:
    """In cells of 0.2 m, which hills hardly bend: 99 % within three standard errors."""
    for third in accuracy_terrain.calibration(12, 0.0, 0.0, 0.2, 1).values():
        assert third["gradients within three stated errors"] > 0.97
