"""ROS maps out: what map_server's numbers mean, and the files that a map becomes."""

from __future__ import annotations

import errno
import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from terrafuse.errors import InputError, OutputError
from terrafuse.export import export_map
from terrafuse.lattice import Lattice
from terrafuse.models import MODELS, make_model
from terrafuse.replica import Replica
from terrafuse.rosmap import Meaning, Placement, RosMap, percent, pixels, probability, read_map
from terrafuse.rosmap.files import description, read_image
from terrafuse.testing.deltas import deltas_of, random_scans
from terrafuse.types import Beam, Bounds
from terrafuse.views import known_window, mosaic

ALL = np.arange(256, dtype=np.uint8).reshape(1, -1)


def grid_values(grey: list[int], meaning: Meaning, opaque: list[bool] | None = None) -> list[int]:
    """What nav_msgs/OccupancyGrid gets of these greys."""
    alpha = None if opaque is None else np.array([opaque])
    return percent(probability(np.array([grey], np.uint8), meaning, alpha))[0].tolist()


def test_trinary_by_hand() -> None:
    """occ of 0, 89, 90, 205, 206, 254: 1, 166/255 = 0.651, 165/255 = 0.647, 50/255 = 0.1961, 49/255 = 0.192, 0.004."""
    assert grid_values([0, 89, 90, 205, 206, 254], Meaning()) == [100, 100, -1, -1, 0, 0]
    assert grid_values([205], Meaning(free_thresh=0.25)) == [0]
    assert grid_values([255, 166, 165, 50, 49, 1], Meaning(negate=True)) == [100, 100, -1, -1, 0, 0]


def test_thresholds_are_inclusive() -> None:
    """occ of 204 is 51/255, which is 0.2; of 51 it is 204/255, which is 0.8."""
    assert grid_values([204, 51], Meaning("trinary", 0.8, 0.2)) == [0, 100]
    assert grid_values([205, 50], Meaning("trinary", 0.8, 0.19)) == [-1, 100]


def test_scale_by_hand() -> None:
    """Of thresholds 0.2 and 0.8, 153 has occ 102/255 = 0.4, a third of the way: 33; 102 has 0.6, two thirds: 67."""
    assert grid_values([204, 153, 102, 51, 0], Meaning("scale", 0.8, 0.2)) == [0, 33, 67, 100, 100]
    assert grid_values([204, 153], Meaning("scale", 0.8, 0.2), [True, False]) == [0, -1]


def test_raw_by_hand() -> None:
    for negate in (False, True):
        assert grid_values([0, 7, 100, 101, 255], Meaning("raw", negate=negate)) == [0, 7, 100, -1, -1]


def test_navs_own_expectation(recordings: Path) -> None:
    """The numbers of nav2_map_server's test, of the same picture in three formats."""
    expected = json.loads((recordings / "expected/nav2_map_server_testmap.json").read_text())
    meaning = Meaning("trinary", expected["occupied_thresh"], expected["free_thresh"])
    for suffix in ("pgm", "png", "bmp"):
        ros_map = RosMap(Placement(0.1), meaning, *read_image(recordings / f"maps/nav2/testmap.{suffix}"))
        np.testing.assert_array_equal(ros_map.occupancy, expected["occupancy"])
    assert read_map(recordings / "maps/nav2/testmap.yaml").placement == Placement(0.1, 2.0, 3.0, 1.0)


def test_pixels_by_hand() -> None:
    """As map_saver has it: hundredths, from 65 on black, up to 20 (19.6 rounded) nearly white, else 205."""
    values = np.array([[1.0, 0.65, 0.64, 0.21, 0.2, 0.0, np.nan]])
    assert pixels(values, Meaning())[0].tolist() == [[0, 0, 205, 205, 254, 254, 205]]
    assert pixels(values, Meaning(negate=True))[0].tolist()[0][:2] == [255, 255]
    grey, opaque = pixels(values, Meaning("scale", 1.0, 0.0))
    assert grey.tolist() == [[0, 89, 92, 201, 204, 255, 128]]  # 255·(1 − p): 0, 89.25, 91.8, 201.45, 204, 255
    assert opaque is not None
    assert opaque.tolist() == [[True] * 6 + [False]]
    assert pixels(values, Meaning("raw"))[0].tolist() == [[100, 65, 64, 21, 20, 0, 255]]


