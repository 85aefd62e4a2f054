"""Maps from elsewhere in, and out again as they were."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from terrafuse.errors import InputError, LatticeError, OutputError
from terrafuse.export import export_map
from terrafuse.imports import Wishes, import_map, importer_of
from terrafuse.imports.place import first_cell, lattice_for, plain
from terrafuse.imports.ros import take_ros_map
from terrafuse.lattice import Lattice
from terrafuse.replica import Replica
from terrafuse.rosmap import Meaning, Placement, RosMap, read_map, write_map
from terrafuse.rosmap.files import read_image
from terrafuse.store.memory import MemoryStore
from terrafuse.store.sqlite import SqliteStore
from terrafuse.testing.deltas import deltas_of, scan_of
from terrafuse.types import Bounds
from tests.maps import write_raster, write_ros

ALL = np.arange(256, dtype=np.uint8).reshape(16, 16)
NAV2 = ("depot", "tb3_sandbox", "keepout_mask", "speed_mask", "map_circular", "TenByTen")


def exported(store: Path, out: Path, **options: Any) -> RosMap:
    with SqliteStore.open(store) as opened:
        export_map(Replica(store=opened), out, **options)
    return read_map(out)


def round_trip(source: Path, folder: Path) -> RosMap:
    import_map(source, folder / "map.db", overwrite=True)
    return exported(folder / "map.db", folder / "again.yaml")


def assert_same(one: RosMap, other: RosMap) -> None:
    assert one.placement == other.placement
    assert one.meaning == other.meaning
    np.testing.assert_array_equal(one.grey, other.grey)
    np.testing.assert_array_equal(one.occupancy, other.occupancy)


# --- ROS maps: exactly the same again --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAV2)
def test_nav2s_maps(name: str, recordings: Path, tmp_path: Path) -> None:
    source = recordings / f"maps/nav2/{name}.yaml"
    again = round_trip(source, tmp_path)
    assert_same(again, read_map(source))
    wanted, got = (yaml.safe_load(file.read_text()) for file in (source, tmp_path / "again.yaml"))
    assert got.pop("image") == "again.pgm"
    assert got.pop("mode") == wanted.pop("mode", "trinary")
    assert got == {key: wanted[key] for key in got}


@pytest.mark.parametrize("negate", [False, True])
@pytest.mark.parametrize("thresholds", [(0.65, 0.196), (0.65, 0.25), (1.0, 0.0), (0.99, 0.01)])
@pytest.mark.parametrize("mode", ["trinary", "scale", "raw"])
def test_all_256_greys(mode: str, thresholds: tuple[float, float], negate: bool, tmp_path: Path) -> None:
    source = write_ros(tmp_path / "map.yaml", ALL, Meaning(mode, *thresholds, negate), Placement(0.05, -1.5, 2.25))
    assert_same(round_trip(source, tmp_path), read_map(source))


@settings(max_examples=40)
@given(data=st.data())
def test_any_greys(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    folder = tmp_path_factory.mktemp("ros")
    rows, columns = data.draw(st.integers(1, 12)), data.draw(st.integers(1, 12))
    grey = np.array(data.draw(st.lists(st.integers(0, 255), min_size=rows * columns, max_size=rows * columns)))
    grey[0] = 90  # known in every mode: 90 of 100, or 165/255 = 0.65 of occupied
    free = data.draw(st.floats(0, 0.6))
    occupied = data.draw(st.floats(free, 0.64).filter(lambda value: value > free))
    meaning = Meaning(data.draw(st.sampled_from(["trinary", "scale", "raw"])), occupied, free)
    i, j, resolution_m = data.draw(st.integers(-500, 500)), data.draw(st.integers(-500, 500)), 0.05
    place = Placement(resolution_m, i * resolution_m, j * resolution_m)
    source = write_ros(folder / "map.yaml", grey.reshape(rows, columns), meaning, place)
    assert_same(round_trip(source, folder), read_map(source))


def test_cells_alone_keep_all_256_greys(tmp_path: Path) -> None:
    """No note of the pixels in a store in memory: what the log-odds hold is exact to a grey."""
    source = write_ros(tmp_path / "map.yaml", ALL, Meaning("scale", 1.0, 0.0))
    taken = take_ros_map(source, Wishes())
    store = MemoryStore(taken.lattice, taken.model)
    for delta in taken.deltas:
        store.accept(delta)
    export_map(Replica(store=store), tmp_path / "again.yaml", mode="scale")
    assert_same(read_map(tmp_path / "again.yaml"), read_map(source))


def test_an_occupancy_grid_of_minus_1_to_100(tmp_path: Path) -> None:
    """The case of grid_map_ros: 50×100 cells of 0.1 m at (3, 6)."""
    data = np.random.default_rng(0).integers(-1, 101, (100, 50))
    grey = np.where(data < 0, 255, data)[::-1]
    source = write_ros(tmp_path / "map.yaml", grey, Meaning("raw"), Placement(0.1, 3.0, 6.0))
    again = round_trip(source, tmp_path)
    assert again.placement == Placement(0.1, 3.0, 6.0)
    np.testing.assert_array_equal(again.occupancy, data)


def test_other_images_of_the_same_map(tmp_path: Path) -> None:
    """Plain PGM with a comment, PNG, BMP; the unknown rim stays as wide as it was."""
    from PIL import Image

    grey = np.full((9, 7), 205, np.uint8)
    grey[3:6, 2:5] = [[0, 254, 254], [0, 255, 205], [0, 0, 0]]
    source = write_ros(tmp_path / "map.yaml", grey)
    text = source.read_text()
    (tmp_path / "plain.pgm").write_text("P2\n# by hand\n7 9\n255\n" + "\n".join(" ".join(map(str, r)) for r in grey))
    Image.fromarray(grey).save(tmp_path / "map.png")
    Image.fromarray(grey).convert("RGB").save(tmp_path / "map.bmp")
    for image in ("plain.pgm", "map.png", "map.bmp"):
        source.write_text(text.replace("map.pgm", image))
        again = round_trip(source, tmp_path)
        np.testing.assert_array_equal(again.grey, grey)


def test_transparent_pixels_of_scale_are_unknown_and_stay(tmp_path: Path) -> None:
    grey, opaque = ALL.copy(), np.ones(ALL.shape, bool)
    opaque[3, :7] = False
    ros_map = RosMap(Placement(0.1), Meaning("scale"), grey, opaque)
    write_map(ros_map, tmp_path / "map.yaml", tmp_path / "map.png", "map.png")
    assert import_map(tmp_path / "map.yaml", tmp_path / "map.db")["cells"] == 256 - 7
    again = exported(tmp_path / "map.db", tmp_path / "again.yaml")
    assert_same(again, read_map(tmp_path / "map.yaml"))
    np.testing.assert_array_equal(again.opaque, opaque)


def test_thresholds_that_leave_no_grey_for_unknown_come_back(tmp_path: Path) -> None:
    """Of 255 greys 127 is 0.502 and 128 is 0.498; unknown is what is transparent, so the image is a PNG."""
    opaque = np.ones(ALL.shape, bool)
    opaque[0, 5:9] = False
    ros_map = RosMap(Placement(0.1), Meaning("trinary", 0.501, 0.5), ALL, opaque)
    write_map(ros_map, tmp_path / "map.yaml", tmp_path / "map.png", "map.png")
    again = round_trip(tmp_path / "map.yaml", tmp_path)
    assert_same(again, read_map(tmp_path / "map.yaml"))
    np.testing.assert_array_equal(again.opaque, opaque)
    part = exported(tmp_path / "map.db", tmp_path / "part.yaml", bounds=Bounds(-0.3, 0, 1.6, 1.6))
    assert (part.occupancy[:, :3] == -1).all()  # beyond the map that was imported
    np.testing.assert_array_equal(part.occupancy[:, 3:], again.occupancy)


def test_greys_that_an_export_can_t_have_are_said(tmp_path: Path) -> None:
    from PIL import Image

    source = write_ros(tmp_path / "map.yaml", np.zeros((1, 2)))
    Image.fromarray(np.array([[[0, 0, 90], [1, 1, 0]]], np.uint8)).save(tmp_path / "map.png")
    source.write_text(source.read_text().replace("map.pgm", "map.png"))
    (remark,) = import_map(source, tmp_path / "map.db")["remarks"]
    assert remark == "colours or 16 bits became greys, 1 of 2 between two of 256: an export has the nearest"
    assert exported(tmp_path / "map.db", tmp_path / "again.yaml").grey.tolist() == [[30, 1]]


def test_sixteen_bits_and_colours_are_averaged(tmp_path: Path) -> None:
    """65535 is 255; (0, 0, 90) is 30."""
    from PIL import Image

    Image.fromarray(np.array([[0, 65535, 32896]], np.uint16)).save(tmp_path / "deep.png")
    assert read_image(tmp_path / "deep.png")[0].tolist() == [[0, 255, 128]]  # 32896 = 128·257
    Image.fromarray(np.array([[[0, 0, 90], [1, 1, 0]]], np.uint8)).save(tmp_path / "colour.png")
    assert read_image(tmp_path / "colour.png")[0] == pytest.approx(np.array([[30, 2 / 3]]))


def test_what_robots_add_changes_its_own_pixels_only(tmp_path: Path) -> None:
    """A cell that became occupied is black; what still is free keeps the grey that it had."""
    grey = np.full((4, 4), 255, np.uint8)
    source = write_ros(tmp_path / "map.yaml", grey, placement=Placement(1.0))
    import_map(source, tmp_path / "map.db")
    with SqliteStore.open(tmp_path / "map.db") as store:
        lattice = store.map.lattice
        # Rays that end in cells (1, 0) and, outside of the imported map, (5, 0): a hit is ln(0.7/0.3) = 0.85.
        scans = [scan_of([[1.5, 0.5, 0.0], [5.5, 0.5, 0.0]], k) for k in range(40)]
        for delta in deltas_of("r1", scans, lattice, store.model):
            store.accept(delta)
    again = exported(tmp_path / "map.db", tmp_path / "again.yaml")
    assert again.grey.shape == (4, 6)
    assert again.grey[3].tolist()[1] == 0
    assert again.grey[3].tolist()[5] == 0
    assert (again.grey[:3, :4] == 255).all()
    assert (again.grey[:3, 4:] == 205).all()
    with SqliteStore.open(tmp_path / "map.db") as store:
        export_map(Replica(store=store, without=["import"]), tmp_path / "r1.yaml")
    assert read_map(tmp_path / "r1.yaml").grey.shape[0] == 1


def test_a_part_of_an_import(tmp_path: Path) -> None:
    source = write_ros(tmp_path / "map.yaml", ALL, Meaning("raw"), Placement(1.0))
    import_map(source, tmp_path / "map.db")
    part = exported(tmp_path / "map.db", tmp_path / "part.yaml", bounds=Bounds(2, 3, 12, 14))
    # Row 0 is the north: y from 14 down to 3 is rows 2 to 12 of 16.
    np.testing.assert_array_equal(part.grey, ALL[2:13, 2:12])
    assert part.placement == Placement(1.0, 2.0, 3.0)


def test_the_meaning_of_another_mode(tmp_path: Path) -> None:
    source = write_ros(tmp_path / "map.yaml", np.array([[0, 128, 254]]), Meaning("scale", 1.0, 0.0))
    import_map(source, tmp_path / "map.db")
    trinary = exported(tmp_path / "map.db", tmp_path / "other.yaml", mode="trinary")
    assert trinary.meaning == Meaning()
    assert trinary.grey.tolist() == [[0, 205, 254]]


# --- where a map lies ------------------------------------------------------------------------------------------------


def test_origins_on_the_lattice() -> None:
    assert first_cell(-10.1, 0.05, Lattice(0.05), "") == (-202, 1)
    assert first_cell(-10.1 + 4e-8, 0.0, Lattice(0.05), "") == (-202, 0)  # within 1e-6 of a cell of 0.05 m
    with pytest.raises(InputError, match=r"-10.12, 0 is no multiple of the resolution 0.05 m.*0.02 m beside.*help"):
        first_cell(-10.12, 0.0, Lattice(0.05), "help")


@pytest.mark.parametrize(
    ("resolution_m", "tile_m"), [(0.05, 40.0), (0.1, 40.0), (0.03, 39.9), (1.0, 100.0), (0.001, 4.09), (0.0254, 39.878)]
)
def test_tiles_hold_whole_cells(resolution_m: float, tile_m: float) -> None:
    """0.03: 40/0.03 = 1333.3, so 1330 cells. 0.0254: 1574.8, so 1570. 0.001: at most 4096 fit, so 4090."""
    assert lattice_for(resolution_m) == Lattice(resolution_m, tile_m)


def test_resolutions_that_went_through_32_bits() -> None:
    assert plain(0.05000000074505806) == 0.05
    assert plain(0.05) == 0.05
    assert plain(0.123456789) == 0.123456789


def test_a_resolution_of_32_bits_comes_back_as_it_was(tmp_path: Path) -> None:
    place = Placement(0.05000000074505806, -10.0, -10.0)
    source = write_ros(tmp_path / "map.yaml", ALL, placement=place)
    assert round_trip(source, tmp_path).placement == place


def test_off_the_lattice_takes_a_wish(tmp_path: Path) -> None:
    """The map of nav2's warehouse: −15.1 is no multiple of 0.03."""
    source = write_ros(tmp_path / "map.yaml", ALL, Meaning("raw"), Placement(0.03, -15.1, -25.0))
    with pytest.raises(InputError, match=r"map\.yaml: origin -15\.1, -25 .*0\.01 m beside them; use --resample"):
        import_map(source, tmp_path / "map.db")
    assert "resampled" in import_map(source, tmp_path / "map.db", Wishes(resample=True))["remarks"][0]
    again = exported(tmp_path / "map.db", tmp_path / "again.yaml")
    # −15.1/0.03 = −503.33: the nearest cell border is −503; −25/0.03 = −833.33: −833.
    assert (again.placement.east_m, again.placement.north_m) == pytest.approx((-503 * 0.03, -833 * 0.03))
    np.testing.assert_array_equal(again.grey, ALL)


