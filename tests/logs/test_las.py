from __future__ import annotations

from datetime import UTC, date, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from terrafuse.errors import LogError
from terrafuse.lattice import Lattice
from terrafuse.logs import open_log
from terrafuse.logs.las import gps_to_unix_ns

from .support import NS, refuses, scans

laspy = pytest.importorskip("laspy", reason="package laspy is not installed")
pyproj = pytest.importorskip("pyproj", reason="package pyproj is not installed")

FOOT, US_FOOT = 0.3048, 1200 / 3937
POINTS = np.array([[500000.25, 5400000.5, 100.125], [500001.5, 5400001.25, 101.5], [500002.0, 5400003.0, 99.0]])


def tile(
    path: Path,
    crs: Any = None,
    *,
    points: np.ndarray = POINTS,
    wkt: str | None = None,
    made: date | None = None,
    gps: list[float] | None = None,
    classes: list[int] | None = None,
    withheld: list[int] | None = None,
    point_format: int = 6,
) -> Path:
    header = laspy.LasHeader(point_format=point_format, version="1.4")
    header.scales, header.offsets = [0.001] * 3, np.floor(points.min(axis=0)) if len(points) else [0] * 3
    header.creation_date = made
    if crs is not None:
        header.add_crs(pyproj.CRS.from_user_input(crs))
    if wkt is not None:
        header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(wkt))
    las = laspy.LasData(header)
    las.x, las.y, las.z = points.T
    if classes is not None:
        las.classification = classes
    if withheld is not None:
        las.withheld = withheld
    if gps is not None:
        las.header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
        las.gps_time = gps
    las.write(str(path))
    if made is None:  # laspy fills in today
        data = bytearray(path.read_bytes())
        data[90:94] = bytes(4)
        path.write_bytes(data)
    return path


@pytest.mark.parametrize("suffix", ["las", "laz"])
def test_metres_stay_as_they_are(tmp_path: Path, suffix: str) -> None:
    path = tile(tmp_path / f"a.{suffix}", 32632)
    log = open_log(str(path))
    assert (log.reader, log.count, log.crs, log.georeferenced) == ("las", 1, "EPSG:32632", True)
    (scan,) = scans(str(path))
    assert scan.points.dtype == np.float64
    assert np.allclose(scan.points, POINTS, atol=1e-9)
    assert np.array_equal(scan.T_world_sensor.matrix, np.eye(4))


@pytest.mark.parametrize(("epsg", "metres"), [(2994, FOOT), (2225, US_FOOT)])
def test_feet_become_metres_and_so_does_the_crs(tmp_path: Path, epsg: int, metres: float) -> None:
    path = tile(tmp_path / "a.las", epsg)
    log = open_log(str(path))
    (scan,) = scans(str(path))
    assert np.allclose(scan.points, POINTS * metres, rtol=1e-15)
    feet, metric = pyproj.CRS.from_epsg(epsg), pyproj.CRS.from_user_input(log.crs)
    assert metric.name == f"{feet.name} (metres)"
    assert {axis.unit_name for axis in metric.axis_info} == {"metre"}
    assert metric.geodetic_crs.equals(feet.geodetic_crs)
    assert Lattice(0.5, crs=log.crs).crs == log.crs
    places = [
        pyproj.Transformer.from_crs(crs, 4326, always_xy=True).transform(*given[:, :2].T)
        for crs, given in ((feet, POINTS), (metric, scan.points))
    ]
    assert np.allclose(places[0], places[1], atol=1e-11)


@pytest.mark.parametrize(
    ("crs", "xy", "z", "text"),
    [
        ("EPSG:2994+6360", FOOT, US_FOOT, 'PROJCRS["NAD83(HARN) / Oregon GIC Lambert (ft) (metres)"'),
        ("EPSG:26910+6360", 1.0, US_FOOT, "EPSG:26910"),
        ("EPSG:26910+5703", 1.0, 1.0, 'COMPOUNDCRS["NAD83 / UTM zone 10N + NAVD88 height"'),
        ("EPSG:2994+5703", FOOT, 1.0, 'PROJCRS["NAD83(HARN) / Oregon GIC Lambert (ft) (metres)"'),
    ],
)
def test_heights_have_their_own_unit(tmp_path: Path, crs: str, xy: float, z: float, text: str) -> None:
    path = tile(tmp_path / "a.las", crs)
    assert np.allclose(scans(str(path))[0].points, POINTS * [xy, xy, z], rtol=1e-15)
    assert str(open_log(str(path)).crs).startswith(text)


