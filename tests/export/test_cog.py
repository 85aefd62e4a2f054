"""The GeoTIFF, read back with GDAL."""

from __future__ import annotations

import os
import resource
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import rasterio
import rasterio.shutil

from terrafuse.errors import InputError, OutputError
from terrafuse.export import cog
from terrafuse.export.cog import write_cog
from terrafuse.lattice import Lattice
from terrafuse.replica import Replica
from terrafuse.types import Bounds
from tests.export.maps import START_NS, UTM, filled, points_over


@pytest.fixture(scope="module")
def utm_file(utm_map: Replica, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("cog") / "map.tif"
    write_cog(utm_map, path)
    return path


def test_it_is_a_cloud_optimized_geotiff(utm_file: Path, utm_map: Replica) -> None:
    with rasterio.open(utm_file) as raster:
        assert raster.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert raster.profile["tiled"]
        assert raster.block_shapes[0] == (512, 512)
        assert raster.compression.name == "zstd"
        assert set(raster.dtypes) == {"float32"}
        assert np.isnan(raster.nodata)
        layers = utm_map.model.layers
        assert raster.descriptions == tuple(layers)
        assert raster.units == tuple(layer.unit for layer in layers.values())
        assert raster.crs.to_epsg() == 32632


def test_cells_lie_where_they_belong(utm_file: Path, utm_map: Replica) -> None:
    """Every cell of every band equals the array's at its coordinates: 1 mm of height 1000 m up, 4000 km north."""
    with rasterio.open(utm_file) as raster:
        for band, name in enumerate(raster.descriptions, 1):
            array = utm_map.layer(name)
            assert raster.shape == array.shape
            values = raster.read(band).astype(np.float64) + raster.offsets[band - 1]
            tolerance = 0.008 if name == "stamp" else 1e-4
            np.testing.assert_allclose(values, array.values, rtol=1e-7, atol=tolerance)
            if array.attrs["units"] == "m":
                assert np.nanmax(np.abs(values - array.values)) < 0.001
        corners = [0, raster.height - 1], [0, raster.width - 1]
        east, north = rasterio.transform.xy(raster.transform, *corners)
        np.testing.assert_allclose(east, array.x[[0, -1]], rtol=0, atol=1e-8)
        np.testing.assert_allclose(north, array.y[[0, -1]], rtol=0, atol=1e-8)
        assert north[0] > north[1]
        assert raster.transform[:6] == (0.1, 0.0, 500_000.0, 0.0, -0.1, 4_000_009.3)


def test_a_point_is_found_at_its_coordinates(tmp_path: Path) -> None:
    """One cell high, one low: by coordinates, as a GIS user asks."""
    replica = filled(Lattice(0.1, 4.0, UTM), np.array([[0.05, 0.05, 1.0], [7.25, 2.35, 2.0]]), 399_999.9, 5_000_000.0)
    write_cog(replica, tmp_path / "map.tif", layers=["height"])
    with rasterio.open(tmp_path / "map.tif") as raster:
        assert raster.shape == (24, 73)
        assert raster.bounds == pytest.approx((399_999.9, 5_000_000.0, 400_007.2, 5_000_002.4), abs=1e-9)
        values = [
            v[0] for v in raster.sample([(399_999.95, 5_000_000.05), (400_007.15, 5_000_002.35), (400_000, 5_000_001)])
        ]
    assert values[:2] == pytest.approx([1.0, 2.0], abs=1e-5)
    assert np.isnan(values[2])


def test_stamps_keep_their_milliseconds(utm_file: Path) -> None:
    with rasterio.open(utm_file) as raster:
        band = raster.descriptions.index("stamp") + 1
        assert raster.tags(band)["epoch"] == "2011-09-26T00:00:00Z"
        seconds = float(np.nanmax(raster.read(band)))
        assert seconds == 80 * 60
        assert raster.offsets[band - 1] + seconds == START_NS / 1e9


def test_a_local_frame_has_no_crs(local_map: Replica, tmp_path: Path) -> None:
    write_cog(local_map, tmp_path / "map.tif", layers=["z_max", "n"])
    with rasterio.open(tmp_path / "map.tif") as raster:
        assert raster.crs is None
        assert raster.descriptions == ("z_max", "n")
        assert raster.bounds.left == pytest.approx(-3.3)
        assert raster.bounds.bottom == pytest.approx(-5.1)
        np.testing.assert_array_equal(raster.read(2), local_map.layer("n").values.astype("f4"))


def test_bounds_cut_and_pad(local_map: Replica, tmp_path: Path) -> None:
    bounds = Bounds(-10.0, 0.0, 0.0, 0.55)
    write_cog(local_map, tmp_path / "map.tif", layers=["height"], bounds=bounds)
    with rasterio.open(tmp_path / "map.tif") as raster:
        assert raster.shape == (6, 100)
        np.testing.assert_array_equal(raster.read(1), local_map.layer("height", bounds).values.astype("f4"))
        assert np.isnan(raster.read(1)[:, :60]).all()


def test_overviews_are_means_of_the_known(tmp_path: Path) -> None:
    """Every second column is known: an average that took NaN in would know nothing."""
    i, j = np.meshgrid([*range(0, 698, 2), 698, 699], np.arange(600))
    points = np.column_stack([(i.ravel() + 0.5) / 10, (j.ravel() + 0.5) / 10, i.ravel() // 2 / 50])
    replica = filled(Lattice(0.1, 40.0), points)
    told: list[float] = []
    write_cog(replica, tmp_path / "map.tif", layers=["height", "state"], progress=told.append)
    with rasterio.open(tmp_path / "map.tif") as raster:
        assert raster.overviews(1) == [2]
    with rasterio.open(tmp_path / "map.tif", overview_level=0) as overview:
        np.testing.assert_allclose(overview.read(1), np.tile(np.arange(350) / 50, (300, 1)), atol=1e-5)
        assert (overview.read(2) == 1).all()
    assert told == sorted(told)
    assert told[-1] == 1.0


@contextmanager
def files_of_at_most(nbytes: int) -> Iterator[None]:
    """The kernel refuses to let a file grow larger: a full disk, as C code meets it."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (nbytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, handler)


@pytest.mark.parametrize("nbytes", [0, 100, 100_000, 1_000_000])
def test_a_disk_that_fills_up_while_tiles_are_written(local_map: Replica, tmp_path: Path, nbytes: int) -> None:
    """GDAL does not report any of these: it writes when it closes the file."""
    (tmp_path / "map.tif").write_text("old")
    with files_of_at_most(nbytes), pytest.raises(OutputError, match=r"map\.tif: can't be written"):
        write_cog(local_map, tmp_path / "map.tif")
    assert (tmp_path / "map.tif").read_text() == "old"
    assert os.listdir(tmp_path) == ["map.tif"]


@pytest.mark.parametrize("missing", [1, 1000, 100_000])
def test_a_disk_that_fills_up_while_gdal_copies(
    utm_file: Path, utm_map: Replica, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, missing: int
) -> None:
    """GDAL itself does not report the last of these."""
    whole = utm_file.stat().st_size
    copy = rasterio.shutil.copy

    def copy_to_a_full_disk(*args, **kwargs):
        with files_of_at_most(whole - missing):
            copy(*args, **kwargs)

    monkeypatch.setattr(rasterio.shutil, "copy", copy_to_a_full_disk)
    (tmp_path / "map.tif").write_text("old")
    with pytest.raises(OutputError, match=r"map\.tif: can't be written"):
        write_cog(utm_map, tmp_path / "map.tif")
    assert (tmp_path / "map.tif").read_text() == "old"
    assert os.listdir(tmp_path) == ["map.tif"]


def test_a_map_with_a_stray_scan_is_refused_in_time(local_map: Replica, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="too large; use coarser cells"):
        write_cog(local_map, tmp_path / "map.tif", bounds=Bounds(0, 0, 1e5, 1e5))


def test_an_unknown_crs_is_an_input_error(tmp_path: Path) -> None:
    replica = filled(Lattice(0.1, 4.0, "EPSG:99999"), points_over(1, 1))
    with pytest.raises(InputError, match="99999"):
        write_cog(replica, tmp_path / "map.tif")
    assert os.listdir(tmp_path) == []


def test_the_options_are_what_the_text_says() -> None:
    assert cog.COG["compress"] == "ZSTD"
    assert cog.COG["overview_resampling"] == "AVERAGE"