def test_a_quarter_turn_is_a_turned_image(tmp_path: Path) -> None:
    """About the lower-left corner, counter-clockwise: 3 wide and 2 high become 2 wide and 3 high, west of it."""
    grey = np.array([[1, 2, 3], [4, 5, 6]])
    source = write_ros(tmp_path / "map.yaml", grey, Meaning("raw"), Placement(1.0, 10.0, 20.0, np.pi / 2))
    with pytest.raises(InputError, match=r"yaw 1\.5708 rad.*--resample"):
        import_map(source, tmp_path / "map.db")
    import_map(source, tmp_path / "map.db", Wishes(resample=True))
    again = exported(tmp_path / "map.db", tmp_path / "again.yaml")
    assert again.placement == Placement(1.0, 8.0, 20.0)
    # The lower row 4 5 6 runs north now, and is the eastern column.
    assert again.grey.tolist() == [[3, 6], [2, 5], [1, 4]]


def test_coarser_cells_take_the_pixel_at_their_centre(tmp_path: Path) -> None:
    """Cells of 3 m over pixels of 1 m: the middle one of each 3×3."""
    source = write_ros(tmp_path / "map.yaml", np.arange(36).reshape(6, 6), Meaning("raw"), Placement(1.0))
    import_map(source, tmp_path / "map.db", Wishes(resample=True, resolution_m=3.0))
    again = exported(tmp_path / "map.db", tmp_path / "again.yaml")
    assert again.grey.tolist() == [[7, 10], [25, 28]]


