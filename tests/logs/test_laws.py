"""Readers of each kind keep the laws: text, binary with an index, a folder."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from terrafuse.logs import READERS, Reader
from terrafuse.testing.readers import ReaderTests
from tests.program import record

from .support import some_points, write_tum
from .test_carmen import flaser, write
from .test_ranges import write as write_ranges


class TestCarmen(ReaderTests):
    @pytest.fixture
    def reader(self) -> Reader:
        return READERS["carmen"]

    @pytest.fixture
    def sample(self, tmp_path: Path) -> Path:
        return write(tmp_path, *(flaser(f"97605285{k}.5", [3.0 + k] * 180) for k in range(5)))


class TestRanges(ReaderTests):
    aimed = True

    @pytest.fixture
    def reader(self) -> Reader:
        return READERS["ranges"]

    @pytest.fixture
    def sample(self, tmp_path: Path) -> Path:
        lines = [f"{k}.5,{k},0,0.1,{3.0 + k},{4.0 + k}" for k in range(5)]
        return write_ranges(tmp_path, "stamp_s,x_m,y_m,yaw_rad,r0_m,r1_m", *lines)


class TestMcap(ReaderTests):
    @pytest.fixture
    def reader(self) -> Reader:
        return READERS["ros"]

    @pytest.fixture
    def sample(self, tmp_path: Path) -> Path:
        pytest.importorskip("mcap")
        return record(tmp_path / "log.mcap", 1, 5, points=50)


class TestClouds(ReaderTests):
    options = {"poses": "../poses.txt"}  # noqa: RUF012

    @pytest.fixture
    def reader(self) -> Reader:
        return READERS["clouds"]

    @pytest.fixture
    def sample(self, tmp_path: Path) -> Path:
        folder = tmp_path / "clouds"
        folder.mkdir()
        for k in range(3):
            np.save(folder / f"{1_700_000_000 + k}.npy", some_points(seed=k))
        write_tum(tmp_path / "poses.txt", [(str(1_700_000_000 + k), (k, 0, 0)) for k in range(3)])
        return folder
