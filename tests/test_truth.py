"""The map against truth that others surveyed or computed. The figures stand in docs/accuracy.md."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests import accuracy


@pytest.mark.parametrize("settings", [{}, accuracy.STATIC], ids=["dynamic", "static"])
def test_surveyed_ground(recordings: Path, settings: dict[str, object]) -> None:
    errors = accuracy.av2_errors(recordings, 0.1, settings)
    assert errors["cells on the raster"] > 20_000
    assert errors["median distance of z_min (m)"] <= 0.04
    assert errors["0.3 m or more below"] <= 0.001


def test_pdal_grid(recordings: Path) -> None:
    ours, theirs = accuracy.pdal_grids(recordings)
    np.testing.assert_array_equal(ours["count"], theirs["count"])
    for name in ("min", "max", "mean", "stdev"):
        np.testing.assert_allclose(ours[name], theirs[name], atol=1e-3)


def test_statistics_equal_plain_numpy(recordings: Path) -> None:
    for name, scans, resolution_m in accuracy.statistics_cases(recordings):
        worst = accuracy.worst_differences(scans, resolution_m)
        assert worst["cells"] > 10_000, name
        assert worst["n"] == 0, name
        assert max(worst["z_mean"], worst["z_min"], worst["z_max"]) < 1e-3, name
        assert worst["z_var"] < 1e-4, name
