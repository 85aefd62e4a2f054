from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from terrafuse.errors import LogError
from terrafuse.logs import open_log
from terrafuse.logs.recorder import McapRecorder
from terrafuse.types import Pose, Scan

from .support import NS, pose, refuses, scans, some_points
from .test_trajectory import positions, quaternions

T0 = 1_700_000_000 * NS


def record(path: Path, T_base_sensor: Pose | None = None) -> None:
    with McapRecorder(path) as recorder:
        if T_base_sensor is not None:
            recorder.static(T_base_sensor)
        for i in range(5):
            stamp = T0 + i * NS // 10
            recorder.pose(stamp, pose(i, 2, 3, yaw=0.1 * i))
            recorder.scan(stamp, some_points(50, i))


def test_what_is_recorded_is_read_back(tmp_path: Path) -> None:
    mounting = pose(0.1, 0.2, 1.5, yaw=1.0)
    record(tmp_path / "a.mcap", mounting)
    for query in ("", "?pose=/odom", "?pose=/tf&fixed_frame=map"):
        found = scans(f"{tmp_path / 'a.mcap'}{query}")
        assert [scan.stamp_ns for scan in found] == [T0 + i * NS // 10 for i in range(5)]
        for i, scan in enumerate(found):
            assert np.array_equal(scan.points, some_points(50, i))
            expected = pose(i, 2, 3, yaw=0.1 * i) @ mounting
            assert np.allclose(scan.T_world_sensor.matrix, expected.matrix, atol=1e-9)


@settings(max_examples=15)
@given(positions, quaternions, quaternions, st.integers(0, 2**31 * NS - 1))
def test_any_pose_survives(
    tmp_path_factory: pytest.TempPathFactory,
    place: tuple[float, ...],
    turn: tuple[float, ...],
    mounted: tuple[float, ...],
    stamp: int,
) -> None:
    path = tmp_path_factory.mktemp("bag") / "a.mcap"
    T_world_base, T_base_sensor = Pose.from_quaternion(place, turn), Pose.from_quaternion((1, 2, 3), mounted)
    with McapRecorder(path) as recorder:
        recorder.static(T_base_sensor)
        recorder.pose(stamp, T_world_base)
        recorder.scan(stamp, np.array([[1.5, np.nan, np.inf]]))
    (scan,) = open_log(str(path)).scans()
    assert isinstance(scan, Scan)
    assert np.allclose(scan.T_world_sensor.matrix, (T_world_base @ T_base_sensor).matrix, atol=1e-9)
    assert np.array_equal(scan.points, [[1.5, np.nan, np.inf]], equal_nan=True)


def test_without_static_the_sensor_is_at_the_base(tmp_path: Path) -> None:
    record(tmp_path / "a.mcap")
    assert scans(str(tmp_path / "a.mcap"))[3].T_world_sensor.position.tolist() == [3, 2, 3]


def test_clouds_in_the_base_frame_itself(tmp_path: Path) -> None:
    with McapRecorder(tmp_path / "a.mcap", frame="base_link") as recorder:
        recorder.pose(T0, pose(1))
        recorder.scan(T0, some_points(3))
        with pytest.raises(LogError, match="the clouds are in base_link itself"):
            recorder.static(pose())
    assert scans(str(tmp_path / "a.mcap"))[0].T_world_sensor.position.tolist() == [1, 0, 0]


def test_a_failed_recording_leaves_no_file(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_text("the one before")

    def crash() -> None:
        with McapRecorder(tmp_path / "a.mcap") as recorder:
            recorder.pose(T0, pose())
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        crash()
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]
    assert (tmp_path / "a.mcap").read_text() == "the one before"


def test_the_file_appears_when_it_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with McapRecorder(path) as recorder:
        recorder.pose(T0, pose())
        assert not path.exists()
    assert [found.name for found in tmp_path.iterdir()] == ["a.mcap"]


def test_other_tools_can_decode_it(tmp_path: Path) -> None:
    reader = pytest.importorskip("mcap.reader", reason="package mcap is not installed")
    record(tmp_path / "a.mcap")
    with (tmp_path / "a.mcap").open("rb") as file:
        summary = reader.make_reader(file).get_summary()
        file.seek(0)
        assert reader.make_reader(file).get_header().profile == "ros2"
    names = {channel.topic: summary.schemas[channel.schema_id].name for channel in summary.channels.values()}
    assert names == {
        "/points": "sensor_msgs/msg/PointCloud2",
        "/tf": "tf2_msgs/msg/TFMessage",
        "/tf_static": "tf2_msgs/msg/TFMessage",
        "/odom": "nav_msgs/msg/Odometry",
    }
    assert {channel.message_encoding for channel in summary.channels.values()} == {"cdr"}
    assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}


@pytest.mark.parametrize("stamp", [-1, 2**31 * NS])
def test_stamps_outside_ros_time_are_refused(tmp_path: Path, stamp: int) -> None:
    with McapRecorder(tmp_path / "a.mcap") as recorder, pytest.raises(LogError, match="is outside ROS time"):
        recorder.scan(stamp, some_points())


def test_a_truncated_recording_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    record(path)
    path.write_bytes(path.read_bytes()[:-100])
    refuses(str(path), str(path), "`mcap recover`", error=LogError)