@pytest.mark.parametrize("wkt", [None, "", "\0\0", "PROJCS[broken"])
def test_an_empty_or_broken_crs_is_none(tmp_path: Path, wkt: str | None) -> None:
    path = tile(tmp_path / "a.las", wkt=wkt)
    assert open_log(str(path)).crs is None
    assert np.allclose(scans(str(path))[0].points, POINTS)


def test_degrees_are_refused(tmp_path: Path) -> None:
    path = tile(tmp_path / "a.las", 4326)
    refuses(str(path), f"{path}: its CRS 'WGS 84' is in degree, not projected", "pdal translate", "?crs=EPSG:n")
    assert open_log(f"{path}?crs=EPSG:32633").crs == "EPSG:32633"


def test_the_header_can_be_overridden(tmp_path: Path) -> None:
    path = tile(tmp_path / "a.las", 32632)
    assert np.allclose(scans(f"{path}?crs=EPSG:2994")[0].points, POINTS * FOOT)
    refuses(f"{path}?crs=EPSG:0", "?crs=EPSG:0 is not a CRS that PROJ knows", error=LogError)
    refuses(f"{path}?crs=", "?crs= is not a CRS", error=LogError)


def geokeys(path: Path, keys: dict[int, int], liblas_wkt: str = "") -> Path:
    """The tile with GeoTIFF keys in place of WKT, as LAS up to 1.3 has."""
    las = laspy.read(tile(path, point_format=3))
    vlr = laspy.vlrs.known.GeoKeyDirectoryVlr()
    entry = type(vlr.geo_keys[0])
    vlr.geo_keys = [entry(key, 0, 1, value) for key, value in keys.items()]
    vlr.geo_keys_header.key_directory_version = 1
    vlr.geo_keys_header.number_of_keys = len(keys)
    las.header.vlrs.append(vlr)
    if liblas_wkt:
        las.header.vlrs.append(laspy.VLR("liblas", 2112, "OGR variant of OpenGIS WKT SRS", liblas_wkt.encode() + b"\0"))
    las.header.global_encoding.wkt = False
    las.write(str(path))
    return path


@pytest.mark.parametrize(
    ("keys", "crs", "xy", "z"),
    [
        ({1024: 1, 3072: 32632}, "EPSG:32632", 1.0, 1.0),
        ({1024: 1, 2048: 4269, 3072: 26910, 4099: 9003}, "EPSG:26910", 1.0, US_FOOT),
        ({1024: 1, 3072: 2994}, "Oregon GIC Lambert (ft) (metres)", FOOT, FOOT),
        ({1024: 1, 2048: 4269, 3072: 32767, 3076: 9001}, "None", 1.0, 1.0),
        ({1024: 1}, "None", 1.0, 1.0),
    ],
)
def test_geotiff_keys(tmp_path: Path, keys: dict[int, int], crs: str, xy: float, z: float) -> None:
    path = geokeys(tmp_path / "a.las", keys)
    assert crs in str(open_log(str(path)).crs)
    assert np.allclose(scans(str(path))[0].points, POINTS * [xy, xy, z])


def test_user_defined_keys_in_feet_need_the_crs_from_somewhere(tmp_path: Path) -> None:
    keys = {1024: 1, 2048: 4269, 3072: 32767, 3076: 9002}
    path = geokeys(tmp_path / "a.las", keys)
    refuses(str(path), "user-defined and not in metres (GeoTIFF unit 9002)", "?crs=EPSG:n", error=LogError)
    assert np.allclose(scans(f"{path}?crs=EPSG:2994")[0].points, POINTS * FOOT)
    path = geokeys(tmp_path / "b.las", keys, liblas_wkt=pyproj.CRS.from_epsg(2994).to_wkt("WKT1_GDAL"))
    assert np.allclose(scans(str(path))[0].points, POINTS * FOOT)


def test_geographic_keys_are_refused(tmp_path: Path) -> None:
    refuses(str(geokeys(tmp_path / "a.las", {1024: 2, 2048: 4326})), "is in degree, not projected")


