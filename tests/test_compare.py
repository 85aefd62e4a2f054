"""How maps differ, in numbers worked out by hand and on real ones."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from terrafuse.compare import Question, compare_maps, figures
from terrafuse.errors import InputError
from terrafuse.export import export_map
from terrafuse.grids import Grid
from terrafuse.imports import Wishes, import_map
from terrafuse.lattice import Lattice
from terrafuse.mapper import Mapper
from terrafuse.models import make_model
from terrafuse.replica import Replica
from terrafuse.rosmap import Meaning, Placement
from terrafuse.store.sqlite import SqliteStore
from terrafuse.types import Bounds
from tests import accuracy
from tests.maps import write_raster, write_ros

NAN = np.nan


def store_of(folder: Path, name: str, heights: Any, **place: Any) -> Path:
    """An elevation store of one point in each cell of 1 m."""
    return imported(write_raster(folder / f"{name}.tif", heights, **place), folder / f"{name}.db")


def imported(source: Path, out: Path, wishes: Wishes | None = None) -> Path:
    import_map(source, out, wishes)
    return out


# --- the figures, by hand --------------------------------------------------------------------------------------------


def test_figures_of_values() -> None:
    """3, −4, 0, 1: √(26/4) = 2.5495; mean 0; of 0, 1, 3, 4 the median is 2, and 95 % lie 0.85 of the way from the
    third (3) to the fourth (4), as 0.95·3 = 2.85."""
    got = figures.value_figures(np.array([3.0, -4.0, 0.0, 1.0]))
    expected = {"rmse": 2.5495098, "bias": 0.0, "median_abs": 2.0, "p95_abs": 3.85, "max_abs": 4.0}
    assert got == pytest.approx(expected)


def test_coverage() -> None:
    got = figures.coverage(a=4, b=6, both=3, looked_at=20)
    assert got["cells"] == {"looked_at": 20, "a": 4, "b": 6, "both": 3}
    assert got["completeness_a"] == 3 / 6
    assert got["completeness_b"] == 3 / 4
    assert got["overlap"] == 3 / 7
    assert figures.coverage(0, 0, 0, 5)["overlap"] is None


def test_kinds_are_inclusive_of_the_thresholds() -> None:
    values = np.array([0.0, 0.2, 0.21, 0.79, 0.8, 1.0, NAN])
    assert figures.kinds(values, 0.8, 0.2).tolist() == [0, 0, 2, 2, 1, 1, 2]


def test_figures_of_occupancy() -> None:
    """A: free free free occ occ unknown; B: free free occ occ unknown unknown. Known in both: four, three agree."""
    a, b = np.array([0, 0, 0, 1, 1, 2]), np.array([0, 0, 1, 1, 2, 2])
    table = figures.counts(a, b)
    assert table.tolist() == [[2, 1, 0], [0, 1, 1], [0, 0, 1]]
    got = figures.occupancy_figures(table)
    assert got["table"]["free"] == {"free": 2, "occupied": 1, "unknown": 0}
    assert got["agreement"] == 3 / 4
    assert (got["agreement_free_a"], got["agreement_free_b"]) == (2 / 3, 1.0)
    assert (got["agreement_occupied_a"], got["agreement_occupied_b"]) == (1.0, 1 / 2)


# --- where elements lie ----------------------------------------------------------------------------------------------


def test_borders_belong_to_the_element_north_east_of_them() -> None:
    """Two columns and two rows of 0.1 m from (0.2, 0.1) on; 0.3 is the border between the columns, as binary 0.1·3 is
    not quite."""
    grid = Grid(2, 2, (0.1, 0.0, 0.2, 0.0, -0.1, 0.3))
    x, y = np.array([0.2, 0.1 * 3, 0.3, 0.4]), np.array([0.1, 0.2, 0.1 + 0.1, 0.25])
    row, column, inside = grid.locate(x, y)
    assert inside.tolist() == [True, True, True, False]
    assert column[:3].tolist() == [0, 1, 1]
    assert row[:3].tolist() == [1, 0, 0]


@given(st.floats(-3.2, 3.2), st.integers(1, 20), st.integers(1, 20))
def test_turned_grids_find_their_own_centres(yaw: float, rows: int, columns: int) -> None:
    from terrafuse.rosmap import RosMap

    grid = RosMap(Placement(0.05, 7.0, -3.0, yaw), Meaning(), np.zeros((rows, columns))).grid
    row, column, inside = grid.locate(*grid.centres(0, rows))
    assert inside.all()
    np.testing.assert_array_equal(row, np.repeat(np.arange(rows)[:, None], columns, axis=1))
    np.testing.assert_array_equal(column, np.repeat(np.arange(columns)[None], rows, axis=0))
    corner = grid.place(np.array([0.0]), np.array([float(rows)]))
    assert (corner[0][0], corner[1][0]) == pytest.approx((7.0, -3.0))


# --- heights ---------------------------------------------------------------------------------------------------------


def test_two_stores(tmp_path: Path) -> None:
    """Three cells known in both: +1, −2, 0; √(5/3) = 1.291. One known in A only, two in B only."""
    a = store_of(tmp_path, "a", [[1.0, 2.0], [3.0, 4.0]], north=2.0)
    b = store_of(tmp_path, "b", [[0.0, 4.0, 9.0], [3.0, NAN, 9.0]], north=2.0)
    got = compare_maps(a, b)
    assert got["kind"] == "values"
    assert got["unit"] == "m"
    assert got["remarks"] == []
    assert got["cells"] == {"looked_at": 6, "a": 4, "b": 5, "both": 3}
    assert (got["completeness_a"], got["completeness_b"], got["overlap"]) == (3 / 5, 3 / 4, 3 / 6)
    assert got["rmse"] == pytest.approx((5 / 3) ** 0.5)
    assert got["bias"] == pytest.approx(-1 / 3)
    assert got["median_abs"] == pytest.approx(1.0)
    assert got["p95_abs"] == pytest.approx(1.9)  # of 0, 1, 2: 0.95·2 = 1.9 of the way


def test_finer_truth_is_looked_up_at_the_centres(tmp_path: Path) -> None:
    """Cells of 3 m over pixels of 1 m whose value is their number, from the north-west: the middle ones are 7, 10."""
    a = imported(write_raster(tmp_path / "a.tif", [[7.5, 10.0]], north=3.0, side_m=3.0), tmp_path / "a.db")
    b = write_raster(tmp_path / "b.tif", np.arange(18.0).reshape(3, 6), north=3.0)
    got = compare_maps(a, b)
    assert got["cells"] == {"looked_at": 2, "a": 2, "b": 2, "both": 2}
    assert (got["bias"], got["max_abs"]) == pytest.approx((0.25, 0.5))
    assert "B is looked up at the centres of A's cells" in got["remarks"][0]


def test_a_centre_on_a_border_takes_the_north_eastern_pixel(tmp_path: Path) -> None:
    """Cells of 2 m, pixels of 1 m: each centre is a corner of four pixels."""
    a = imported(write_raster(tmp_path / "a.tif", [[0.0]], north=2.0, side_m=2.0), tmp_path / "a.db")
    b = write_raster(tmp_path / "b.tif", [[1.0, 2.0], [3.0, 4.0]], north=2.0)
    assert compare_maps(a, b)["bias"] == pytest.approx(-2.0)


def test_coarser_truth_and_bounds(tmp_path: Path) -> None:
    """Four cells of 1 m within one pixel of 2 m; the bounds keep the western two of them."""
    a = store_of(tmp_path, "a", [[1.0, 2.0], [3.0, 4.0]], north=2.0)
    b = write_raster(tmp_path / "b.tif", [[1.0]], north=2.0, side_m=2.0)
    assert compare_maps(a, b)["bias"] == pytest.approx(1.5)
    part = compare_maps(a, b, Question(bounds=Bounds(0, 0, 1, 2)))
    assert part["cells"]["looked_at"] == 2
    assert part["bias"] == pytest.approx(1.0)
    assert part["bounds"] == [0, 0, 1, 2]


def test_layers_and_bands(tmp_path: Path) -> None:
    import rasterio

    a = store_of(tmp_path, "a", [[1.0, 2.0]], north=1.0)
    b = write_raster(tmp_path / "b.tif", [[5.0, 5.0]], north=1.0)
    assert compare_maps(a, b, Question("n"))["bias"] == pytest.approx(-4.0)
    assert "units differ" in compare_maps(a, b, Question("n"))["remarks"][0]
    with rasterio.open(b, "r+") as raster:
        raster.set_band_description(1, "z_max")
    assert compare_maps(a, b, Question("z_max", "z_max"))["bias"] == pytest.approx(-3.5)
    with pytest.raises(InputError, match=r"no layer 'colour'.*height"):
        compare_maps(a, b, Question("colour"))
    with pytest.raises(InputError, match=r"b\.tif: no band 'blue'; it has: 1 z_max"):
        compare_maps(a, b, Question(band="blue"))


def occupancy_tif(folder: Path, name: str, grey: list[list[int]]) -> Path:
    """The GeoTIFF of an occupancy map of 1 m cells: greys as in ROS maps."""
    write_ros(folder / f"{name}.yaml", np.array(grey), placement=Placement(1.0))
    with SqliteStore.open(imported(folder / f"{name}.yaml", folder / f"{name}.db")) as store:
        export_map(Replica(store=store), folder / f"{name}.tif")
    return folder / f"{name}.tif"


def test_rasters_of_occupancy_maps_are_compared_by_agreement(tmp_path: Path) -> None:
    """As their stores are; but what is asked for by name is compared by its values."""
    a = occupancy_tif(tmp_path, "a", [[0, 254, 254, 205]])
    b = occupancy_tif(tmp_path, "b", [[0, 254, 0, 0]])
    got, of_stores = compare_maps(a, b), compare_maps(tmp_path / "a.db", tmp_path / "b.db")
    assert (got["kind"], got["agreement"]) == ("occupancy", 2 / 3)
    assert {key: got[key] for key in ("table", "cells")} == {key: of_stores[key] for key in ("table", "cells")}
    assert compare_maps(a, tmp_path / "b.yaml")["agreement"] == 2 / 3
    assert compare_maps(a, tmp_path / "b.db")["agreement"] == 2 / 3
    assert compare_maps(a, b, Question(band="occupancy"))["kind"] == "values"
    assert compare_maps(a, b, Question("occupancy"))["kind"] == "values"


def test_what_neither_map_has_is_not_passed_over(tmp_path: Path) -> None:
    a = store_of(tmp_path, "a", [[1.0, 2.0]], north=1.0)
    b = write_raster(tmp_path / "b.tif", [[5.0, 5.0]], north=1.0)
    ros = write_ros(tmp_path / "c.yaml", np.array([[0, 254]]), placement=Placement(1.0))
    for first, second, asked, says in (
        (a, a, Question(band="1"), "--band 1: A is a store, B a store; only rasters have bands: choose a --layer"),
        (ros, ros, Question(band="1"), "--band 1: A is a ROS map, B a ROS map; only rasters have bands"),
        (ros, ros, Question("height"), "--layer height: A is a ROS map, B a ROS map; only stores have layers"),
        (b, b, Question("z"), "--layer z: A is a raster, B a raster; only stores have layers"),
        (occupancy_tif(tmp_path, "d", [[0, 254]]), b, Question("z"), "their bands are: occupancy, "),
    ):
        with pytest.raises(InputError) as caught:
            compare_maps(first, second, asked)
        assert says in str(caught.value)
    with pytest.raises(InputError, match="is a folder; give the store in it"):
        compare_maps(tmp_path, a)


def test_another_crs(tmp_path: Path) -> None:
    """The same place in UTM zones 32 and 33: the truth's pixels hold their own easting, so that a difference is how far
    off the nearest pixel's centre lies: at most half a pixel, evenly spread: RMSE 50/√12 = 14.4."""
    import pyproj

    to_33 = pyproj.Transformer.from_crs("EPSG:32632", "EPSG:32633", always_xy=True)
    east, north = to_33.transform(700_000.0, 5_500_000.0)
    west, top = round(east / 50) * 50 - 2000, round(north / 50) * 50 + 2000
    columns = np.repeat((np.arange(80)[None] + 0.5) * 50, 80, axis=0)
    b = write_raster(tmp_path / "b.tif", columns, west, top, 50.0, crs="EPSG:32633")
    i, j = np.meshgrid(np.arange(100), np.arange(100))
    truth_x, _ = to_33.transform(700_000 + (i + 0.5) * 10, 5_500_000 + (j + 0.5) * 10)
    a = imported(
        write_raster(tmp_path / "a.tif", (truth_x - west)[::-1], 700_000, 5_501_000, 10.0, crs="EPSG:32632"),
        tmp_path / "a.db",
    )
    got = compare_maps(a, b, Question(bounds=Bounds(700_000, 5_500_000, 701_000, 5_501_000)))
    assert "the CRS differ" in got["remarks"][1]
    assert got["cells"]["both"] == 10_000
    assert got["max_abs"] <= 25.001
    assert got["rmse"] == pytest.approx(14.4, abs=0.5)


