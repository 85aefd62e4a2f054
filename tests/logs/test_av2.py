from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from terrafuse.errors import LogError, PoseError
from terrafuse.logs import open_log

from .support import NS, reasons, refuses, scans, some_points

pa = pytest.importorskip("pyarrow", reason="package pyarrow is not installed")
feather = pytest.importorskip("pyarrow.feather")

T0 = 315966265259836000
POINTS = some_points(30, dtype=np.float16)


def write_log(folder: Path, pose_stamps: list[int], sweep_stamps: list[int], **changes: object) -> Path:
    (folder / "sensors" / "lidar").mkdir(parents=True)
    count = len(pose_stamps)
    zero, one = np.zeros(count), np.ones(count)
    poses = {
        "timestamp_ns": np.array(pose_stamps, np.int64),
        **{"qw": one, "qx": zero, "qy": zero, "qz": zero},
        **{"tx_m": np.arange(count, dtype=float), "ty_m": zero, "tz_m": zero},
        **changes,
    }
    feather.write_feather(pa.table(poses), folder / "city_SE3_egovehicle.feather")
    for stamp in sweep_stamps:
        sweep = {name: POINTS[:, axis] for axis, name in enumerate("xyz")}
        feather.write_feather(
            pa.table({**sweep, "intensity": np.zeros(30, np.uint8)}),
            folder / "sensors" / "lidar" / f"{stamp}.feather",
        )
    return folder


def test_sweeps_are_placed_at_their_stamps(tmp_path: Path) -> None:
    write_log(tmp_path, [T0, T0 + NS // 10, T0 + NS // 5], [T0 + NS // 20, T0 + NS // 5])
    log = open_log(str(tmp_path))
    assert (log.reader, log.count) == ("av2", 2)
    first, second = scans(str(tmp_path))
    assert first.stamp_ns == T0 + NS // 20
    assert first.points.dtype == np.float32
    assert np.array_equal(first.points, POINTS)
    assert first.T_world_sensor.position.tolist() == [0.5, 0, 0]
    assert second.T_world_sensor.position.tolist() == [2, 0, 0]


def test_a_sweep_outside_the_poses_is_skipped(tmp_path: Path) -> None:
    write_log(tmp_path, [T0, T0 + NS], [T0 - 1, T0, T0 + NS // 2])
    assert reasons(str(tmp_path)) == ["no pose within 0.5 s"] * 2
    assert reasons(f"{tmp_path}?max_gap_s=1") == ["no pose within 1 s"]


def test_a_log_without_sweeps(tmp_path: Path) -> None:
    refuses(str(write_log(tmp_path, [T0], [])), f"{tmp_path}: no sensors/lidar/*.feather", error=LogError)


def test_a_sweep_without_a_stamp(tmp_path: Path) -> None:
    write_log(tmp_path, [T0], [T0])
    (tmp_path / "sensors" / "lidar" / "first.feather").write_bytes(b"")
    refuses(str(tmp_path), "first.feather: a sweep is named by its stamp in nanoseconds", error=LogError)


def test_a_missing_column(tmp_path: Path) -> None:
    write_log(tmp_path, [T0], [T0])
    feather.write_feather(pa.table({"x": [1.0], "y": [2.0]}), tmp_path / "sensors" / "lidar" / f"{T0}.feather")
    refuses(str(tmp_path), f"{T0}.feather: no column z; it has x, y", error=LogError)


def test_a_bad_pose_row_is_named(tmp_path: Path) -> None:
    write_log(tmp_path, [T0, T0 + 1], [T0], qw=np.array([1, np.nan]))
    refuses(str(tmp_path), "city_SE3_egovehicle.feather: row 2: the pose holds NaN", error=PoseError)


def test_a_cut_sweep(tmp_path: Path) -> None:
    write_log(tmp_path, [T0], [T0])
    path = tmp_path / "sensors" / "lidar" / f"{T0}.feather"
    path.write_bytes(path.read_bytes()[:100])
    refuses(str(tmp_path), f"{tmp_path}: record 1: truncated or damaged", error=LogError)