# --- rasters of heights ----------------------------------------------------------------------------------------------


def heights_of(store: Path) -> tuple[np.ndarray, tuple[float, float]]:
    """(z_mean with row 0 in the north, its western and northern edge)."""
    from terrafuse.views import bounds_of, known_window, mosaic

    with SqliteStore.open(store) as opened:
        replica = Replica(store=opened)
        window = known_window(replica)
        assert window is not None
        z = mosaic(replica, [replica.model.layers["z_mean"]], window)["z_mean"][::-1]
        n = mosaic(replica, [replica.model.layers["n"]], window)["n"]
        bounds = bounds_of(replica, window)
    assert np.nanmax(n) == 1
    return z, (bounds.west, bounds.north)


def test_a_raster_of_heights(tmp_path: Path) -> None:
    heights = [[1.5, np.nan, -2.25], [0.0, 1000.0, 3.0]]
    source = write_raster(tmp_path / "dem.tif", heights, 500_000.0, 4_000_000.0, 0.5, crs="EPSG:32632")
    done = import_map(source, tmp_path / "map.db", Wishes("dem", stamp_ns=7_000_000_000))
    assert (done["model"], done["robot"], done["crs"], done["cells"]) == ("elevation", "dem", "EPSG:32632", 5)
    z, corner = heights_of(tmp_path / "map.db")
    np.testing.assert_allclose(z, heights, rtol=1e-12)
    assert corner == (500_000.0, 4_000_000.0)
    with SqliteStore.open(tmp_path / "map.db") as store:
        assert store.robots() == ["dem"]
        assert store.stamp("dem") == 7_000_000_000
        assert store.poses("dem") == []