def test_a_frame_without_a_name(tmp_path: Path) -> None:
    a = store_of(tmp_path, "a", [[1.0]], north=1.0, crs="EPSG:32632")
    b = write_raster(tmp_path / "b.tif", [[1.0]], north=1.0)
    assert compare_maps(a, b)["remarks"] == ["B names no CRS: its coordinates are taken to be in the other's"]


def test_nothing_in_common(tmp_path: Path) -> None:
    a = store_of(tmp_path, "a", [[1.0, NAN]], north=1.0)
    with pytest.raises(InputError, match=r"no place in common: A covers 0,0,1,1, B 5,0,6,1; are both in one frame"):
        compare_maps(a, write_raster(tmp_path / "b.tif", [[1.0]], west=5.0, north=1.0))
    b = store_of(tmp_path, "c", [[1.0, NAN, 1.0]], north=1.0, west=-1.0)
    with pytest.raises(InputError, match="no cell is known in both: A knows 1, B 2"):
        compare_maps(a, b)
    with pytest.raises(InputError, match=r"the bounds 7,7,8,8 hold nothing of both"):
        compare_maps(a, b, Question(bounds=Bounds(7, 7, 8, 8)))


def test_too_large_an_area_is_no_hour_of_silence(tmp_path: Path) -> None:
    a = imported(write_raster(tmp_path / "a.tif", [[1.0]], north=0.01, side_m=0.01), tmp_path / "a.db")
    b = write_raster(tmp_path / "b.tif", [[1.0]], north=1000.0, side_m=1000.0)
    with pytest.raises(InputError, match="100000×100000 of A's cells; look at a part, with --bounds"):
        compare_maps(a, b)


