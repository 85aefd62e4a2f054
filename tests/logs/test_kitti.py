from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from terrafuse.errors import LogError
from terrafuse.logs import open_log
from terrafuse.types import Pose

from .support import NS, pose, refuses, scans, some_points

TR = np.array([[0, -1, 0, 0.01], [0, 0, -1, -0.05], [1, 0, 0, -0.3]])
"""Lidar (x forward, y left, z up) to camera (x right, y down, z forward), and a little apart."""


def row(matrix: np.ndarray) -> str:
    return " ".join(repr(float(value)) for value in matrix[:3].ravel())


def sequence(folder: Path, count: int = 3, first: int = 0, velodyne: str = "velodyne") -> Path:
    """A drive along the camera's z with a calib.txt; the lidar's poses are those of `lidar_pose`."""
    (folder / velodyne).mkdir(parents=True, exist_ok=True)
    Tr = Pose(np.vstack([TR, [0, 0, 0, 1]]))
    rows = []
    for i in range(count):
        cloud = np.hstack([some_points(20, i), np.full((20, 1), 0.5, np.float32)])
        cloud.tofile(folder / velodyne / f"{first + i:06d}.bin")
        rows.append(row((Tr @ lidar_pose(i) @ Tr.inverse()).matrix))
    (folder / "poses.txt").write_text("\n".join(rows) + "\n")
    (folder / "calib.txt").write_text(f"P0: {row(np.eye(4))}\nTr: {row(TR)}\n")
    return folder


def lidar_pose(i: int) -> Pose:
    return pose(2.0 * i, 0.1 * i, 0.3 * i, yaw=0.2 * i)


@pytest.mark.parametrize("velodyne", ["velodyne", "."])
def test_camera_poses_become_lidar_poses_with_z_up(tmp_path: Path, velodyne: str) -> None:
    log = open_log(str(sequence(tmp_path, velodyne=velodyne)))
    assert (log.reader, log.count) == ("kitti", 3)
    for i, scan in enumerate(scans(str(tmp_path))):
        assert np.array_equal(scan.points, some_points(20, i))
        assert scan.points.dtype == np.float32
        assert scan.stamp_ns == i * NS // 10
        assert np.allclose(scan.T_world_sensor.matrix, lidar_pose(i).matrix, atol=1e-12)


