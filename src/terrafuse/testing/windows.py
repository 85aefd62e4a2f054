"""What every window must do."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from terrafuse.exchange.codec import encode
from terrafuse.lattice import Lattice
from terrafuse.mapper import Mapper
from terrafuse.models import make_model
from terrafuse.store.memory import MemoryStore
from terrafuse.testing.layers import LATTICE
from terrafuse.testing.scans import mixed_scans
from terrafuse.window import Window

PLACES = [(0.0, 0.0), (3.99, -0.01), (1e6, -1e6), (-4.0, 4.0)]


class WindowTests:
    """Subclass, and define the fixture `make`: what makes a new window for a lattice, as the one in WINDOWS does."""

    @pytest.fixture
    def make(self) -> Callable[[Lattice], Window]:
        raise NotImplementedError

    @pytest.mark.parametrize("place", PLACES)
    def test_the_robots_own_tile_is_inside(self, make: Callable[[Lattice], Window], place: tuple[float, float]) -> None:
        assert LATTICE.tile_at(*place) in make(LATTICE).around(*place)

    def test_a_robot_that_stands_still_has_a_window_that_does(self, make: Callable[[Lattice], Window]) -> None:
        window = make(LATTICE)
        first = window.around(1.0, 2.0)
        assert window.around(1.0, 2.0) == first

    def test_the_same_way_gives_the_same_windows(self, make: Callable[[Lattice], Window]) -> None:
        way = np.cumsum(np.random.default_rng(1).normal(0, 2, (200, 2)), axis=0).tolist()
        one, two = make(LATTICE), make(LATTICE)
        assert [one.around(*place) for place in way] == [two.around(*place) for place in way]

    @pytest.mark.parametrize("seed", range(5))
    def test_it_makes_no_difference_to_the_map(self, make: Callable[[Lattice], Window], seed: int) -> None:
        model = make_model("elevation")
        whole = Mapper("r", LATTICE, model)
        paged = Mapper("r", LATTICE, model, make(LATTICE), MemoryStore(LATTICE, model))
        for k, scan in enumerate(mixed_scans(seed, 12)):
            here = scan.T_world_sensor.shifted(3.0 * k, 0.0)
            for mapper in (whole, paged):
                mapper.integrate(type(scan)(scan.stamp_ns, scan.points, here))
        assert encode(paged.delta()) == encode(whole.delta())