# --- occupancy -------------------------------------------------------------------------------------------------------


def test_two_ros_maps(tmp_path: Path) -> None:
    """0 occupied, 254 free, 205 unknown."""
    a = write_ros(tmp_path / "a.yaml", np.array([[0, 254, 254, 205], [0, 0, 254, 205]]), placement=Placement(1.0))
    b = write_ros(tmp_path / "b.yaml", np.array([[0, 254, 0, 0], [254, 205, 254, 205]]), placement=Placement(1.0))
    got = compare_maps(a, b)
    assert got["kind"] == "occupancy"
    assert got["table"] == {
        "free": {"free": 2, "occupied": 1, "unknown": 0},
        "occupied": {"free": 1, "occupied": 1, "unknown": 1},
        "unknown": {"free": 0, "occupied": 1, "unknown": 1},
    }
    assert got["cells"] == {"looked_at": 8, "a": 6, "b": 6, "both": 5}
    assert got["agreement"] == 3 / 5
    assert (got["completeness_a"], got["completeness_b"], got["overlap"]) == (5 / 6, 5 / 6, 5 / 7)


def test_thresholds_say_what_is_known(tmp_path: Path) -> None:
    """Of scale, 153 is 0.4 occupied: unknown by the usual thresholds, free where 0.4 is."""
    a = write_ros(tmp_path / "a.yaml", np.array([[153, 0]]), Meaning("scale", 1.0, 0.0))
    b = write_ros(tmp_path / "b.yaml", np.array([[254, 0]]))
    assert compare_maps(a, b)["table"]["unknown"]["free"] == 1
    assert compare_maps(a, b, Question(free_thresh=0.4))["table"]["free"]["free"] == 1
    with pytest.raises(InputError, match="0 ≤ free < occupied ≤ 1"):
        Question(occupied_thresh=0.1)


