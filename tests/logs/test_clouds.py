from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from terrafuse.errors import LogError, PoseError
from terrafuse.logs import open_log

from .support import NS, reasons, refuses, scans, some_points, write_tum


def clouds(folder: Path, *names: str) -> Path:
    for i, name in enumerate(names):
        np.save(folder / f"{name}.npy", some_points(6, i))
    return folder


def line(folder: Path, *stamps: str, name: str = "trajectory.txt") -> Path:
    """A drive along x, one metre a pose."""
    return write_tum(folder / name, [(stamp, (i, 0, 0)) for i, stamp in enumerate(stamps)])


def test_stamps_from_the_names(tmp_path: Path) -> None:
    line(clouds(tmp_path, "1305031102.175304", "1305031102.400000"), "1305031102.175304", "1305031102.625")
    log = open_log(str(tmp_path))
    assert (log.reader, log.count, log.crs, log.georeferenced) == ("clouds", 2, None, False)
    first, second = scans(str(tmp_path))
    assert (first.stamp_ns, second.stamp_ns) == (1305031102175304000, 1305031102400000000)
    assert np.array_equal(first.points, some_points(6, 0))
    assert first.T_world_sensor.position.tolist() == [0, 0, 0]
    assert second.T_world_sensor.position[0] == pytest.approx(0.224696 / 0.449696)


def test_nanoseconds_in_the_names(tmp_path: Path) -> None:
    line(clouds(tmp_path, "315966265259836000"), "315966265.259836", name="gt.tum")
    assert scans(str(tmp_path))[0].stamp_ns == 315966265259836000


def test_frame_numbers_go_by_order(tmp_path: Path) -> None:
    line(clouds(tmp_path, "scan_1", "scan_2", "scan_10"), "5.0", "6.0", "7.5", name="poses.tum")
    found = scans(str(tmp_path))
    assert [scan.stamp_ns for scan in found] == [5 * NS, 6 * NS, 7_500_000_000]
    assert [scan.T_world_sensor.position[0] for scan in found] == [0, 1, 2]
    assert np.array_equal(found[2].points, some_points(6, 2))


def test_other_names_and_another_count_are_not_guessed(tmp_path: Path) -> None:
    path = line(clouds(tmp_path, "000000", "000001"), "1", "2", "3")
    refuses(str(tmp_path), f"{path}: 3 poses for 2 files", "names like '000000.npy' are no time", "one line a file")


def test_no_pose_is_invented(tmp_path: Path) -> None:
    names = ("100000000.0", "100000000.5", "100000001.0", "100000002.0")
    line(clouds(tmp_path, *names), "100000000", "100000001")
    assert reasons(str(tmp_path)) == ["no pose within 0.5 s"] * 2
    assert reasons(f"{tmp_path}?max_gap_s=1") == ["no pose within 1 s"]


def test_clouds_without_poses_need_a_word(tmp_path: Path) -> None:
    clouds(tmp_path, "000000", "000001")
    for path in (tmp_path, tmp_path / "000000.npy"):
        refuses(str(path), f"{path}: no trajectory", "?poses=FILE", "?poses=identity", error=LogError)
    for scan in scans(f"{tmp_path}?poses=identity"):
        assert scan.stamp_ns == 0
        assert np.array_equal(scan.T_world_sensor.matrix, np.eye(4))
    assert scans(f"{tmp_path / '000000.npy'}?poses=identity")[0].points.shape == (6, 3)


def test_clouds_in_the_world_come_in_the_order_of_their_names_stamps(tmp_path: Path) -> None:
    clouds(tmp_path, "200000000.5", "1000000000", "999999999.5")
    stamps = [scan.stamp_ns for scan in scans(f"{tmp_path}?poses=identity")]
    assert stamps == [200000000500000000, 999999999500000000, 1000000000 * NS]


