"""Fixtures that all tests share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def recordings() -> Path:
    """The folder of real recordings; tests that need one skip where it is not there."""
    folder = os.environ.get("TERRAFUSE_RECORDINGS")
    if not folder:
        pytest.skip("TERRAFUSE_RECORDINGS is not set: no real recordings here")
    return Path(folder)