def test_a_turned_map_is_looked_up(tmp_path: Path) -> None:
    """A quarter turn about (0, 0) puts the row 0 254 in a column, west of it: occupied below, free above."""
    b = write_ros(tmp_path / "b.yaml", np.array([[0, 254]]), placement=Placement(1.0, 0, 0, np.pi / 2))
    a = write_ros(tmp_path / "a.yaml", np.array([[254], [0]]), placement=Placement(1.0, -1.0, 0.0))
    assert compare_maps(a, b)["agreement"] == 1.0
    with pytest.raises(InputError, match=r"A \(ROS map .*is turned; give it second"):
        compare_maps(b, a)


def test_heights_against_a_ros_map(tmp_path: Path) -> None:
    """Level ground is free: of 9×9 cells that are level, the plane is fitted in all that have 13 of 25 neighbours:
    all but the corners, which have 9, and the 8 cells beside these, which have 12."""
    a = store_of(tmp_path, "a", np.full((9, 9), 2.0), north=9.0)
    b = write_ros(tmp_path / "b.yaml", np.full((9, 9), 254), placement=Placement(1.0))
    got = compare_maps(a, b)
    assert got["kind"] == "occupancy"
    assert got["table"]["free"]["free"] == 81 - 4 - 8
    assert got["a"]["what"].startswith("obstacle of elevation, cells of 1 m")


