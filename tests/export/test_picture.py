"""Pictures: there, of a sane size, and of the map."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.image import imread

from terrafuse.errors import MissingExtra
from terrafuse.export import export_map
from terrafuse.export.looks import LOOKS, TERRAIN, kinds, look_of
from terrafuse.export.picture import robot_paths, write_picture
from terrafuse.export.shade import hillshade
from terrafuse.export.sheet import round_length
from terrafuse.lattice import Lattice
from terrafuse.replica import Replica
from terrafuse.types import Array, Bounds
from tests.export.maps import UTM, filled


def picture(replica: Replica, folder: Path, **options) -> Array:
    path = folder / "map.png"
    write_picture(replica, path, **options)
    image = imread(path)[..., :3]
    assert 200 < image.shape[0] < 1700
    assert 200 < image.shape[1] < 1700
    assert image.std() > 0.01
    return image


def has_colour(image: Array, colour: str) -> bool:
    wanted = [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    return bool((np.abs(image - wanted).max(axis=2) < 0.01).any())


def test_the_map_with_paths(local_map: Replica, tmp_path: Path) -> None:
    image = picture(local_map, tmp_path, paths=robot_paths(local_map), title="Two robots")
    plain = picture(local_map, tmp_path, title="Two robots")
    for colour in ("#e6007e", "#1565ff"):
        assert has_colour(image, colour)
        assert not has_colour(plain, colour)
    assert len(np.unique((image * 32).astype(int).reshape(-1, 3), axis=0)) > 100


@pytest.mark.parametrize("layer", ["height", "z_var", "n", "state", "changes", "dynamic", "stamp", "traversability"])
def test_every_layer_can_be_drawn(layer: str, local_map: Replica, tmp_path: Path) -> None:
    picture(local_map, tmp_path, layer=layer)


def test_names_are_printed_as_they_are(local_map: Replica, tmp_path: Path) -> None:
    """A leading underscore and dollar signs mean something to matplotlib."""
    track = np.array([[0.0, 0.0], [1.0, 1.0]])
    picture(local_map, tmp_path, paths={"_r$x$": track, "$\\bad{": track, "x" * 200: track}, title="$\\oops{")


def test_paths_may_be_empty_or_torn(local_map: Replica, tmp_path: Path) -> None:
    torn = np.array([[0.0, 0.0], [np.nan, np.nan], [1.0, 1.0]])
    picture(local_map, tmp_path, paths={"none": np.empty((0, 2)), "one": torn[:1], "torn": torn})


def test_many_robots_get_more_lines(local_map: Replica, tmp_path: Path) -> None:
    few = picture(local_map, tmp_path, paths={"r": np.zeros((2, 2))})
    many = picture(local_map, tmp_path, paths={f"robot {k}": np.zeros((2, 2)) for k in range(25)})
    assert many.shape[0] > few.shape[0]


def test_a_tiny_map_is_not_blurred(tmp_path: Path) -> None:
    """5×5 cells in a UTM zone: each is one even square, the height by which it is lit aside."""
    j, i = np.mgrid[0:5, 0:5]
    points = np.column_stack([(i.ravel() + 0.5) / 10, (j.ravel() + 0.5) / 10, i.ravel() * 0.1])
    image = picture(filled(Lattice(0.1, 4.0, UTM), points, 500_000, 4_000_000, 1000), tmp_path, layer="n")
    replica = filled(Lattice(0.1, 4.0), points)
    image = picture(replica, tmp_path)
    terrain = image[image.shape[0] // 2, image.shape[1] // 2]
    assert np.abs(image - terrain).max(axis=2).min() == 0
    square = (np.abs(image - terrain).max(axis=2) == 0).sum()
    assert square >= 64 * 64


def test_a_single_cell(tmp_path: Path) -> None:
    picture(filled(Lattice(0.1, 4.0), np.array([[0.05, 0.05, 3.0]])), tmp_path)


@pytest.mark.parametrize("turn", [False, True])
def test_a_long_thin_map_is_reduced(turn: bool, tmp_path: Path) -> None:
    along = np.arange(0, 2000, 0.5)
    points = np.column_stack([along, 3 + np.sin(along / 20), np.sin(along / 100)])
    replica = filled(Lattice(0.5, 50.0), points[:, [1, 0, 2]] if turn else points)
    image = picture(replica, tmp_path)
    assert max(image.shape) > 1200


def test_bounds_without_a_known_cell_are_background(local_map: Replica, tmp_path: Path) -> None:
    image = picture(local_map, tmp_path, bounds=Bounds(100, 100, 101, 101))
    assert (np.abs(image - np.array([0xEC, 0xEE, 0xF1]) / 255).max(axis=2) < 0.01).mean() > 0.2


def test_exported_pictures_show_the_stored_paths(local_map: Replica, tmp_path: Path) -> None:
    export_map(local_map, tmp_path / "map.png")
    assert has_colour(imread(tmp_path / "map.png")[..., :3], "#e6007e")


def test_without_matplotlib(local_map: Replica, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(MissingExtra, match=r"terrafuse\[plot\]"):
        write_picture(local_map, tmp_path / "map.png")


def test_light_comes_from_the_north_west() -> None:
    j, i = np.mgrid[0:20, 0:20].astype(float)
    faces_north_west, faces_south_east = hillshade(i - j, 1.0), hillshade(j - i, 1.0)
    assert hillshade(0 * i, 1.0) == pytest.approx(np.ones((20, 20)))
    assert faces_north_west.min() > 1.05
    assert faces_south_east.max() < 0.95


def test_unknown_neighbours_cast_no_shade() -> None:
    z = np.full((9, 9), np.nan)
    z[4, 4] = z[2, 2] = z[2, 3] = 5.0
    bright = hillshade(z, 0.1)
    assert np.isnan(bright).sum() == 78
    assert bright[4, 4] == bright[2, 2] == pytest.approx(1.0)


def lightness(colour: str) -> float:
    """CIE L*."""
    srgb = np.array([int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)])
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    return float(116 * np.cbrt(linear @ [0.2126, 0.7152, 0.0722]) - 16)


def test_terrain_rises_evenly_in_lightness() -> None:
    steps = np.diff([lightness(colour) for colour in TERRAIN])
    assert steps.min() > 0.9 * steps.mean()
    assert steps.max() < 1.1 * steps.mean()


def test_looks(local_map: Replica) -> None:
    layers = local_map.model.layers
    assert look_of(layers["height"]).shaded
    assert look_of(layers["z_max"]).shaded
    assert not look_of(layers["n"]).shaded
    assert look_of(layers["state"]) is LOOKS["state"]
    assert kinds(layers["state"]) == {1: "flat", 2: "vertical"}


@given(st.floats(1e-6, 1e9))
def test_scale_bars_are_round(most: float) -> None:
    length = round_length(most)
    assert most / 2.5 * (1 - 1e-6) <= length <= most * (1 + 1e-6)
    assert f"{length:.0e}"[0] in "125"
