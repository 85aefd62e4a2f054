"""What every layer must do, a model's own or one that was added to it."""

from __future__ import annotations

import numpy as np
import pytest

from terrafuse import views
from terrafuse.lattice import Lattice
from terrafuse.models.base import Layer, Model
from terrafuse.models.layers import layers_of
from terrafuse.replica import Replica
from terrafuse.testing.deltas import deltas_of
from terrafuse.testing.scans import mixed_scans
from terrafuse.types import Array, Floats, Scan

LATTICE = Lattice(0.5, 4.0)
MARGIN = 2
"""Unknown cells around the map: a layer meets them, too."""


def sample_map(model: Model, robots: list[list[Scan]], lattice: Lattice = LATTICE) -> Replica:
    """The map of robots that made these scans."""
    replica = Replica(lattice, model)
    for k, scans in enumerate(robots):
        for delta in deltas_of(f"r{k}", scans, lattice, model, every=len(scans)):
            replica.apply(delta)
    return replica


def cells_of(replica: Replica) -> Array:
    """All cells of a map and some around them, (H, W) [j, i]."""
    i0, j0, i1, j1 = views.window_of(replica, None)
    window = (i0 - MARGIN, j0 - MARGIN, i1 + MARGIN, j1 + MARGIN)
    return views.cells_in(replica, window, frozenset(replica.keys))


def check_layer(layer: Layer, replica: Replica, gaps: bool) -> Floats:
    """Assert what holds for every layer over this map; `gaps`: it may be NaN where the cell is known, too.

    Returns the layer's values.
    """
    cells, known = cells_of(replica), replica.model.known(cells_of(replica))
    before = cells.tobytes()
    values = layer.compute(cells, replica.reading)
    assert (values.dtype, values.shape) == (np.dtype(np.float64), cells.shape), (
        f"{layer.name}: float64, of the cells' shape"
    )
    assert cells.tobytes() == before, f"{layer.name}: must not change the cells that it reads"
    assert not np.isinf(values).any(), f"{layer.name}: infinite; NaN says that there is no value"
    if not layer.halo:  # views hide what a layer that looks at neighbours says of a cell that nobody saw
        assert np.isnan(values[~known]).all(), f"{layer.name}: has values where the cell is unknown"
    assert gaps or not np.isnan(values[known]).any(), f"{layer.name}: is NaN where the cell is known"
    _check_halo(layer, replica, cells, values)
    return values


def _check_halo(layer: Layer, replica: Replica, cells: Array, whole: Array) -> None:
    """A cell's value is the same whatever is computed with it, as long as its halo is."""
    height, width = cells.shape
    for j in range(layer.halo, height - layer.halo, 3):
        for i in range(layer.halo, width - layer.halo, 3):
            around = slice(j - layer.halo, j + layer.halo + 1), slice(i - layer.halo, i + layer.halo + 1)
            alone = layer.compute(np.ascontiguousarray(cells[around]), replica.reading)[layer.halo, layer.halo]
            np.testing.assert_allclose(
                alone, whole[j, i], rtol=1e-6, atol=1e-9,
                err_msg=f"{layer.name}: depends on cells more than halo = {layer.halo} away",
            )  # fmt: skip


class LayerTests:
    """Subclass, set `layer`, and define the fixture `model`: the model that the layer was added to."""

    layer: str
    gaps = False
    """Whether the layer may be NaN also where the cell is known (as one that needs neighbours is at edges)."""

    def scans(self, seed: int) -> list[Scan]:
        """What robots see; override it where the layer needs sensors of its own kind."""
        return mixed_scans(seed, 4)

    @pytest.fixture
    def model(self) -> Model:
        raise NotImplementedError

    def test_is_among_the_models_layers(self, model: Model) -> None:
        layer = layers_of(model)[self.layer]
        assert (layer.name, bool(layer.unit), bool(layer.description)) == (self.layer, True, True)

    @pytest.mark.parametrize("seed", range(5))
    def test_keeps_the_laws_of_layers(self, model: Model, seed: int) -> None:
        replica = sample_map(model, [self.scans(seed), self.scans(seed + 100)])
        check_layer(layers_of(model)[self.layer], replica, self.gaps)
