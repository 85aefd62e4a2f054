"""Every model of MODELS keeps the laws; what each claims beyond them stands here."""

from __future__ import annotations

import pytest

from terrafuse.models import MODELS, Model, make_model
from terrafuse.testing.models import ModelTests
from terrafuse.testing.scans import mixed_scans, sonar
from terrafuse.types import Scan


class LawsOf(ModelTests):
    """The laws over a model of MODELS, as it is by default or with some settings."""

    name: str
    settings: dict[str, object] = {}  # noqa: RUF012

    @pytest.fixture
    def model(self) -> Model:
        return make_model(self.name, self.settings)


class TestElevation(LawsOf):
    """Which surface came later decides, so the order of the fold counts."""

    name = "elevation"
    fuse_commutes = False
    coarsen_composes = True
    gaps = frozenset({"traversability", "obstacle"})


class TestStaticElevation(TestElevation):
    """Without the dynamic rule statistics just add."""

    settings = {"static": True}  # noqa: RUF012
    fuse_commutes = fuse_associates = True


class TestTerrain(LawsOf):
    """Stamps say which cell is newer, whatever the order of the two; which of three surfaces meet first decides.
    Coarsening composes only to rounding, and not where gradients are unknown. A look that contradicts a cell leaves its
    stamp."""

    name = "terrain"
    changes_restamp = False
    gaps = frozenset({"gradient_x", "gradient_y", "gradient_error", "occupation", "gps_quality", "communications"})


class TestOccupancy(LawsOf):
    """Evidence adds, so whoever saw it counts once and the order does not."""

    name = "occupancy"
    fuse_associates = coarsen_composes = True


class TestGrey(LawsOf):
    """Bounds of bounds: idempotent; not associative where two intervals contradict each other."""

    name = "grey"
    fuse_is_idempotent = coarsen_composes = True

    def scans(self, seed: int, count: int) -> list[Scan]:
        return mixed_scans(seed, count, (sonar,))


class TestGreyInAChangingWorld(TestGrey):
    """Only its merge is another."""

    settings = {"mode": "changing"}  # noqa: RUF012


def test_every_model_is_tested_here() -> None:
    assert {laws.name for laws in LawsOf.__subclasses__()} == set(MODELS)