def test_rasters_over_many_tiles(tmp_path: Path) -> None:
    """A column of 130 cells of 1 m about y = 0 lies in tiles of 100 cells from −1 to 0."""
    heights = np.arange(130.0).reshape(-1, 1)
    source = write_raster(tmp_path / "dem.tif", heights, -1.0, 65.0)
    import_map(source, tmp_path / "map.db")
    z, corner = heights_of(tmp_path / "map.db")
    np.testing.assert_allclose(z, heights, rtol=1e-12)
    assert corner == (-1.0, 65.0)
    with SqliteStore.open(tmp_path / "map.db") as store:
        assert [key[:2] for key in store.keys()] == [(-1, -1), (-1, 0)]


def test_what_a_map_exports_comes_in_again(local_map_cog: Path, tmp_path: Path) -> None:
    """The band named height of our own GeoTIFF, in float32."""
    done = import_map(local_map_cog, tmp_path / "map.db")
    assert done["remarks"] == ["took height as heights in metres"]


@pytest.fixture
def local_map_cog(tmp_path: Path) -> Path:
    from tests.export.maps import filled, points_over

    export_map(filled(Lattice(0.1, 4.0), points_over(3, 2)), tmp_path / "map.tif")
    return tmp_path / "map.tif"


def test_scale_offset_nodata_and_bands(tmp_path: Path) -> None:
    import rasterio

    source = write_raster(tmp_path / "dem.tif", [[10, 20, -9999]], north=1.0, dtype="int16", nodata=None)
    with pytest.raises(InputError, match="no band 'b'; it has: 1"):
        import_map(source, tmp_path / "map.db", Wishes(band="b"))
    with rasterio.open(source, "r+") as raster:
        raster.scales, raster.offsets = (0.5,), (100.0,)
    import_map(source, tmp_path / "map.db", Wishes(nodata=-9999, band="1"))
    z, _ = heights_of(tmp_path / "map.db")
    assert z == pytest.approx(np.array([[105.0, 110.0]]))