def test_which_trajectory(tmp_path: Path) -> None:
    line(clouds(tmp_path, "a"), "1", name="slam.tum")
    line(tmp_path, "2", name="gt.tum")
    refuses(str(tmp_path), "several trajectories (gt.tum, slam.tum); say which: ?poses=gt.tum")
    assert scans(f"{tmp_path}?poses=slam.tum")[0].stamp_ns == NS
    assert scans(f"{tmp_path / 'a.npy'}?poses={tmp_path / 'gt.tum'}")[0].stamp_ns == 2 * NS
    refuses(f"{tmp_path}?poses=none.tum", "?poses=none.tum: there is no file", error=LogError)


def test_a_trajectory_of_any_name_is_not_a_cloud(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("1 2 3\n")
    path = line(tmp_path, "1", name="odometry.txt")
    (tmp_path / "LICENSE.txt").write_text("You may use this.\n")
    assert [scan.points.tolist() for scan in scans(f"{tmp_path}?poses={path.name}")] == [[[1, 2, 3]]]


def test_a_bad_pose_is_named(tmp_path: Path) -> None:
    clouds(tmp_path, "a")
    (tmp_path / "trajectory.txt").write_text("1 0 0 0 0 0 0 3\n")
    refuses(str(tmp_path), f"{tmp_path / 'trajectory.txt'}:1: quaternion", "has length 3", error=PoseError)


def test_files_of_several_kinds_need_a_choice(tmp_path: Path) -> None:
    clouds(tmp_path, "a")
    (tmp_path / "b.xyz").write_text("1 2 3\n")
    refuses(f"{tmp_path}?poses=identity", "several kinds (.npy, .xyz); say which: ?files=*.npy")
    assert len(scans(f"{tmp_path}?poses=identity&files=*.xyz")) == 1
    refuses(f"{tmp_path}?poses=identity&files=*.pcd", "no point file matches '*.pcd'; known are .pcd, .ply")


def test_bin_files_need_their_columns(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    np.arange(12, dtype="<f4").tofile(path)
    refuses(f"{path}?poses=identity", "say how many float32 a point has", "?columns=3 or ?columns=4")
    refuses(f"{path}?poses=identity&columns=2", "?columns=3")
    refuses(f"{path}?poses=identity&columns=four", "?columns=four is not a comma list of whole numbers")
    refuses(f"{path}?poses=identity&columns=5", f"{path}: 48 bytes are no whole number of points of 5 float32")
    assert scans(f"{path}?poses=identity&columns=4")[0].points.tolist() == [[0, 1, 2], [4, 5, 6], [8, 9, 10]]
    clouds(tmp_path, "b")
    refuses(f"{tmp_path / 'b.npy'}?poses=identity&columns=4", "?columns only counts for .bin files; .npy files")


def test_a_broken_cloud_is_named(tmp_path: Path) -> None:
    line(clouds(tmp_path, "a", "b"), "1", "2")
    path = tmp_path / "b.npy"
    path.write_bytes(path.read_bytes()[:-3])
    refuses(str(tmp_path), f"{path}: ", "truncated, or not a plain .npy array", error=LogError)


def test_an_all_nan_cloud_is_passed_on(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.full((4, 3), np.nan))
    assert np.isnan(scans(f"{tmp_path / 'a.npy'}?poses=identity")[0].points).all()


def test_las_with_a_trajectory_is_a_container_and_without_goes_to_its_own_reader(tmp_path: Path) -> None:
    laspy = pytest.importorskip("laspy", reason="package laspy is not installed")
    las = laspy.create(point_format=6, file_version="1.4")
    las.header.scales = [0.001] * 3
    las.xyz = np.array([[1.5, 2.5, 3.25]])
    las.write(str(tmp_path / "a.las"))
    line(tmp_path, "1")
    assert open_log(str(tmp_path)).reader == "clouds"
    (scan,) = scans(str(tmp_path))
    assert scan.points.tolist() == [[1.5, 2.5, 3.25]]
    refuses(f"{tmp_path}?poses=identity", "LAS in world coordinates has a unit and a CRS to heed: say ?reader=las")
