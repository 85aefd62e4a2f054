"""Fixtures that all tests share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import settings

from tests.program import record, terrafuse

# The first example compiles a kernel: how long one takes says nothing.
settings.register_profile("terrafuse", deadline=None)
settings.load_profile("terrafuse")


@pytest.fixture(scope="session")
def recordings() -> Path:
    """The folder of real recordings; tests that need one skip where it is not there."""
    folder = os.environ.get("TERRAFUSE_RECORDINGS")
    if not folder:
        pytest.skip("TERRAFUSE_RECORDINGS is not set: no real recordings here")
    return Path(folder)


@pytest.fixture(scope="session")
def logs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Logs of two robots, 40 scans each."""
    folder = tmp_path_factory.mktemp("logs")
    return {"r1": record(folder / "r1.mcap", 1, 40), "r2": record(folder / "r2.mcap", 2, 40, shift_m=8.0)}


@pytest.fixture(scope="session")
def mapped(tmp_path_factory: pytest.TempPathFactory, logs: dict[str, Path]) -> Path:
    """The folder of a finished mapping run of `logs` in EPSG:32632."""
    out = tmp_path_factory.mktemp("mapped") / "out"
    ran = terrafuse(
        "map", *(f"{name}={log}" for name, log in logs.items()),
        "--resolution", "0.2", "--crs", "EPSG:32632", "--origin", "500000,4000000", "--out", out,
    )  # fmt: skip
    assert ran.code == 0, ran.err
    return out
