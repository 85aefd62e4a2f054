"""Layers as xarray and as .npz."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pyproj
import pytest

from terrafuse.errors import InputError, LatticeError, MissingExtra
from terrafuse.export.array import data_array
from terrafuse.export.npz import write_npz
from terrafuse.lattice import Lattice
from terrafuse.replica import Replica
from terrafuse.types import Bounds
from tests.export.maps import UTM, filled


def test_one_cell_has_its_coordinates() -> None:
    replica = filled(Lattice(0.5, 4.0), np.array([[0.6, 7.3, 2.0], [1.9, 4.1, 3.0]]))
    array = data_array(replica, "height")
    assert array.dims == ("y", "x")
    assert array.dtype == np.float64
    assert array.x.values.tolist() == [0.75, 1.25, 1.75]
    assert array.y.values.tolist() == [7.25, 6.75, 6.25, 5.75, 5.25, 4.75, 4.25]
    assert float(array.sel(x=0.75, y=7.25)) == pytest.approx(2.0, abs=1e-12)
    assert float(array.sel(x=1.75, y=4.25)) == pytest.approx(3.0, abs=1e-12)
    assert int(array.notnull().sum()) == 2
    assert array.attrs == {"units": "m", "long_name": replica.model.layers["height"].description}
    assert "spatial_ref" not in array.coords


def test_bounds_are_filled_up_with_unknown(local_map: Replica) -> None:
    array = local_map.layer("n", (-20.0, -20.0, -19.0, -19.5))
    assert array.shape == (5, 10)
    assert array.isnull().all()


def test_the_crs_is_there_as_cf_and_gdal_want_it(utm_map: Replica) -> None:
    array = data_array(utm_map, "traversability")
    assert array.attrs["grid_mapping"] == "spatial_ref"
    about = array.spatial_ref.attrs
    assert pyproj.CRS.from_wkt(about["crs_wkt"]) == pyproj.CRS.from_cf(about) == pyproj.CRS(UTM)
    assert about["grid_mapping_name"] == "transverse_mercator"
    west, step, _, north, _, down = map(float, about["GeoTransform"].split())
    assert (step, down) == (0.1, -0.1)
    assert (west, north) == pytest.approx((array.x.values[0] - 0.05, array.y.values[0] + 0.05), abs=1e-8)
    assert array.x.attrs["standard_name"] == "projection_x_coordinate"


def test_errors_name_what_is_wrong(local_map: Replica, empty_map: Replica, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="no layer 'colour'"):
        data_array(local_map, "colour")
    with pytest.raises(InputError, match="the map is empty"):
        data_array(empty_map, "height")
    with pytest.raises(LatticeError, match="hold no cell"):
        data_array(local_map, "height", Bounds(1, 1, 1, 1))
    with pytest.raises(InputError, match="too much for arrays in memory"):
        data_array(local_map, "height", Bounds(-1e5, -1e5, 1e5, 1e5))
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(MissingExtra, match=r"pip install 'terrafuse\[gis\]'"):
        data_array(local_map, "height")


def test_npz_round_trip(utm_map: Replica, tmp_path: Path) -> None:
    write_npz(utm_map, tmp_path / "map.npz")
    with np.load(tmp_path / "map.npz", allow_pickle=False) as file:
        assert file["layers"].tolist() == list(utm_map.model.layers)
        assert dict(zip(file["layers"], file["units"], strict=True))["z_var"] == "m2"
        assert str(file["crs"]) == UTM
        for name in utm_map.model.layers:
            array = utm_map.layer(name)
            np.testing.assert_array_equal(file[name], array.values)
            np.testing.assert_array_equal(file["x"], array.x)
            np.testing.assert_array_equal(file["y"], array.y)


def test_npz_of_a_part(local_map: Replica, tmp_path: Path) -> None:
    write_npz(local_map, tmp_path / "map.npz", ["n"], Bounds(0, 0, 1, 2))
    with np.load(tmp_path / "map.npz", allow_pickle=False) as file:
        assert set(file) == {"n", "x", "y", "crs", "layers", "units"}
        assert file["n"].shape == (20, 10)
        assert str(file["crs"]) == ""
