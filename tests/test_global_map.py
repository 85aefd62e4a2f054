"""The global map at a coarser level: each robot's contribution coarsened, then folded."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from terrafuse.errors import LatticeError
from terrafuse.lattice import Lattice
from terrafuse.models import make_model
from terrafuse.replica import Replica
from terrafuse.testing.deltas import deltas_of, random_scans
from tests.program import terrafuse

LATTICE = Lattice(0.5, 4.0)
STATIC = make_model("elevation", {"static": True})


def replicas(factor: int, *robots: str) -> tuple[Replica, Replica]:
    """(fine, coarse) of the same contributions."""
    fine = Replica(LATTICE, STATIC)
    for k, robot in enumerate(robots):
        for delta in deltas_of(robot, random_scans(k + 1, 6), LATTICE, STATIC):
            fine.apply(delta)
    return fine, Replica(store=fine.store, factor=factor)


@pytest.mark.parametrize("factor", [2, 4, 8])
def test_each_cell_is_what_its_fine_cells_hold(factor: int) -> None:
    fine, coarse = replicas(factor, "r1", "r2")
    assert coarse.lattice == Lattice(0.5 * factor, 4.0)
    assert coarse.keys == fine.keys
    for key in fine.keys:
        blocks = fine.cells(key)["n"].reshape(8 // factor, factor, 8 // factor, factor)
        np.testing.assert_array_equal(coarse.cells(key)["n"], blocks.sum(axis=(1, 3)))


def test_one_robots_coarse_map_is_its_map_coarsened() -> None:
    fine, coarse = replicas(4, "r1")
    for key in fine.keys:
        expected = STATIC.coarsen(fine.cells(key), 4)
        np.testing.assert_array_equal(coarse.cells(key), expected)


def test_a_layer_of_it_has_coarse_coordinates() -> None:
    fine, coarse = replicas(4, "r1", "r2")
    whole = coarse.layer("n")
    assert abs(float(whole.x[1] - whole.x[0])) == 2.0
    assert float(whole.sum()) == float(fine.layer("n").sum())


def test_a_factor_divides_the_tile() -> None:
    with pytest.raises(LatticeError, match="factor 3 does not divide the 8 cells"):
        replicas(3, "r1")


def test_the_program_writes_it(tmp_path: Path, logs: dict[str, Path]) -> None:
    import rasterio

    named = [f"{name}={log}" for name, log in logs.items()]
    ran = terrafuse("map", *named, "--resolution", "0.5", "--global-factor", "10", "--out", tmp_path / "out", "--json")
    assert ran.code == 0, ran.err
    with rasterio.open(tmp_path / "out" / "global.tif") as raster:
        assert raster.res == (5.0, 5.0)
        count = raster.read(raster.descriptions.index("n") + 1, masked=True)
    assert ran.json["global"]["factor"] == 10
    assert ran.json["global"]["cells"] == int((~count.mask).sum())
    assert (tmp_path / "out" / "global.png").stat().st_size > 1000


def test_the_program_refuses_a_factor_that_does_not_fit(tmp_path: Path, logs: dict[str, Path]) -> None:
    ran = terrafuse("map", f"r1={logs['r1']}", "--global-factor", "7", "--tile", "40", "--out", tmp_path / "out")
    assert ran.code == 2
    assert "factor 7 does not divide the 400 cells" in ran.err
    assert not (tmp_path / "out").exists()