def test_classes_and_withheld_points(tmp_path: Path) -> None:
    path = tile(tmp_path / "a.las", classes=[2, 5, 2], withheld=[0, 0, 1])
    assert len(scans(str(path))[0].points) == 2
    assert np.allclose(scans(f"{path}?class=2")[0].points, POINTS[:1])
    assert len(scans(f"{path}?class=2,5")[0].points) == 2
    assert scans(f"{path}?class=9")[0].points.shape == (0, 3)
    refuses(f"{path}?class=ground", "?class=ground is not a comma list of whole numbers", error=LogError)


@pytest.mark.parametrize(
    ("made", "gps", "stamp"),
    [
        (None, None, 0),
        (date(2015, 9, 10), None, 1441843200 * NS),
        (date(2015, 9, 10), [206860645.5, 206860644.25, 206860700.0], 1522825426250000000),
    ],
)
def test_stamps(tmp_path: Path, made: date | None, gps: list[float] | None, stamp: int) -> None:
    assert scans(str(tile(tmp_path / "a.las", made=made, gps=gps)))[0].stamp_ns == stamp


@pytest.mark.parametrize(
    ("utc", "ahead"),
    [
        (datetime(1980, 1, 6, tzinfo=UTC), 0),
        (datetime(1999, 1, 1, tzinfo=UTC), 13),
        (datetime(2016, 12, 31, 23, 59, 59, tzinfo=UTC), 17),
        (datetime(2017, 1, 1, tzinfo=UTC), 18),
        (datetime(2024, 5, 1, tzinfo=UTC), 18),
    ],
)
def test_gps_time_is_ahead_of_utc_by_the_leap_seconds(utc: datetime, ahead: int) -> None:
    unix = int(utc.timestamp())
    adjusted = unix - 315964800 + ahead - 10**9
    assert gps_to_unix_ns(adjusted) == unix * NS


def test_a_folder_is_read_in_the_order_of_its_times(tmp_path: Path) -> None:
    for name, start in (("a", 3e8), ("b", 1e8), ("c", 2e8)):
        tile(tmp_path / f"{name}.laz", 32632, gps=[start + 2, start + 1, start + 3])
    (tmp_path / "LICENSE.txt").write_text("free")
    assert open_log(str(tmp_path)).reader == "las"
    stamps = [scan.stamp_ns for scan in scans(str(tmp_path))]
    assert stamps == [gps_to_unix_ns(start + 1) for start in (1e8, 2e8, 3e8)]


def test_files_of_different_crs_are_refused(tmp_path: Path) -> None:
    tile(tmp_path / "a.las", 32632)
    tile(tmp_path / "b.las", 32633)
    refuses(str(tmp_path), "the files differ in CRS or unit", "a.las: EPSG:32632", "b.las: EPSG:32633", "?crs=EPSG:n")
    assert len(scans(f"{tmp_path}?crs=EPSG:32632")) == 2


def test_an_empty_file_is_an_empty_scan(tmp_path: Path) -> None:
    assert scans(str(tile(tmp_path / "a.las", points=np.empty((0, 3)), gps=[])))[0].points.shape == (0, 3)


def test_a_folder_without_las(tmp_path: Path) -> None:
    refuses(f"{tmp_path}?reader=las", "no .las or .laz file in this folder", error=LogError)


@pytest.mark.parametrize("suffix", ["las", "laz"])
def test_a_cut_file(tmp_path: Path, suffix: str) -> None:
    points = np.random.default_rng(0).uniform(0, 100, (5000, 3))
    path = tile(tmp_path / f"a.{suffix}", points=points)
    path.write_bytes(path.read_bytes()[:20000])
    why = "5000 points of 30 bytes need 150" if suffix == "las" else "record 1: truncated or damaged"
    refuses(str(path), f"{path}: ", why, error=LogError)


def test_a_header_that_counts_more_than_the_file_holds(tmp_path: Path) -> None:
    path = tile(tmp_path / "a.laz", 32632)
    whole = path.read_bytes()
    for at, value in ((100, 9_000_000), (96, 10**6), (243, 100_000)):
        path.write_bytes(whole[:at] + value.to_bytes(4, "little") + whole[at + 4 :])
        refuses(str(path), f"{path}: truncated or damaged: ", "bytes, there are", error=LogError)