def test_rasters_off_the_lattice(tmp_path: Path) -> None:
    """Pixels from x = 0.25 on, every 1 m: the centre 0.5 of cell 0 lies in the first, 1.5 in the second."""
    source = write_raster(tmp_path / "dem.tif", [[1.0, 2.0]], west=0.25, north=1.0)
    with pytest.raises(InputError, match=r"dem\.tif: origin 0\.25, 0 .*0\.25 m beside them; use --resample"):
        import_map(source, tmp_path / "map.db")
    import_map(source, tmp_path / "map.db", Wishes(resample=True))
    z, corner = heights_of(tmp_path / "map.db")
    assert (z.tolist(), corner) == ([[1.0, 2.0]], (0.0, 1.0))


def test_rasters_in_degrees(tmp_path: Path) -> None:
    """A plane z = 1000·latitude of 0.001° pixels about 50° N, 9° E, the meridian of UTM zone 32: 111.2 km a degree."""
    from rasterio import Affine

    latitude = 50.0 + 0.001 * (np.arange(20)[::-1] + 0.5)
    source = write_raster(
        tmp_path / "dem.tif",
        np.repeat(1000 * latitude[:, None], 20, axis=1) - 50_000,
        crs="EPSG:4326",
        transform=Affine(0.001, 0, 8.99, 0, -0.001, 50.02),
    )
    with pytest.raises(InputError, match=r"does not count metres"):
        import_map(source, tmp_path / "map.db")
    with pytest.raises(InputError, match="--resolution and --resample"):
        import_map(source, tmp_path / "map.db", Wishes(crs="EPSG:32632"))
    import_map(source, tmp_path / "map.db", Wishes(crs="EPSG:32632", resolution_m=50.0, resample=True))
    z, (west, _) = heights_of(tmp_path / "map.db")
    assert west == pytest.approx(500_000 - 0.01 * 71_700 * 0.9996, abs=50)
    middle = z[:, z.shape[1] // 2]
    # 50 m are 50/(111,229·0.9996) = 0.00045°: 0.45 a row, to the nearest pixel's 1.0.
    np.testing.assert_allclose(np.diff(middle[[2, -3]]), -0.4497 * (len(middle) - 5), atol=1.0)


# --- refusals, each with the file and the remedy ---------------------------------------------------------------------


def changed(tmp_path: Path, **lines: Any) -> Path:
    """A sound ROS map with some of its lines changed, or taken out where None."""
    source = write_ros(tmp_path / "map.yaml", ALL)
    about = yaml.safe_load(source.read_text()) | lines
    source.write_text(yaml.safe_dump({key: value for key, value in about.items() if value is not None}))
    return source


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        ({"image": None}, r"map\.yaml: has no 'image:'.*add it"),
        ({"image": "gone.pgm"}, r"map\.yaml:\d+: its image .*gone\.pgm is not there; put it there"),
        ({"origin": None}, "has no 'origin:'"),
        ({"origin": [1, 2]}, r"map\.yaml:\d+: origin \[1, 2\]: give \[x, y, yaw\]"),
        ({"origin": [1, "here", 0]}, "origin 'here': give a number"),
        ({"mode": "ternary"}, r"map\.yaml:\d+: mode 'ternary': there are trinary, scale, raw"),
        ({"occupied_thresh": 0.1}, r"map\.yaml:\d+: free_thresh 0\.196 and occupied_thresh 0\.1: give 0 ≤ free_thresh"),
        ({"free_thresh": float("nan")}, "free_thresh nan"),
        ({"resolution": float("nan")}, r"map\.yaml:\d+: resolution nan: give a positive number"),
        ({"resolution": 0}, "resolution 0.0: give a positive number"),
        ({"negate": 3}, "negate 3: give 0 or 1"),
        ({"negate": [0]}, r"negate \[0\]: give 0 or 1"),
        ({"image": 7}, "image 7: give the name of a file, in quotes"),
        ({"image": ["a"]}, r"image \['a'\]: give the name"),
        ({"image": "2001-99-99"}, "2001-99-99 is not there; put it"),
        ({"image": "a" * 5000}, "is not there; put it there"),
        ({"image": "."}, "is not there; put it there"),
        ({"origin": [1e300, 0.0, 0.0]}, r"origin \[1e\+300, 0.0, 0.0\]: give finite numbers up to 1e\+09"),
        ({"origin": [0.0, 0.0, float("inf")]}, "give finite numbers"),
        ({"origin": [True, 0.0, 0.0]}, "origin True: give a number"),
        ({"resolution": 10**400}, r"map\.yaml:\d+: 1000\d+… is too large"),
        ({"resolution": 1e-300}, "resolution 1e-300: give a positive number"),
        ({"resolution": True}, "resolution True: give a number"),
        ({"mode": 5}, "mode '5': there are trinary"),
        ({"more": json.loads("[" * 50 + "]" * 50)}, "nests deeper than"),
    ],
)
def test_bad_descriptions(lines: dict[str, Any], says: str, tmp_path: Path) -> None:
    source = changed(tmp_path, **lines)
    with pytest.raises(InputError, match=says):
        import_map(source, tmp_path / "map.db")
    assert sorted(os.listdir(tmp_path)) == ["map.pgm", "map.yaml"]


