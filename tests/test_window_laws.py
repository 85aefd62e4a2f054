"""Every window of WINDOWS, with its own numbers, keeps the laws."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from terrafuse.testing.windows import WindowTests
from terrafuse.window import WINDOWS, Window


class TestWindows(WindowTests):
    @pytest.fixture(params=sorted(WINDOWS))
    def make(self, request: pytest.FixtureRequest) -> Callable[..., Window]:
        return WINDOWS[request.param]