HUNDREDTHS = np.append(np.arange(101) / 100, np.nan).reshape(1, -1)


def read_again(meaning: Meaning) -> list[int]:
    """What is read of what is written for 0, 1, … 100 of 100 and unknown."""
    grey, opaque = pixels(HUNDREDTHS, meaning)
    return percent(probability(grey, meaning, opaque))[0].tolist()


@given(st.integers(0, 95), st.integers(5, 100), st.booleans())
def test_trinary_reads_back_by_the_thresholds(free: int, wide: int, negate: bool) -> None:
    occupied = min(100, free + wide)
    expected = [100 if k >= occupied else 0 if k <= free else -1 for k in range(101)]
    assert read_again(Meaning("trinary", occupied / 100, free / 100, negate)) == [*expected, -1]


@given(st.sampled_from([(1.0, 0.0), (0.65, 0.196), (0.65, 0.25), (0.99, 0.01)]), st.booleans())
def test_scale_and_raw_read_every_hundredth_back(thresholds: tuple[float, float], negate: bool) -> None:
    """Scale has a grey for each as long as the thresholds are 100/255 = 0.39 apart."""
    for mode in ("scale", "raw"):
        assert read_again(Meaning(mode, *thresholds, negate)) == [*range(101), -1]


@given(st.booleans())
def test_scale_keeps_all_256_greys(negate: bool) -> None:
    meaning = Meaning("scale", 1.0, 0.0, negate)
    np.testing.assert_array_equal(pixels(probability(ALL, meaning), meaning)[0], ALL)


def test_thresholds_that_leave_no_grey_for_unknown() -> None:
    """127/255 is 0.498, 128/255 is 0.502: no grey lies between 0.5 and 0.501, so unknown is what is transparent."""
    meaning = Meaning("trinary", 0.501, 0.5)
    grey, opaque = pixels(np.array([[0.0, np.nan, 1.0]]), meaning)
    assert opaque is not None
    assert opaque.tolist() == [[True, False, True]]
    assert percent(probability(grey, meaning, opaque)).tolist() == [[0, -1, 100]]
    whole, none = pixels(np.array([[0.0, 1.0]]), meaning)
    assert (whole.tolist(), none) == ([[254, 0]], None)


@given(st.floats(0, 1), st.floats(0, 1), st.booleans())
def test_any_thresholds_tell_occupied_free_and_unknown(one: float, other: float, negate: bool) -> None:
    assume(one != other)
    meaning = Meaning("trinary", max(one, other), min(one, other), negate)
    grey, opaque = pixels(np.array([[0.0, np.nan, 1.0]]), meaning)
    assert percent(probability(grey, meaning, opaque)).tolist() == [[0, -1, 100]]


def test_what_a_meaning_can_t_be() -> None:
    with pytest.raises(InputError, match="0 ≤ free_thresh < occupied_thresh ≤ 1"):
        Meaning("trinary", 0.2, 0.6)
    with pytest.raises(InputError, match="mode 'trinity': there are trinary, scale, raw"):
        Meaning("trinity")


def test_numbers_of_the_yaml_are_numbers_again() -> None:
    text = description(RosMap(Placement(1e-5, -1e7, 1e-9, 0.0), Meaning(), ALL), "a: b.pgm")
    assert "resolution: 0.00001\n" in text
    assert "origin: [-10000000.0, 0.000000001, 0.0]\n" in text
    assert text.startswith('image: "a: b.pgm"\n')


def test_a_map_of_heights_becomes_obstacles(local_map: Replica, tmp_path: Path) -> None:
    """Row 0 of the image is the north; the origin is the lower-left corner."""
    assert export_map(local_map, tmp_path / "map.yaml") == "ros-map"
    assert sorted(os.listdir(tmp_path)) == ["map.pgm", "map.yaml"]
    ros_map = read_map(tmp_path / "map.yaml")
    window = known_window(local_map)
    assert window is not None
    assert ros_map.placement == Placement(0.1, window[0] / 10, window[1] / 10)
    layer = local_map.model.occupied
    values = mosaic(local_map, [layer], window)[layer.name]
    # By the rule of map_saver, written again: hundredths against 65 and 20.
    hundredths = np.floor(np.nan_to_num(values, nan=0.4) * 100 + 0.5)
    expected = np.where(hundredths >= 65, 100, np.where(hundredths <= 20, 0, -1))
    np.testing.assert_array_equal(ros_map.occupancy, expected)
    assert (expected == 100).any()
    assert (expected == 0).any()