def test_numbers_that_are_no_probabilities(tmp_path: Path) -> None:
    a = write_raster(tmp_path / "a.tif", [[300.0]], north=1.0)
    b = write_ros(tmp_path / "b.yaml", np.array([[0]]), placement=Placement(1.0))
    with pytest.raises(InputError, match=r"up to 300|to 300 are no probabilities; choose a --layer or --band"):
        compare_maps(a, b)


@pytest.mark.parametrize("name", ["depot", "tb3_sandbox", "speed_mask"])
def test_an_import_agrees_with_its_source(name: str, recordings: Path, tmp_path: Path) -> None:
    source = recordings / f"maps/nav2/{name}.yaml"
    got = compare_maps(imported(source, tmp_path / "map.db"), source)
    assert got["agreement"] == got["completeness_a"] == got["completeness_b"] == 1.0
    assert got["remarks"] == []
    if name == "tb3_sandbox":  # its greys counted: 870 of 0, 7903 of 254
        assert got["table"]["occupied"]["occupied"] == 870
        assert got["table"]["free"]["free"] == 7903


# --- a surveyed truth ------------------------------------------------------------------------------------------------


def test_surveyed_ground(recordings: Path, tmp_path: Path) -> None:
    """Argoverse 2: the ground raster as a GeoTIFF (its rows run north), against figures that are taken cell by cell."""
    from rasterio import Affine

    folder = recordings / accuracy.AV2_LOG
    (sim2,) = (folder / "map").glob("*img_Sim2_city.json")
    (ground,) = (folder / "map").glob("*ground_height_surface*.npy")
    transform = json.loads(sim2.read_text())
    west, south = -transform["t"][0], -transform["t"][1]
    truth = write_raster(
        tmp_path / "truth.tif",
        np.load(ground).astype(np.float32),
        dtype="float32",
        transform=Affine(1 / transform["s"], 0, west, 0, 1 / transform["s"], south),
    )
    lattice = Lattice(0.5)
    mapper = Mapper("car", lattice, make_model("elevation"))
    for scan in accuracy.scans_of(str(folder)):
        mapper.integrate(scan)
    with SqliteStore.create(tmp_path / "map.db", lattice, make_model("elevation")) as store:
        store.accept(mapper.delta())
    i, j, layers = accuracy.known_cells(accuracy.map_of(accuracy.scans_of(str(folder)), lattice, {}), "z_min")
    surveyed = accuracy.av2_truth(folder, lattice.cell_centre(i), lattice.cell_centre(j))
    difference = (layers["z_min"] - surveyed)[~np.isnan(surveyed)]
    got = compare_maps(tmp_path / "map.db", truth, Question("z_min"))
    assert got["cells"]["a"] == len(i)
    assert got["cells"]["both"] == len(difference)
    assert got["bias"] == pytest.approx(difference.mean(), abs=1e-6)
    assert got["rmse"] == pytest.approx(np.sqrt((difference**2).mean()), abs=1e-6)
    assert got["median_abs"] == pytest.approx(np.median(np.abs(difference)), abs=1e-6)
    assert got["completeness_b"] == pytest.approx(len(difference) / len(i))


