"""Real recordings, in the folder that TERRAFUSE_RECORDINGS names; the project does not ship them."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from terrafuse.logs import open_log
from terrafuse.logs.kitti import read_poses
from terrafuse.types import Scan, Skipped

from .support import read, refuses, scans


@pytest.fixture
def recordings() -> Path:
    folder = os.environ.get("TERRAFUSE_RECORDINGS")
    if not folder:
        pytest.skip("TERRAFUSE_RECORDINGS is not set to a folder of real recordings")
    return Path(folder)


def world(scan: Scan) -> np.ndarray:
    T = scan.T_world_sensor.matrix
    return scan.points @ T[:3, :3].T + T[:3, 3]


def near(cloud: np.ndarray, others: np.ndarray, radius_m: float) -> float:
    """Share of `cloud` with a point of `others` within the radius: a hash of cells, each looked up with its 26."""

    def keys(cells: np.ndarray) -> np.ndarray:
        return (cells[:, 0] * 2**42 + cells[:, 1] * 2**21 + cells[:, 2]).astype(np.int64)

    cells = np.floor(others / radius_m).astype(np.int64)
    order = np.argsort(keys(cells), kind="stable")
    sorted_keys, sorted_points = keys(cells)[order], others[order]
    own, found = np.floor(cloud / radius_m).astype(np.int64), np.zeros(len(cloud), bool)
    for offset in np.ndindex(3, 3, 3):
        wanted = keys(own + np.array(offset) - 1)
        first, last = np.searchsorted(sorted_keys, wanted), np.searchsorted(sorted_keys, wanted, "right")
        for step in range(int((last - first).max(initial=0))):
            open_ = np.flatnonzero(~found & (first + step < last))
            if not len(open_):
                break
            gap = cloud[open_] - sorted_points[first[open_] + step]
            found[open_] = np.einsum("ij,ij->i", gap, gap) <= radius_m**2
    return float(found.mean())


def test_kitti_scans_overlap_by_their_poses(recordings: Path) -> None:
    path = recordings / "lidar3d" / "patchworkpp_kitti"
    refuses(str(path), "several files could be the poses (poses_cam0_first6.txt, poses_velo_first6.txt)")
    refuses(f"{path}?poses=poses_cam0_first6.txt", "?calib=identity")
    found = scans(f"{path}?poses=poses_velo_first6.txt&calib=identity")
    assert len(found) == 6
    assert all(len(scan.points) > 123_000 for scan in found)
    close = np.linalg.norm(found[1].points, axis=1) < 25  # further out the rings of a scan are over 0.2 m apart
    assert near(world(found[1])[close], world(found[0]), 0.2) == pytest.approx(0.907, abs=0.005)
    assert near(found[1].points[close], found[0].points, 0.2) == pytest.approx(0.754, abs=0.005)


def test_kitti_camera_poses_give_the_lidars(recordings: Path, tmp_path: Path) -> None:
    path = recordings / "lidar3d" / "patchworkpp_kitti"
    calibration = tmp_path / "calib.txt"
    calibration.write_text(
        "Tr: 4.276802385584e-04 -9.999672484946e-01 -8.084491683471e-03 -1.198459927713e-02 "
        "-7.210626507497e-03 8.081198471645e-03 -9.999413164504e-01 -5.403984729748e-02 "
        "9.999738645903e-01 4.859485810390e-04 -7.206933692422e-03 -2.921968648686e-01\n"
    )
    found = scans(f"{path}?poses=poses_cam0_first6.txt&calib={calibration}")
    for scan, expected in zip(found, read_poses(path / "poses_velo_first6.txt"), strict=True):
        assert np.allclose(scan.T_world_sensor.matrix, expected.matrix, atol=1e-6)


def test_av2_ground_lies_on_the_surveyed_raster(recordings: Path) -> None:
    (path,) = (recordings / "lidar3d" / "av2").glob("7fab2350*")
    found = scans(str(path))
    assert [len(scan.points) for scan in found] == pytest.approx([99_000, 99_000], abs=1500)
    raster = np.load(next((path / "map").glob("*ground_height*.npy"))).astype(float)
    sim2 = next((path / "map").glob("*img_Sim2_city.json")).read_text()
    shift = [float(part) for part in sim2.split('"t":')[1].split("[")[1].split("]")[0].split(",")]
    for scan in found:
        points = world(scan)
        column, row = np.floor((points[:, :2] + shift) / 0.3).astype(int).T
        inside = (column >= 0) & (row >= 0) & (row < raster.shape[0]) & (column < raster.shape[1])
        above = points[inside, 2] - raster[row[inside], column[inside]]
        ground = above[np.abs(above) < 0.3]
        assert abs(float(np.median(ground))) < 0.02
        assert np.mean(above[np.isfinite(above)] < -0.5) < 0.001


def test_av2_without_sweeps(recordings: Path) -> None:
    (path,) = (recordings / "lidar3d" / "av2").glob("3bffdcff*")
    refuses(str(path), "no sensors/lidar/*.feather")


@pytest.mark.parametrize("name", ["autzen_trim.laz", "autzen-thin-srs.las"])
def test_autzen_in_metres(recordings: Path, name: str) -> None:
    pyproj = pytest.importorskip("pyproj", reason="package pyproj is not installed")
    path = recordings / "airborne" / "pdal" / name
    log = open_log(str(path))
    crs = pyproj.CRS.from_user_input(log.crs)
    assert crs.name == "NAD_1983_HARN_Lambert_Conformal_Conic (metres)"
    assert {axis.unit_name for axis in crs.axis_info} == {"metre"}
    assert log.georeferenced
    (scan,) = scans(str(path))
    # Autzen Stadium, Eugene, Oregon
    longitude, latitude = pyproj.Transformer.from_crs(crs, 4326, always_xy=True).transform(*scan.points[0, :2])
    assert (longitude, latitude) == pytest.approx((-123.07, 44.06), abs=0.02)


def test_autzen_counts_and_extent(recordings: Path) -> None:
    path = recordings / "airborne" / "pdal" / "autzen_trim.laz"
    (scan,) = scans(str(path))
    assert len(scan.points) == 110_000
    assert np.ptp(scan.points, axis=0)[:2] == pytest.approx([359, 171], abs=1)
    assert len(scans(f"{path}?class=2")[0].points) == 26_107


def test_warsaw_has_an_empty_crs_and_absolute_times(recordings: Path) -> None:
    path = recordings / "airborne" / "pdal" / "warsaw_small.las"
    assert open_log(str(path)).crs is None
    (scan,) = scans(str(path))
    assert (len(scan.points), scan.stamp_ns // 10**9) == (3000, 1522825427)
    refuses(str(path.parent), "the files differ in CRS or unit")


@pytest.mark.parametrize(
    ("name", "count", "limit_m"),
    [
        ("ple_corrected/intel-corrected.log.gz?stamps=index&rate_hz=5", 910, 50),
        ("ple_corrected/freiburg-079-corrected.log.gz", 4791, 50),
        ("ple_corrected/freiburg-101-corrected.log.gz", 292, 50),
        ("ple_corrected/edmonton-corrected.log.gz", 340, 50),
        ("ple_corrected/csail-corrected.log.gz?stamps=index&rate_hz=2", 406, 50),
        ("radish_raw/fr079.clf.bz2", 4934, 50),
    ],
)
def test_carmen(recordings: Path, name: str, count: int, limit_m: float) -> None:
    found = scans(str(recordings / "lidar2d" / name))
    assert len(found) == count
    assert max(float(np.abs(scan.points).max(initial=0)) for scan in found) < limit_m


def test_carmen_clocks(recordings: Path) -> None:
    folder = recordings / "lidar2d" / "ple_corrected"
    refuses(str(folder / "intel-corrected.log.gz"), "record 296: its stamp 940.540000000 s runs backwards")
    records = read(f"{folder / 'intel-corrected.log.gz'}?backwards=drop")
    assert (len(records), sum(isinstance(record, Skipped) for record in records)) == (910, 4)
    refuses(str(folder / "csail-corrected.log.gz"), "the clock stands still, 2 different stamps in 406 scans")


@pytest.mark.parametrize(
    ("name", "count"),
    [
        ("airborne/pcl_isprs/samp11-utm.pcd", 38_010),
        ("expected/grid_map_pcl_flat_ground/plane_noisy.pcd", 56_423),
        ("lidar3d/libpointmatcher/car_cloud400.csv", 24_989),
        ("lidar3d/libpointmatcher/car_cloud401.csv", 25_193),
        ("lidar3d/gtsam_points/newer_01/planes_000000.bin", 19_968),
    ],
)
def test_point_files(recordings: Path, name: str, count: int) -> None:
    query = "&columns=3" if name.endswith(".bin") else ""
    (scan,) = scans(f"{recordings / name}?poses=identity{query}")
    assert scan.points.shape == (count, 3)
    assert np.isfinite(scan.points).all()


def test_isprs_lies_in_utm(recordings: Path) -> None:
    (scan,) = scans(f"{recordings / 'airborne/pcl_isprs/samp11-utm.pcd'}?poses=identity")
    assert scan.points.min(axis=0) == pytest.approx([512700.88, 5403547.5, 295.25], abs=0.01)
    assert scan.points.max(axis=0) == pytest.approx([512834.75, 5403850.0, 404.08], abs=0.01)


def test_a_plane_is_flat(recordings: Path) -> None:
    path = recordings / "expected" / "grid_map_pcl_flat_ground" / "plane_noisy.pcd"
    (scan,) = scans(f"{path}?poses=identity")
    assert float(scan.points[:, 2].std()) == pytest.approx(0.026, abs=0.001)


def test_a_table_of_two_columns(recordings: Path) -> None:
    path = recordings / "lidar3d" / "libpointmatcher" / "2D_oneBox.csv"
    refuses(f"{path}?poses=identity", f"{path}: 2 columns; points need x, y, z")


def test_a_bag_without_clouds(recordings: Path) -> None:
    path = recordings / "bags" / "grid_map_demo" / "grid_map.bag"
    refuses(str(path), "no PointCloud2 or LaserScan messages", "/grid_map (grid_map_msgs/msg/GridMap)")


@pytest.mark.parametrize(
    "name", ["lidar3d/3dtk_dat", "multirobot/mrclam6", "maps/nav2", "lidar2d/dpslam_loop5/loop5.log"]
)
def test_other_formats_are_refused(recordings: Path, name: str) -> None:
    refuses(str(recordings / name), "not a recording of a known format")
