"""The elevation model: layers, laws, and statistics against plain NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from terrafuse.errors import InputError
from terrafuse.kernels import absorb
from terrafuse.lattice import Lattice
from terrafuse.mapper import Mapper
from terrafuse.models import fold, make_model
from terrafuse.replica import Replica
from terrafuse.testing.deltas import SECOND_NS, random_scans, scan_of
from terrafuse.types import Array
from terrafuse.views import chosen_layers, mosaic

LATTICE = Lattice(1.0, 4.0)
GRID = Lattice(1.0, 8.0)


def layers_of(*scans, model=None, lattice=LATTICE) -> dict[str, Array]:
    """Layers over the one tile (0, 0), after these scans by one robot."""
    mapper = Mapper("r1", lattice, model)
    for k, points in enumerate(scans):
        mapper.integrate(scan_of(points, k * SECOND_NS))
    replica = Replica(lattice, mapper.model)
    replica.apply(mapper.delta())
    return mosaic(replica, chosen_layers(replica, None), (0, 0, 4, 4))


def column(*heights: float) -> list[tuple[float, float, float]]:
    return [(0.5, 0.5, z) for z in heights]


def at(layers: dict[str, Array], name: str) -> float:
    return float(layers[name][0, 0])


def test_statistics_of_a_cell() -> None:
    layers = layers_of(column(1.0, 2.0, 4.0), model=make_model("elevation", {"static": True}))
    assert at(layers, "n") == 3
    assert at(layers, "z_mean") == pytest.approx(7 / 3, abs=1e-6)
    assert at(layers, "z_var") == pytest.approx(14 / 9, abs=1e-6)
    assert (at(layers, "z_min"), at(layers, "z_max")) == pytest.approx((1, 4))
    assert np.isnan(layers["z_mean"][1, 1])
    assert np.isnan(layers["n"][1, 1])


def test_variance_includes_the_distance_of_means() -> None:
    """Two merges of one height each: the variance is that of both together, 0.04² = 0.0016."""
    layers = layers_of(column(1.0), column(1.08))
    assert at(layers, "z_var") == pytest.approx(0.0016, abs=1e-7)
    assert at(layers, "changes") == 0


def test_height_is_the_mean_of_flat_cells_and_the_top_of_vertical_ones() -> None:
    assert at(layers_of(column(1.0, 1.1)), "height") == pytest.approx(1.05)
    wall = layers_of(column(0.0, 1.0, 2.0))
    assert at(wall, "state") == 2
    assert at(wall, "height") == pytest.approx(2.0)


def test_two_points_are_never_vertical() -> None:
    assert at(layers_of(column(0.0, 3.0)), "state") == 1


def test_dynamic_is_the_posterior_of_changes() -> None:
    """Three merges of which the second changed the surface and the third changed it back: (2 + 1)/(3 + 2)."""
    layers = layers_of(column(0.0), column(1.0), column(0.0))
    assert at(layers, "changes") == 2
    assert at(layers, "dynamic") == pytest.approx(3 / 5)
    assert at(layers, "height") == pytest.approx(0.0)
    assert at(layers, "n") == 2  # the ground that was there came back, with what it was


def test_the_lower_of_two_covered_surfaces_is_the_ground() -> None:
    """A car passes: ground, hood, its vertical front, ground. The hood must not become the ground."""
    layers = layers_of(column(0.0, 0.0), column(1.0), column(0.2, 0.9, 1.5), column(0.0))
    assert at(layers, "height") == pytest.approx(0.0)
    assert at(layers, "n") == 3


@pytest.mark.parametrize("resolution_m", [0.1, 0.5, 1.0, 2.0])
def test_a_hillside_does_not_move(resolution_m: float) -> None:
    """Looks at different parts of one sloping cell are not changes, however large the cell; a car on it is one."""
    rng = np.random.default_rng(1)
    lattice = Lattice(resolution_m, 4 * resolution_m)
    looks = []
    for _ in range(20):
        xy = rng.uniform(0, 4 * resolution_m, (60, 2))
        looks.append(np.column_stack([xy, 0.35 * xy[:, 0] + rng.normal(0, 0.01, 60)]))
    layers = layers_of(*looks, lattice=lattice)
    assert np.nansum(layers["changes"]) == 0
    assert np.nansum(layers["n"]) == 20 * 60
    car = looks[0] + (0, 0, 1.5)
    assert np.nanmean(layers_of(*looks, car, lattice=lattice)["changes"]) > 0.5


def test_stamps() -> None:
    layers = layers_of(column(0.0), column(0.0))
    assert at(layers, "stamp") == pytest.approx(1.0)


def test_traversability_of_slopes_steps_and_the_unknown() -> None:
    lattice = Lattice(0.5, 10.0)
    x, y = (a.ravel() for a in np.meshgrid(np.arange(20) * 0.5 + 0.25, np.arange(20) * 0.5 + 0.25))

    def middle(z: Array) -> float:
        layers = layers_of(np.column_stack([x, y, z]), lattice=lattice)
        return float(layers["traversability"][2, 2])

    assert middle(np.zeros_like(x)) == pytest.approx(1.0)
    # A slope of 0.2: roughness 0.04 of 0.25 that are impassable.
    assert middle(0.2 * x) == pytest.approx(1 - 0.04 / 0.25, abs=1e-4)
    assert middle(0.3 * x + 0.4 * y) == 0.0
    assert middle(np.where(x > 1.2, 1.0, 0.0)) == 0.0
    lonely = layers_of([(5.0, 5.0, 0.0)], lattice=lattice)
    assert np.isnan(lonely["traversability"]).all()


def records(seed: int, count: int = 40) -> Array:
    """Cells as mappers make them, some unknown."""
    mapper = Mapper("r", GRID)
    for scan in random_scans(seed, 1 + seed % 6, extent_m=16.0, points=120):
        mapper.integrate(scan)
    dense = np.zeros(64, absorb.CELL)
    for tile in mapper.delta().tiles:
        dense[tile.at] = tile.cells
    return dense


@given(seed=st.integers(0, 10_000))
@settings(max_examples=40)
def test_unknown_is_neutral_to_fuse(seed: int) -> None:
    model, cells = make_model("elevation"), records(seed)
    nothing = np.zeros_like(cells)
    np.testing.assert_array_equal(model.fuse(cells, nothing, GRID), cells)
    np.testing.assert_array_equal(model.fuse(nothing, cells, GRID), cells)


@given(seeds=st.lists(st.integers(0, 10_000), min_size=2, max_size=5, unique=True))
@settings(max_examples=40)
def test_static_fusing_is_commutative_and_associative(seeds: list[int]) -> None:
    model = make_model("elevation", {"static": True})
    cells = [records(seed) for seed in seeds]
    for part in cells:  # what the dynamic rule cached has no place in a static map
        for name in absorb.CELL.names or ():
            if name.startswith("ground"):
                part[name] = 0
    there, back = cells[0], cells[-1]
    for newer in cells[1:]:
        there = model.fuse(there, newer, GRID)
    for newer in cells[-2::-1]:
        back = model.fuse(back, newer, GRID)
    np.testing.assert_array_equal(there, back)


@given(seeds=st.lists(st.integers(0, 10_000), min_size=2, max_size=5, unique=True))
@settings(max_examples=40)
def test_the_fold_takes_robots_by_stamp_then_name(seeds: list[int]) -> None:
    """Cell by cell, it is `fuse` over the known cells in the order (stamp, robot)."""
    model = make_model("elevation")
    cells = [records(seed) for seed in seeds]
    folded = fold(model, cells, GRID)
    for k in range(64):
        known = [(int(part["stamp"][k]), name, part[k : k + 1]) for name, part in enumerate(cells) if part["n"][k]]
        expected = np.zeros(1, absorb.CELL)
        for _, _, part in sorted(known, key=lambda entry: entry[:2]):
            expected = model.fuse(expected, part, GRID)
        np.testing.assert_array_equal(folded[k : k + 1], expected)


@given(seed=st.integers(0, 10_000))
@settings(max_examples=20)
def test_coarsening_in_two_steps_is_coarsening_at_once(seed: int) -> None:
    model, cells = make_model("elevation"), records(seed).reshape(8, 8)
    np.testing.assert_array_equal(model.coarsen(model.coarsen(cells, 2), 2), model.coarsen(cells, 4))
    assert model.coarsen(cells, 8)["n"][0, 0] == cells["n"].sum()


def test_settings_are_checked() -> None:
    with pytest.raises(InputError, match="no cell model 'elevatoin'; there are: elevation"):
        make_model("elevatoin")
    with pytest.raises(InputError, match="no setting 'flat_tolerance'; there are: static, variance_threshold_m2"):
        make_model("elevation", {"flat_tolerance": 1})
    with pytest.raises(InputError, match="flat_tolerance_m 'wide': give a number"):
        make_model("elevation", {"flat_tolerance_m": "wide"})
    with pytest.raises(InputError, match="odd number"):
        make_model("elevation", {"traversability_cells": 4})
    with pytest.raises(InputError, match="positive"):
        make_model("elevation", {"flat_tolerance_m": 0})
    with pytest.raises(InputError, match="range gate"):
        make_model("elevation", {"min_range_m": 5, "max_range_m": 4})