@pytest.mark.parametrize(
    "content",
    [
        b"P5\n16 16\n255\n" + bytes(200),  # half of the pixels
        b"P5\n16 900000\n255\n" + bytes(256),  # a size that the data do not have
        b"P2\n4 4\n255\n1 2 3\n",
        b"P5\n16",
        b"P5\n900000 900000\n255\n" + bytes(256),
        b"",
        b"no image at all",
    ],
)
def test_damaged_images(content: bytes, tmp_path: Path) -> None:
    source = write_ros(tmp_path / "map.yaml", ALL)
    (tmp_path / "map.pgm").write_bytes(content)
    with pytest.raises(InputError, match=r"map\.pgm: (is no image|can't be read .*is it whole\?)"):
        import_map(source, tmp_path / "map.db")
    assert sorted(os.listdir(tmp_path)) == ["map.pgm", "map.yaml"]


def test_what_is_no_yaml(tmp_path: Path) -> None:
    for content in ("a: [1", "just words", "- 1\n- 2\n", "\x00"):
        (tmp_path / "map.yaml").write_text(content)
        with pytest.raises(InputError, match=r"map\.yaml:(1: not YAML| holds no).*give the \.yaml of a ROS map"):
            import_map(tmp_path / "map.yaml", tmp_path / "map.db")


