"""The maps that these tests export; nobody changes them."""

from __future__ import annotations

import pytest

from terrafuse.lattice import Lattice
from terrafuse.replica import Replica
from tests.export.maps import UTM, filled, points_over


@pytest.fixture(scope="session")
def local_map() -> Replica:
    """12 m × 9 m of two robots in a local frame, in 4 m tiles."""
    return filled(Lattice(0.1, 4.0), points_over(12, 9), east_m=-3.3, north_m=-5.1, robots=("alpha", "beta"))


@pytest.fixture(scope="session")
def utm_map() -> Replica:
    """The same kind of place on a mountain in a UTM zone."""
    return filled(Lattice(0.1, 4.0, UTM), points_over(12, 9), 500_000.0, 4_000_000.3, 1000.0)


@pytest.fixture(scope="session")
def empty_map() -> Replica:
    return Replica(Lattice(0.1, 4.0))
