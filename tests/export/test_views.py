"""What exports are made from: whole maps assembled from tiles, without seams."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from terrafuse import views
from terrafuse.lattice import Lattice
from terrafuse.replica import Replica
from terrafuse.types import Array
from tests.export.maps import filled, points_over

POINTS = points_over(11.5, 8.6)


def whole(replica: Replica) -> dict[str, Array]:
    return views.mosaic(replica, views.chosen_layers(replica, None), views.window_of(replica, None))


@pytest.mark.parametrize("tile_m", [0.2, 0.5, 2.4, 4.0, 12.0])
def test_tiles_leave_no_seams(tile_m: float) -> None:
    """One tile over everything against many small ones: even layers that look at neighbours are the same, also where
    a tile is smaller than what they look at, and where there is no tile beside."""
    if tile_m == 0.2:
        points, shift = POINTS[POINTS[:, :2].max(axis=1) < 2.5], (-1.1, -0.7)
    else:
        points, shift = POINTS, (-6.3, -4.1)
    # A power of two, so that one large tile has the same cells as many.
    one = filled(Lattice(0.1, 25.6), points, 12.8 + shift[0], 12.8 + shift[1])
    many = filled(Lattice(0.1, tile_m), points, 12.8 + shift[0], 12.8 + shift[1])
    assert len(one.keys) == 1
    assert views.known_window(one) == views.known_window(many)
    for name, expected in whole(one).items():
        assert np.isfinite(expected).any()
        np.testing.assert_allclose(whole(many)[name], expected, rtol=1e-9, atol=1e-9, err_msg=name)


def test_layers_say_nothing_of_cells_that_nobody_saw(local_map: Replica) -> None:
    layers = whole(local_map)
    known = layers["n"] > 0
    assert 0.3 < known.mean() < 0.9
    for name, values in layers.items():
        assert np.isnan(values[~known]).all(), name
        if name != "traversability":
            assert not np.isnan(values[known]).any(), name


def test_statistics_are_those_of_the_arrays(local_map: Replica) -> None:
    known, statistics = views.statistics(local_map)
    layers = whole(local_map)
    assert known == np.count_nonzero(layers["n"] > 0)
    for name, values in layers.items():
        of = statistics[name]
        assert of.cells == np.count_nonzero(~np.isnan(values))
        assert (of.min, of.max) == (np.nanmin(values), np.nanmax(values))
        assert of.mean == pytest.approx(np.nanmean(values), rel=1e-9)
    assert list(statistics) == list(local_map.model.layers)


def test_an_empty_map_has_no_window_and_empty_statistics(empty_map: Replica) -> None:
    assert views.known_window(empty_map) is None
    known, statistics = views.statistics(empty_map)
    assert known == 0
    assert statistics["height"] == views.LayerStatistics("m", None, None, None, 0)


def test_the_known_window_looks_past_empty_outer_tiles() -> None:
    """A robot that is left out leaves its tiles behind, with nothing in them."""
    replica = filled(Lattice(0.1, 2.0), np.array([[4.25, 5.05, 1.0], [-9.0, -9.0, 1.0]]), robots=("near", "far"))
    without = Replica(store=replica.store, without=["far"])
    assert len(without.keys) == 2
    assert views.known_window(without) == (42, 50, 43, 51)
    assert views.known_window(replica) == (-90, -90, 43, 51)


@settings(max_examples=25)
@given(st.integers(1, 50), st.integers(-30, 40), st.integers(-30, 40), st.integers(1, 60), st.integers(1, 60))
def test_reduced_is_the_mean_of_the_known(
    local_map: Replica, factor: int, i0: int, j0: int, width: int, height: int
) -> None:
    window = (i0, j0, i0 + width, j0 + height)
    (layer,) = views.chosen_layers(local_map, ["height"])
    full = views.mosaic(local_map, [layer], window)["height"]
    got = views.reduced(local_map, layer, window, factor)
    assert got.shape == (-(-height // factor), -(-width // factor))
    for j, i in np.ndindex(*got.shape):
        block = full[j * factor : (j + 1) * factor, i * factor : (i + 1) * factor]
        known = block[~np.isnan(block)]
        assert np.isnan(got[j, i]) if not len(known) else got[j, i] == pytest.approx(known.mean(), abs=1e-9)


def test_every_tile_is_folded_less_than_twice() -> None:
    """A replica keeps few tiles; going through them in stripes makes that enough for layers with a halo."""
    j, i = np.mgrid[0:9, 0:9]
    points = np.column_stack([i.ravel() + 0.5, j.ravel() + 0.5, np.zeros(81)])
    replica = filled(Lattice(0.5, 1.0), points)
    folds = 0
    fold = replica._fold

    def counted(key):
        nonlocal folds
        folds += 1
        return fold(key)

    replica._fold = counted  # type: ignore[method-assign]
    views.statistics(replica)
    assert len(replica.keys) == 81
    assert folds < 2 * 81


def test_bounds_are_round_decimals() -> None:
    replica = filled(Lattice(0.1, 4.0), np.array([[0.05, 0.05, 0.0]]), 500_000.0, 4_000_009.3)
    assert views.bounds_of(replica, views.window_of(replica, None)) == (500_000.0, 4_000_009.3, 500_000.1, 4_000_009.4)