def test_other_files(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"gone\.yaml: no such file"):
        import_map(tmp_path / "gone.yaml", tmp_path / "map.db")
    with pytest.raises(InputError, match=r"map\.pgm: give the \.yaml"):
        importer_of(tmp_path / "map.pgm")
    with pytest.raises(InputError, match=r"no importer takes '\.las'; there are: ros-map \(\.yaml, \.yml\), raster"):
        importer_of(tmp_path / "map.las")
    (tmp_path / "cut.tif").write_bytes(b"II*\0 and no more")
    with pytest.raises(InputError, match=r"cut\.tif: can't be read as a raster"):
        import_map(tmp_path / "cut.tif", tmp_path / "map.db")


def test_maps_without_anything_known(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no cell of it is known"):
        import_map(write_ros(tmp_path / "map.yaml", np.full((3, 3), 205)), tmp_path / "map.db")
    with pytest.raises(InputError, match="no pixel has a height"):
        import_map(write_raster(tmp_path / "dem.tif", [[np.nan]], north=1.0), tmp_path / "map.db")
    with pytest.raises(InputError, match=r"a height of 32767 m .* say --nodata"):
        import_map(write_raster(tmp_path / "dem.tif", [[32767.0]], north=1.0), tmp_path / "map.db")
    assert not (tmp_path / "map.db").exists()


def test_cells_that_are_too_small_to_count(tmp_path: Path) -> None:
    source = write_ros(tmp_path / "map.yaml", ALL, placement=Placement(10.0))
    with pytest.raises(InputError, match=r"160000×160000 cells of 0\.001 m are too many"):
        import_map(source, tmp_path / "map.db", Wishes(resample=True, resolution_m=0.001))


def test_tiles_that_do_not_fit(tmp_path: Path) -> None:
    with pytest.raises(LatticeError, match="does not divide"):
        import_map(write_ros(tmp_path / "map.yaml", ALL), tmp_path / "map.db", Wishes(tile_m=0.25))


def test_what_is_there_is_replaced_only_when_asked(tmp_path: Path) -> None:
    source = write_ros(tmp_path / "map.yaml", ALL)
    import_map(source, tmp_path / "map.db")
    before = (tmp_path / "map.db").read_bytes()
    with pytest.raises(OutputError, match=r"exists already.*--overwrite"):
        import_map(source, tmp_path / "map.db")
    shutil.copy(source, tmp_path / "bad.yaml")
    (tmp_path / "bad.yaml").write_text(source.read_text().replace("trinary", "x"))
    with pytest.raises(InputError):
        import_map(tmp_path / "bad.yaml", tmp_path / "map.db", overwrite=True)
    assert (tmp_path / "map.db").read_bytes() == before
    import_map(source, tmp_path / "map.db", overwrite=True)
    with pytest.raises(OutputError, match="there is no folder"):
        import_map(source, tmp_path / "none/map.db")


def test_without_pillow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    source = write_ros(tmp_path / "map.yaml", ALL)
    monkeypatch.setitem(sys.modules, "PIL", None)
    with pytest.raises(InputError, match=r"terrafuse\[plot\]"):
        import_map(source, tmp_path / "map.db")


def test_a_map_is_not_replaced_by_its_own_import(tmp_path: Path) -> None:
    file = tmp_path / "map.yaml"
    file.write_text("image: map.pgm\n")
    with pytest.raises(InputError, match="that is the file itself"):
        import_map(file, file, overwrite=True)
    assert file.read_text() == "image: map.pgm\n"
