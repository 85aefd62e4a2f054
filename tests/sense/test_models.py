"""Described sensors feed the models that look along beams."""

from __future__ import annotations

import numpy as np
import pytest

from terrafuse import Lattice, Mapper, make_model
from terrafuse.models import Reading
from terrafuse.sense import Sensor, load_sensor, scan_of
from terrafuse.types import Pose

SONARS = [load_sensor(name) for name in ("nomad_200_sonar", "soccer_robot_sonar", "scitos_g5_sonar")]


@pytest.mark.parametrize("sonar", SONARS, ids=lambda sonar: sonar.name)
@pytest.mark.parametrize("model", ["occupancy", "grey"])
def test_silence_clears_and_marks_nothing(model: str, sonar: Sensor) -> None:
    """One echo at 1 m ahead marks cells there; with silence all around, no cell is more than half occupied."""
    one_echo = np.full(sonar.beams.count, np.inf)
    one_echo[0] = 1.0
    marked = [occupied(model, sonar, ranges) for ranges in (one_echo, np.full(sonar.beams.count, np.inf))]
    assert len(marked[0]) > 0
    assert np.abs(np.linalg.norm(marked[0], axis=1) - (1.0 + sonar.radius_m)).max() < sonar.range_error_m + 0.1
    assert (marked[0][:, 0] > 0.7).all()
    assert len(marked[1]) == 0


def occupied(model: str, sonar: Sensor, ranges: np.ndarray) -> np.ndarray:
    """Centres of the cells that are rather occupied than not, (K, 2) metres."""
    lattice = Lattice(0.05, 2.0)
    mapper = Mapper("r1", lattice, make_model(model))
    mapper.integrate(scan_of(sonar, ranges, 1, Pose.identity()))
    found = []
    for tile in mapper.delta().tiles:
        cells = np.zeros(lattice.tile_cells**2, mapper.model.cell)
        cells[tile.at] = tile.cells
        share = mapper.model.occupied.compute(cells.reshape(lattice.tile_cells, -1), Reading(lattice, 1))
        j, i = np.nonzero(np.nan_to_num(share) > 0.5 + 1e-6)
        corner = np.array([tile.key.x, tile.key.y]) * lattice.tile_cells
        found.append((np.stack([i, j], axis=1) + corner + 0.5) * lattice.resolution_m)
    return np.concatenate(found)