def test_lidar_poses_are_taken_as_they_are(tmp_path: Path) -> None:
    sequence(tmp_path)
    (tmp_path / "lidar.txt").write_text("\n".join(row(lidar_pose(i).matrix) for i in range(3)))
    (tmp_path / "calib.txt").unlink()
    found = scans(f"{tmp_path}?poses=lidar.txt&calib=identity&rate_hz=20")
    assert [scan.stamp_ns for scan in found] == [0, NS // 20, NS // 10]
    assert np.allclose(found[2].T_world_sensor.matrix, lidar_pose(2).matrix, atol=1e-12)


def test_times_are_read_exactly(tmp_path: Path) -> None:
    (sequence(tmp_path) / "times.txt").write_text("0.000000e+00\n1.037875e-01\n2.076000e-01\n")
    assert [scan.stamp_ns for scan in scans(str(tmp_path))] == [0, 103787500, 207600000]
    refuses(f"{tmp_path}?rate_hz=5", "times.txt: the recording has times; leave out ?rate_hz")
    (tmp_path / "times.txt").write_text("0.0\n0.1\n")
    refuses(str(tmp_path), "2 times, but scan 2, counted from 0, needs one")
    (tmp_path / "times.txt").write_text("0.0\nsoon\n0.2\n")
    refuses(str(tmp_path), "times.txt:2: 'soon' is not a number of seconds")


def test_a_subset_keeps_its_rows(tmp_path: Path) -> None:
    sequence(tmp_path, count=4)
    (tmp_path / "velodyne" / "000000.bin").unlink()
    (tmp_path / "velodyne" / "000002.bin").unlink()
    found = scans(str(tmp_path))
    assert [scan.stamp_ns for scan in found] == [NS // 10, 3 * NS // 10]
    assert np.allclose(found[1].T_world_sensor.matrix, lidar_pose(3).matrix, atol=1e-12)


def test_names_that_are_no_rows_need_one_pose_each(tmp_path: Path) -> None:
    sequence(tmp_path, first=100)
    assert np.allclose(scans(str(tmp_path))[2].T_world_sensor.matrix, lidar_pose(2).matrix, atol=1e-12)
    (tmp_path / "velodyne" / "000100.bin").unlink()
    refuses(str(tmp_path), "poses.txt: 3 poses for 2 scans 000101 … 000102, whose names are not row numbers")


def test_more_scans_than_poses(tmp_path: Path) -> None:
    sequence(tmp_path)
    (tmp_path / "velodyne" / "000003.bin").write_bytes(bytes(16))
    refuses(str(tmp_path), "poses.txt: 3 poses for 4 scans; remove those without, or give ?poses=FILE", error=LogError)


def test_a_cut_scan(tmp_path: Path) -> None:
    sequence(tmp_path)
    path = tmp_path / "velodyne" / "000001.bin"
    path.write_bytes(path.read_bytes()[:-4])
    refuses(
        str(tmp_path),
        f"{path}: 316 bytes are no whole number of points of 16 bytes",
        "?reader=clouds&columns=N",
        error=LogError,
    )


@pytest.mark.parametrize(
    ("bad", "why"),
    [
        ("1 0 0 nan 0 1 0 0 0 0 1 0", ":2: holds NaN or infinity"),
        ("2 0 0 0 0 1 0 0 0 0 1 0", ":2: not a rigid motion"),
        ("1 0 0 0 0 -1 0 0 0 0 1 0", ":2: not a rigid motion"),
        ("1 0 0 0 0 1 0 0 0 0 1", ":2: 11 numbers, not the 12 of a 3×4 pose"),
        ("1 0 0 0 0 1 0 0 0 0 1 x", ":2: could not convert string to float: 'x'"),
    ],
)
def test_a_bad_pose_row_is_named(tmp_path: Path, bad: str, why: str) -> None:
    lines = (sequence(tmp_path) / "poses.txt").read_text().splitlines()
    (tmp_path / "poses.txt").write_text("\n".join([lines[0], bad, lines[2]]))
    refuses(str(tmp_path), f"{tmp_path / 'poses.txt'}{why}", error=LogError)


def test_several_pose_files_are_listed(tmp_path: Path) -> None:
    text = (sequence(tmp_path) / "poses.txt").read_text()
    (tmp_path / "poses.txt").unlink()
    refuses(str(tmp_path), "no poses.txt; give ?poses=FILE with a row of 12 numbers")
    (tmp_path / "gt.txt").write_text(text)
    (tmp_path / "readme.txt").write_text("hello")
    assert len(scans(str(tmp_path))) == 3
    (tmp_path / "slam.txt").write_text(text)
    refuses(str(tmp_path), "several files could be the poses (gt.txt, slam.txt); say which: ?poses=gt.txt")
    assert len(scans(f"{tmp_path}?poses={tmp_path / 'slam.txt'}")) == 3
    refuses(f"{tmp_path}?poses=no.txt", "?poses=no.txt: there is no file")


def test_the_calibration_is_never_guessed(tmp_path: Path) -> None:
    (sequence(tmp_path) / "calib.txt").rename(tmp_path / "mine.txt")
    refuses(str(tmp_path), "no calib.txt with a 'Tr:' row", "?calib=identity if the poses are the lidar's own")
    assert len(scans(f"{tmp_path}?calib=mine.txt")) == 3
    (tmp_path / "mine.txt").write_text(f"Tr_velo_cam: {row(TR)}\n")
    assert len(scans(f"{tmp_path}?calib=mine.txt")) == 3
    (tmp_path / "mine.txt").write_text("P0: 1 2 3\n")
    refuses(f"{tmp_path}?calib=mine.txt", "mine.txt: no row 'Tr:' or 'Tr_velo_cam:'")
    (tmp_path / "mine.txt").write_text("Tr: 1 2 3\n")
    refuses(f"{tmp_path}?calib=mine.txt", "mine.txt:1: 3 numbers, not the 12")