def test_scale_needs_transparency_where_cells_are_unknown(local_map: Replica, tmp_path: Path) -> None:
    export_map(local_map, tmp_path / "map.yaml", mode="scale")
    assert sorted(os.listdir(tmp_path)) == ["map.png", "map.yaml"]
    ros_map = read_map(tmp_path / "map.yaml")
    layer = local_map.model.occupied
    values = mosaic(local_map, [layer], known_window(local_map))[layer.name]
    np.testing.assert_allclose(ros_map.probability[::-1], values, atol=0.5 / 255 + 1e-12)


def test_options_and_parts(local_map: Replica, tmp_path: Path) -> None:
    options = {"mode": "raw", "occupied_thresh": 0.7, "free_thresh": 0.3, "negate": True}
    bounds = Bounds(-2.0, -4.0, 1.0, 0.0)
    export_map(local_map, tmp_path / "part.yaml", layers=["traversability"], bounds=bounds, **options)
    ros_map = read_map(tmp_path / "part.yaml")
    assert ros_map.meaning == Meaning("raw", 0.7, 0.3, True)
    assert ros_map.placement == Placement(0.1, -2.0, -4.0)
    assert ros_map.grey.shape == (40, 30)
    with pytest.raises(InputError, match=r"'cog' has no option mode"):
        export_map(local_map, tmp_path / "map.tif", mode="raw")


def test_refusals(local_map: Replica, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"'height' \(m\) has values from .* leave --layer out"):
        export_map(local_map, tmp_path / "map.yaml", layers=["height"])
    with pytest.raises(InputError, match="one layer, not dynamic, traversability"):
        export_map(local_map, tmp_path / "map.yaml", layers=["dynamic", "traversability"])
    with pytest.raises(InputError, match=r"that is the image's name; give --out a \.yaml"):
        export_map(local_map, tmp_path / "map.pgm", format="ros-map")
    assert os.listdir(tmp_path) == []


def test_a_full_disk_leaves_both_files_as_they_were(
    local_map: Replica, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_args: object) -> None:
        raise OSError(errno.ENOSPC, "full")

    old = {"map.yaml": "image: map.pgm\n", "map.pgm": "old"}
    for name, text in old.items():
        (tmp_path / name).write_text(text)
    with monkeypatch.context() as full:
        full.setattr(os, "fsync", fail)
        with pytest.raises(OutputError, match="no space left"):
            export_map(local_map, tmp_path / "map.yaml")
    assert {p.name: p.read_text() for p in tmp_path.iterdir()} == old
    export_map(local_map, tmp_path / "map.yaml")
    assert read_map(tmp_path / "map.yaml").grey.size > 0


def test_a_picture_that_happens_to_have_the_images_name_stays(local_map: Replica, tmp_path: Path) -> None:
    (tmp_path / "map.png").write_text("the picture of a mapping run")
    with pytest.raises(InputError, match=r"map\.png: is there already, and belongs to no such map"):
        export_map(local_map, tmp_path / "map.yaml", mode="scale")
    assert os.listdir(tmp_path) == ["map.png"]


@pytest.mark.parametrize("name", sorted(MODELS))
def test_every_model_has_something_to_show(name: str, tmp_path: Path) -> None:
    """Its `occupied`, cell by cell: raw mode holds it in whole percent."""
    lattice, model = Lattice(0.5, 10.0), make_model(name)
    replica = Replica(lattice, model)
    cone = Beam(half_angle_rad=0.2, range_error_m=0.2, max_range_m=20.0)  # which models of surfaces don't ask about
    scans = [replace(scan, beam=cone) for scan in random_scans(1, 3, points=400)]
    for delta in deltas_of("r1", scans, lattice, model):
        replica.apply(delta)
    export_map(replica, tmp_path / "map.yaml", mode="raw")
    values = mosaic(replica, [model.occupied], known_window(replica))[model.occupied.name]
    expected = np.where(np.isnan(values), -1, np.floor(np.nan_to_num(values) * 100 + 0.5))
    np.testing.assert_array_equal(read_map(tmp_path / "map.yaml").occupancy, expected)
    assert (expected >= 0).any()
