"""The laws notice models that break them: each defect here is caught by the law that is for it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from terrafuse.lattice import Lattice
from terrafuse.models import MODELS, Layer, Model
from terrafuse.models.elevation import Elevation
from terrafuse.testing.models import ModelTests
from terrafuse.types import Array, Floats, Scan


@dataclass(frozen=True)
class Static(Elevation):
    """Keeps every law; the defects below are changes of it."""

    static: bool = True


class TakesTheNewer(Static):
    def fuse(self, older: Array, newer: Array, lattice: Lattice) -> Array:
        return newer.copy()


class FusesInPlace(Static):
    def fuse(self, older: Array, newer: Array, lattice: Lattice) -> Array:
        older[:] = super().fuse(older, newer, lattice)
        return older


class PrefersTheFirst(Static):
    def fuse(self, older: Array, newer: Array, lattice: Lattice) -> Array:
        return np.where(self.known(older), older, newer)


class ZerosAreKnown(Static):
    def known(self, cells: Array) -> Array:
        return np.ones(cells.shape, bool)


class LosesCellsWhenCoarse(Static):
    def coarsen(self, cells: Array, factor: int) -> Array:
        return cells[::factor, ::factor].copy()


class ForgetsASetting(Static):
    def settings(self) -> dict[str, Any]:
        return {name: value for name, value in super().settings().items() if name != "traversability_cells"}


class Remembers(Static):
    """Its observer adds the scan before."""

    def observer(self, lattice: Lattice) -> Any:
        observe, before = super().observer(lattice), np.empty((0, 3))

        def both(scan: Scan) -> Any:
            nonlocal before
            points = np.concatenate([scan.points, before])
            before = scan.points[np.isfinite(scan.points).all(axis=1)]
            return observe(replace(scan, points=points))

        return both


class LooksAside(Static):
    """A layer that reads a neighbour and says that it does not."""

    @property
    def layers(self) -> Mapping[str, Layer]:
        def beside(cells: Array, reading: Any) -> Floats:
            n = np.roll(cells["n"].astype(float), 1, axis=-1)
            return np.where(self.known(cells), n, np.nan)

        return {"height": Layer("height", "1", "points of the cell beside", beside)}


class Unsure(Static):
    @property
    def occupied(self) -> Layer:
        return Layer("obstacle", "1", "in percent", lambda c, _: np.where(self.known(c), 100.0, np.nan))


class Stale(Static):
    """Its tile tells what changed without saying when."""

    def tile(self, lattice: Lattice) -> Any:
        tile = super().tile(lattice)
        changed = tile.changed

        def unstamped(since: int) -> tuple[Array, Array]:
            at, cells = changed(since)
            cells["stamp"] = 0
            return at, cells

        tile.changed = unstamped  # type: ignore[method-assign]
        return tile


class Laws(ModelTests):
    gaps = frozenset({"traversability", "obstacle"})
    fuse_associates = coarsen_composes = True


DEFECTS = [
    (TakesTheNewer, "test_unknown_is_neutral_to_fuse"),
    (FusesInPlace, "test_fuse_is_a_function_of_two_cells"),
    (PrefersTheFirst, "test_fuse_commutes"),
    (ZerosAreKnown, "test_zeros_are_unknown"),
    (LosesCellsWhenCoarse, "test_coarsening_gives_a_cell_for_each_square"),
    (ForgetsASetting, "test_a_store_can_make_it_again"),
    (Remembers, "test_a_scan_of_nothing_changes_nothing"),
    (Remembers, "test_paging_and_restarting_change_nothing"),
    (LooksAside, "test_layers_keep_the_laws_of_layers"),
    (Unsure, "test_occupied_is_a_share"),
    (Stale, "test_what_a_scan_changed_is_known_and_carries_its_revision"),
]


def check(model: Model, law: str) -> None:
    """The law over one model, on a seed where it is for many."""
    test = getattr(Laws, law)
    extra = {"factor": 2} if "coarsening_gives" in law else {}
    if hasattr(test, "hypothesis"):
        test.hypothesis.inner_test(Laws(), model, seed=1, **extra)
    else:
        test(Laws(), model)


@pytest.fixture(autouse=True)
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Under the name that they have from the model that they break."""
    monkeypatch.setitem(MODELS, "elevation", Static)


@pytest.mark.parametrize(("broken", "law"), DEFECTS)
def test_a_defect_is_caught(monkeypatch: pytest.MonkeyPatch, broken: type[Static], law: str) -> None:
    check(Static(), law)
    monkeypatch.setitem(MODELS, "elevation", broken)
    with pytest.raises(AssertionError):
        check(broken(traversability_cells=7), law)