# --- pictures --------------------------------------------------------------------------------------------------------


def colours(path: Path) -> set[tuple[int, ...]]:
    from PIL import Image

    return {tuple(colour) for colour in np.asarray(Image.open(path).convert("RGB")).reshape(-1, 3)}


def rgb(text: str) -> tuple[int, ...]:
    return tuple(int(text[k : k + 2], 16) for k in (1, 3, 5))


def test_a_picture_of_agreement_shows_all_five_kinds(tmp_path: Path) -> None:
    from terrafuse.compare.picture import AGREEMENT

    a = write_ros(tmp_path / "a.yaml", np.array([[254, 0, 0, 205, 254]]), placement=Placement(1.0))
    b = write_ros(tmp_path / "b.yaml", np.array([[254, 0, 205, 254, 0]]), placement=Placement(1.0))
    got = compare_maps(a, b, picture=tmp_path / "new/folder")
    assert got["picture"] == str(tmp_path / "new/folder/difference.png")
    assert {rgb(colour) for colour in AGREEMENT} <= colours(Path(got["picture"]))


def test_a_picture_of_differences_is_red_where_a_is_higher(tmp_path: Path) -> None:
    """The ends of the colours, at the west and the east of the map."""
    import matplotlib

    a = store_of(tmp_path, "a", [[3.0, 0.0, 1.0]], north=1.0)
    b = store_of(tmp_path, "b", [[1.0, 0.0, 3.0, 8.0]], north=1.0)
    compare_maps(a, b, picture=tmp_path / "d.png")
    from PIL import Image

    image = np.asarray(Image.open(tmp_path / "d.png").convert("RGB")).astype(int)
    bluest, reddest = (np.array(matplotlib.colormaps["RdBu_r"](x)[:3]) * 255 for x in (0.0, 1.0))
    place = [np.argwhere(np.abs(image - colour).max(axis=2) < 2)[:, 1] for colour in (reddest, bluest)]
    assert min(map(len, place)) > 1000
    assert np.median(place[0]) < np.median(place[1])


def test_large_maps_are_drawn_in_blocks_that_lose_no_difference(tmp_path: Path) -> None:
    from terrafuse.compare.picture import AGREEMENT

    grey = np.full((1500, 1500), 254)
    other = grey.copy()
    other[700, 800] = 0
    a = write_ros(tmp_path / "a.yaml", grey)
    b = write_ros(tmp_path / "b.yaml", other)
    compare_maps(a, b, picture=tmp_path / "d.png")
    assert rgb(AGREEMENT[-1]) in colours(tmp_path / "d.png")


def test_no_picture_where_it_could_not_be_right(tmp_path: Path) -> None:
    from rasterio import Affine

    oblong = write_raster(tmp_path / "a.tif", [[1.0]], transform=Affine(2, 0, 0, 0, -1, 1))
    square = write_raster(tmp_path / "b.tif", [[1.0, 1.0]], north=1.0)
    with pytest.raises(InputError, match="2 × 1 and no squares; for a picture give it second"):
        compare_maps(oblong, square, picture=tmp_path / "d.png")
    with pytest.raises(InputError, match=r"d\.jpg: give a \.png, or a folder"):
        compare_maps(square, oblong, picture=tmp_path / "d.jpg")
    assert not list(tmp_path.glob("d.*"))
    with pytest.raises(InputError):
        compare_maps(oblong, square, picture=tmp_path / "new/folder")
    assert not (tmp_path / "new").exists()
