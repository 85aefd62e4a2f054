from __future__ import annotations

import shutil
import sqlite3
import types
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from terrafuse.errors import LogError, PoseError
from terrafuse.logs import open_log
from terrafuse.logs.ros.points import cloud_points
from terrafuse.types import Pose, Scan

from .rosbag_support import (
    KINDS,
    POSE,
    POSE_COVARIANCE,
    Entry,
    Maker,
    cloud,
    laser,
    moving,
    odometry,
    points_as,
    stamped_pose,
    text,
    tf,
    write_bag,
)
from .support import IDENTITY_QUATERNION, NS, read, reasons, refuses, scans, some_points

Q = IDENTITY_QUATERNION
TURN_90 = (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))
T0 = 1_700_000_000 * NS
POINTS = some_points(12)


def at(seconds: float) -> int:
    return T0 + round(seconds * NS)


def drive(*clouds: Entry) -> list[Entry]:
    """map → odom → base_link moving 1 m/s along x over one second, lidar mounted 2 m up and turned by 90°."""
    return [
        tf(at(0), "base_link", "lidar", (0, 0, 2, *TURN_90), "/tf_static"),
        tf(at(0), "map", "odom", (100, 0, 0, *Q)),
        tf(at(0), "odom", "base_link", (0, 0, 0, *Q)),
        tf(at(0.5), "map", "odom", (100, 0, 0, *Q)),
        tf(at(0.5), "odom", "base_link", (0.5, 0, 0, *Q)),
        *clouds,
        tf(at(1), "map", "odom", (100, 0, 0, *Q)),
        tf(at(1), "odom", "base_link", (1, 0, 0, *Q)),
    ]


@pytest.mark.parametrize("kind", KINDS)
def test_clouds_are_placed_by_the_tf_tree(tmp_path: Path, kind: str) -> None:
    path = write_bag(tmp_path, kind, drive(cloud(at(0.25), POINTS), cloud(at(0.5), POINTS)))
    log = open_log(str(path))
    assert (log.reader, log.count, log.crs, log.georeferenced) == ("ros", 2, None, False)
    first, second = scans(str(path))
    assert first.stamp_ns == at(0.25)
    assert np.array_equal(first.points, POINTS)
    assert first.points.dtype == np.float32
    expected = Pose.from_quaternion((100.25, 0, 2), TURN_90)
    assert np.allclose(first.T_world_sensor.matrix, expected.matrix, atol=1e-12)
    assert second.T_world_sensor.position.tolist() == [100.5, 0, 2]


@pytest.mark.parametrize("kind", ["db3", "mcap"])
def test_a_bare_file_reads_as_its_folder_does(tmp_path: Path, kind: str) -> None:
    path = write_bag(tmp_path, kind, drive(cloud(at(0.25), POINTS)))
    bare = tmp_path / f"alone.{kind}"
    shutil.copy(path / f"{path.name}.{kind}", bare)
    (path / "metadata.yaml").unlink()  # the recorder crashed
    for place in (bare, path):
        (scan,) = scans(str(place))
        assert scan.T_world_sensor.position.tolist() == [100.25, 0, 2]


def test_a_bag_from_before_message_definitions_were_stored(tmp_path: Path) -> None:
    path = write_bag(tmp_path, "db3", drive(cloud(at(0.25), POINTS)))
    with closing(sqlite3.connect(path / f"{path.name}.db3")) as database, database:
        database.execute("DELETE FROM message_definitions")
    assert scans(str(path))[0].T_world_sensor.position.tolist() == [100.25, 0, 2]


def test_a_folder_of_several_files_without_metadata_is_refused(tmp_path: Path) -> None:
    path = write_bag(tmp_path, "mcap", drive(cloud(at(0.25), POINTS)))
    shutil.copy(path / f"{path.name}.mcap", path / "second.mcap")
    (path / "metadata.yaml").unlink()
    refuses(str(path), "no metadata.yaml and 2 files (drive_mcap.mcap, second.mcap)", "`ros2 bag reindex`")


def test_scans_may_be_read_again(tmp_path: Path) -> None:
    log = open_log(str(write_bag(tmp_path, "mcap", drive(cloud(at(0.25), POINTS)))))
    assert [r.stamp_ns for r in log.scans()] == [r.stamp_ns for r in log.scans()] == [at(0.25)]


def test_the_fixed_frame_can_be_chosen(tmp_path: Path) -> None:
    path = write_bag(tmp_path, "mcap", drive(cloud(at(0.25), POINTS)))
    (scan,) = scans(f"{path}?fixed_frame=odom")
    assert scan.T_world_sensor.position.tolist() == [0.25, 0, 2]
    (scan,) = scans(f"{path}?fixed_frame=lidar&pose=/tf")
    assert np.array_equal(scan.T_world_sensor.matrix, np.eye(4))
    assert np.array_equal(scans(f"{path}?fixed_frame=lidar")[0].T_world_sensor.matrix, np.eye(4))
    refuses(f"{path}?fixed_frame=earth", "'earth' is not above", "lidar, base_link, odom, map")


def test_no_pose_is_invented_outside_the_trajectory_or_in_a_gap(tmp_path: Path) -> None:
    clouds = [cloud(at(-0.1), POINTS), cloud(at(0.25), POINTS), cloud(at(1.1), POINTS)]
    path = write_bag(tmp_path, "mcap", drive(*clouds))
    assert reasons(str(path)) == ["no pose within 0.5 s"] * 2
    assert reasons(f"{path}?max_gap_s=0.4") == ["no pose within 0.4 s"] * 3
    refuses(f"{path}?max_gap_s=-1", "?max_gap_s=-1 is not a positive number")


def test_tf_is_ordered_by_stamp_and_the_first_of_a_stamp_counts(tmp_path: Path) -> None:
    entries = [
        cloud(at(0.5), POINTS, "base_link"),
        tf(at(1), "/map", "/base_link", (1, 0, 0, *Q)),
        tf(at(0), "map", "base_link", (0, 0, 0, *Q)),
        tf(at(0), "map", "base_link", (50, 0, 0, *Q)),
    ]
    (scan,) = scans(f"{write_bag(tmp_path, 'bag', entries)}?max_gap_s=2")
    assert scan.T_world_sensor.position.tolist() == [0.5, 0, 0]


def test_frames_with_two_parents_are_refused(tmp_path: Path) -> None:
    entries = [*drive(cloud(at(0.25), POINTS)), tf(at(1), "world", "base_link", (0, 0, 0, *Q))]
    refuses(str(write_bag(tmp_path, "mcap", entries)), "frame 'base_link' several parents (odom, world)", "?pose=")


def test_a_circle_of_frames_is_refused(tmp_path: Path) -> None:
    entries = [cloud(at(0), POINTS, "a"), tf(at(0), "b", "a", (0, 0, 0, *Q)), tf(at(0), "a", "b", (0, 0, 0, *Q))]
    refuses(str(write_bag(tmp_path, "mcap", entries)), "tf runs in a circle above 'a'")


@pytest.mark.parametrize(
    ("quaternion", "why"), [((0, 0, 0, 0.5), "has length 0.5, not 1"), ((0, 0, np.nan, 1), "NaN or infinity")]
)
def test_a_bad_transform_is_named(tmp_path: Path, quaternion: tuple[float, ...], why: str) -> None:
    entries = [*drive(cloud(at(0.25), POINTS)), tf(at(2), "odom", "base_link", (0, 0, 0, *quaternion))]
    path = write_bag(tmp_path, "mcap", entries)
    refuses(str(path), f"{path}: /tf odom → base_link: message 7", why, error=PoseError)


def test_nonsense_in_other_frames_is_of_no_concern(tmp_path: Path) -> None:
    entries = [*drive(cloud(at(0.25), POINTS)), tf(at(0.2), "base_link", "arm", (np.nan, 0, 0, 0, 0, 0, 0))]
    assert scans(str(write_bag(tmp_path, "bag", entries)))[0].T_world_sensor.position.tolist() == [100.25, 0, 2]


# --- odometry and pose topics ---


def odometry_drive(frame: str, *others: Entry) -> list[Entry]:
    return [odometry(at(0), (0, 0, 0, *Q)), cloud(at(0.25), POINTS, frame), odometry(at(0.5), (2, 0, 0, *Q)), *others]


@pytest.mark.parametrize("kind", KINDS)
def test_odometry_of_the_clouds_own_frame(tmp_path: Path, kind: str) -> None:
    (scan,) = scans(str(write_bag(tmp_path, kind, odometry_drive("base_link"))))
    assert scan.T_world_sensor.position.tolist() == [1, 0, 0]


def test_odometry_and_the_mounting_from_tf_static(tmp_path: Path) -> None:
    mounting = [
        tf(at(0), "chassis", "base_link", (0, 0, -1, *Q), "/tf_static"),
        tf(at(0), "chassis", "lidar", (0.5, 0, 1, *Q), "/tf_static"),
        tf(at(0), "chassis", "wheel", (0, 0, 0, *Q)),  # moving joints below say nothing of the robot's motion
        tf(at(1), "chassis", "wheel", (0, 0, 0, *TURN_90)),
    ]
    (scan,) = scans(str(write_bag(tmp_path, "bag", odometry_drive("lidar", *mounting))))
    assert scan.T_world_sensor.position.tolist() == [1.5, 0, 2]


def test_a_mounting_that_is_repeated_on_tf_is_a_mounting(tmp_path: Path) -> None:
    """ROS 1's static_transform_publisher; taken for motion, it would put every scan at the same place."""
    mounting = [tf(at(t), "base_link", "lidar", (0.5, 0, 1, *Q)) for t in (0, 0.2, 0.4)]
    (scan,) = scans(str(write_bag(tmp_path, "bag", odometry_drive("lidar", *mounting))))
    assert scan.T_world_sensor.position.tolist() == [1.5, 0, 1]


def test_a_joint_below_the_body_is_no_motion_in_the_world(tmp_path: Path) -> None:
    nodding = [tf(at(t), "base_link", "lidar", (0.5 + t, 0, 1, *Q)) for t in (0, 0.2, 0.4)]
    path = write_bag(tmp_path, "bag", odometry_drive("lidar", *nodding))
    refuses(str(path), "/odom has the pose of 'base_link', and no /tf_static links them")
    assert scans(f"{path}?pose=/tf")[0].T_world_sensor.position[0] == pytest.approx(0.75)


def test_odometry_and_a_mounting_that_nobody_states(tmp_path: Path) -> None:
    path = write_bag(tmp_path, "mcap", odometry_drive("lidar"))
    refuses(str(path), "in frame 'lidar', /odom has the pose of 'base_link'", "say ?T_base_sensor=identity")
    (scan,) = scans(f"{path}?T_base_sensor=identity")
    assert scan.T_world_sensor.position.tolist() == [1, 0, 0]
    (scan,) = scans(f"{path}?T_base_sensor=0,0,3,0,0,0,1")
    assert scan.T_world_sensor.position.tolist() == [1, 0, 3]
    refuses(f"{path}?T_base_sensor=1,2", "?T_base_sensor=1,2 is neither 'identity' nor")
    refuses(f"{path}?T_base_sensor=up", "?T_base_sensor=up is neither 'identity' nor")
    refuses(f"{path}?T_base_sensor=0,0,0,0,0,0,0", "has length 0", error=PoseError)
    refuses(f"{path}?fixed_frame=map&T_base_sensor=identity", "?fixed_frame only counts with tf; /odom has its own")


def test_clouds_in_the_odometrys_world_need_no_pose(tmp_path: Path) -> None:
    (scan,) = scans(str(write_bag(tmp_path, "mcap", odometry_drive("odom"))))
    assert np.array_equal(scan.T_world_sensor.matrix, np.eye(4))


@pytest.mark.parametrize("kind", [POSE, POSE_COVARIANCE])
def test_pose_topics_do_not_say_whose_pose_they_have(tmp_path: Path, kind: str) -> None:
    entries = [
        stamped_pose(at(0), (0, 0, 0, *Q), kind=kind),
        cloud(at(0.25), POINTS),
        stamped_pose(at(0.5), (2, 0, 0, *Q), kind=kind),
    ]
    path = write_bag(tmp_path, "bag", entries)
    refuses(str(path), "/pose has the pose of a frame that its type does not name", "?T_base_sensor=identity")
    (scan,) = scans(f"{path}?T_base_sensor=identity")
    assert scan.T_world_sensor.position.tolist() == [1, 0, 0]


def test_tf_wins_over_odometry_unless_asked(tmp_path: Path) -> None:
    entries = drive(odometry(at(0), (5, 0, 0, *Q)), cloud(at(0.25), POINTS), odometry(at(0.5), (5, 0, 0, *Q)))
    path = write_bag(tmp_path, "mcap", entries)
    assert scans(str(path))[0].T_world_sensor.position.tolist() == [100.25, 0, 2]
    assert scans(f"{path}?pose=/odom")[0].T_world_sensor.position.tolist() == [5, 0, 2]
    assert scans(f"{path}?T_base_sensor=identity")[0].T_world_sensor.position.tolist() == [5, 0, 0]
    refuses(f"{path}?pose=/tf&T_base_sensor=identity", "?T_base_sensor does not count with tf")
    refuses(f"{path}?pose=/points", "?pose=/points is no topic with poses; there is /odom", "/tf_static", "identity")


def test_several_pose_topics_are_listed(tmp_path: Path) -> None:
    second = odometry(at(0), (0, 0, 0, *Q), topic="/wheels")
    path = write_bag(tmp_path, "mcap", odometry_drive("base_link", second))
    refuses(str(path), "several topics have poses (/odom (nav_msgs/msg/Odometry), /wheels", "say which: ?pose=/odom")
    assert len(scans(f"{path}?pose=/odom")) == 1


def test_several_robots_tf_is_ambiguous(tmp_path: Path) -> None:
    first = [moving(e, f"/r1{e[0]}") if e[0].startswith("/tf") else e for e in drive(cloud(at(0.25), POINTS))]
    second = [moving(e, f"/r2{e[0]}") for e in drive()]
    path = write_bag(tmp_path, "mcap", [*first, *second])
    refuses(str(path), "several tf trees", "/r1/tf", "/r2/tf", "say which: ?pose=TOPIC")
    assert scans(f"{path}?pose=/r1/tf")[0].T_world_sensor.position.tolist() == [100.25, 0, 2]


def test_a_topic_that_changes_its_frames_is_refused(tmp_path: Path) -> None:
    entries = odometry_drive("base_link", odometry(at(1), (0, 0, 0, *Q), child="other"))
    refuses(str(write_bag(tmp_path, "mcap", entries)), "/odom changes its frames")


def test_odometry_that_runs_backwards_is_named(tmp_path: Path) -> None:
    entries = [cloud(at(0), POINTS, "base_link"), odometry(at(1), (0, 0, 0, *Q)), odometry(at(0), (0, 0, 0, *Q))]
    path = write_bag(tmp_path, "db3", [*entries[:2], (*entries[2][:2], at(2), entries[2][3])])
    refuses(str(path), "/odom: message 2: stamp", "is not after the one before", error=PoseError)


def test_no_poses_at_all(tmp_path: Path) -> None:
    path = write_bag(tmp_path, "mcap", [cloud(at(0), POINTS)])
    refuses(str(path), "no poses; record /tf and /tf_static", "say ?pose=identity")
    assert np.array_equal(scans(f"{path}?pose=identity")[0].T_world_sensor.matrix, np.eye(4))


def test_a_sensor_that_only_has_fixed_transforms(tmp_path: Path) -> None:
    entries = [tf(at(0), "map", "lidar", (1, 2, 3, *Q), "/tf_static"), cloud(at(0), POINTS)]
    path = write_bag(tmp_path, "mcap", entries)
    refuses(str(path), "/tf_static", "has no moving frame above the clouds'", "stood still, say ?pose=/tf_static")
    assert scans(f"{path}?pose=/tf_static")[0].T_world_sensor.position.tolist() == [1, 2, 3]


def test_a_robot_that_stands_still_is_not_placed_beyond_its_poses(tmp_path: Path) -> None:
    still = [tf(at(t), "map", "lidar", (1, 2, 3, *Q)) for t in (0, 0.5)]
    path = write_bag(tmp_path, "mcap", [*still, *(cloud(at(t), POINTS) for t in (0.1, 0.6))])
    refuses(str(path), "has no moving frame above the clouds'", "stood still, say ?pose=/tf;")
    assert reasons(f"{path}?pose=/tf") == ["no pose within 0.5 s"]


def test_a_cloud_frame_that_tf_does_not_know(tmp_path: Path) -> None:
    path = write_bag(tmp_path, "mcap", drive(cloud(at(0), POINTS, "camera")))
    refuses(f"{path}?pose=/tf", "tf does not have the cloud's frame 'camera', only")


# --- clouds and lasers ---


def test_a_bag_without_clouds_lists_its_topics(tmp_path: Path) -> None:
    path = write_bag(tmp_path, "bag", [text(at(0)), odometry(at(0), (0, 0, 0, *Q))])
    refuses(str(path), "no PointCloud2 or LaserScan", "/odom (nav_msgs/msg/Odometry), /rosout (std_msgs/msg/String)")


def test_the_only_point_cloud_topic_is_taken_before_lasers(tmp_path: Path) -> None:
    path = write_bag(tmp_path, "mcap", drive(cloud(at(0), POINTS), laser(at(0.1), [1, 2], "lidar")))
    assert len(scans(str(path))[0].points) == 12
    assert len(scans(f"{path}?topic=/scan")[0].points) == 2
    refuses(f"{path}?topic=/odom", "?topic=/odom is no topic with clouds; there is /points")


def test_several_cloud_topics_are_listed(tmp_path: Path) -> None:
    second = moving(cloud(at(0), POINTS), "/rear")
    path = write_bag(tmp_path, "mcap", drive(cloud(at(0), POINTS), second))
    refuses(str(path), "several topics with clouds (/points (sensor_msgs/msg/PointCloud2), /rear", "?topic=/points")
    assert len(scans(f"{path}?topic=/rear")) == 1


@pytest.mark.parametrize("kind", KINDS)
def test_laser_scans_keep_only_what_was_seen(tmp_path: Path, kind: str) -> None:
    ranges = [1, 2, 0.4, 11, float("nan"), float("inf"), 4]
    entries = [laser(at(0), ranges), tf(at(0), "map", "laser", (0, 0, 0, *Q)), tf(at(1), "map", "laser", (0, 0, 0, *Q))]
    (scan,) = scans(f"{write_bag(tmp_path, kind, entries)}?pose=/tf&max_gap_s=1")
    assert np.allclose(scan.points, [[1, 0, 0], [0, 2, 0], [-4, 0, 0]], atol=1e-5)
    assert np.allclose(scan.misses, [[0, 10, 0]], atol=1e-5)  # REP 117: nothing up to range_max
    assert np.allclose(scan.no_returns.readings_m, [0.4, 11, np.nan], equal_nan=True)
    assert np.allclose(scan.no_returns.directions, [[-1, 0, 0], [0, -1, 0], [1, 0, 0]], atol=1e-5)


def test_an_all_nan_cloud_is_passed_on(tmp_path: Path) -> None:
    (scan,) = scans(str(write_bag(tmp_path, "mcap", drive(cloud(at(0), np.full((5, 3), np.nan, np.float32))))))
    assert scan.points.shape == (5, 3)
    assert np.isnan(scan.points).all()


def test_an_empty_cloud_is_an_empty_scan(tmp_path: Path) -> None:
    (scan,) = scans(str(write_bag(tmp_path, "mcap", drive(cloud(at(0), np.empty((0, 3), np.float32))))))
    assert scan.points.shape == (0, 3)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("order", ["<", ">"])
def test_any_layout_of_a_cloud(tmp_path: Path, kind: str, order: str) -> None:
    layout = [("intensity", "f4"), ("z", "f8"), ("ring", "u2"), ("x", "f4"), ("y", "f8"), ("t", "u4")]
    records = points_as(layout, POINTS.astype(np.float64), order)
    entry = cloud(at(0), records, height=3, row_padding=5, big_endian=order == ">")
    (scan,) = scans(str(write_bag(tmp_path, kind, drive(entry))))
    assert scan.points.dtype == np.float64
    assert np.array_equal(scan.points, POINTS)


FIELDS = st.permutations([("x", "f4"), ("y", "f4"), ("z", "f4"), ("a", "u1"), ("b", "f8"), ("c", "i2")])


@given(
    FIELDS,
    st.sampled_from("<>"),
    st.integers(1, 4),
    st.integers(0, 5),
    st.integers(0, 9),
    st.sampled_from(["f4", "f8"]),
)
def test_every_layout_equals_the_slow_reading(
    layout: list[tuple[str, str]], order: str, height: int, width: int, padding: int, y_type: str
) -> None:
    layout = [(name, y_type if name == "y" else kind) for name, kind in layout]
    records = points_as(layout, some_points(height * width, width), order)
    big = order == ">"
    *_, make = cloud(0, records, height=height, row_padding=padding, big_endian=big)
    message = make(Maker("mcap"))
    points = cloud_points(message, "here")
    assert points.dtype == (np.float64 if y_type == "f8" and len(records) else np.float32)
    assert np.array_equal(points, slow_points(message).astype(points.dtype))


def slow_points(message: object) -> np.ndarray:
    """PointCloud2 as its definition says: point (row, column) starts at row·row_step + column·point_step."""
    m = types.SimpleNamespace(
        **{name: getattr(message, name) for name in ("height", "width", "row_step", "point_step")}
    )
    order = ">" if message.is_bigendian else "<"  # type: ignore[attr-defined]
    fields = {field.name: field for field in message.fields}  # type: ignore[attr-defined]
    data = bytes(message.data)  # type: ignore[attr-defined]
    rows = []
    for row in range(m.height):
        for column in range(m.width):
            start = row * m.row_step + column * m.point_step
            kinds = [(fields[name].offset, {7: "f4", 8: "f8"}[fields[name].datatype]) for name in "xyz"]
            rows.append([np.frombuffer(data, order + kind, 1, start + offset)[0] for offset, kind in kinds])
    return np.array(rows, np.float64).reshape(-1, 3)


def test_a_cloud_without_xyz_is_refused(tmp_path: Path) -> None:
    records = np.zeros(3, [("x", "f4"), ("range", "f4")])
    path = write_bag(tmp_path, "mcap", drive(cloud(at(0), records)))
    refuses(str(path), f"{path}: /points: message 1: the cloud has no fields x, y, z but x, range")


def test_a_cloud_of_integers_is_refused(tmp_path: Path) -> None:
    records = np.zeros(3, [("x", "f4"), ("y", "i4"), ("z", "f4")])
    refuses(str(write_bag(tmp_path, "mcap", drive(cloud(at(0), records)))), "field y has datatype 5, not float32 (7)")


def test_a_cloud_with_too_few_bytes_is_refused() -> None:
    *_, make = cloud(0, POINTS)
    message = make(Maker("mcap"))
    message.width = 13
    with pytest.raises(LogError, match="144 bytes of data do not hold 1 rows × 13 points of 12 bytes"):
        cloud_points(message, "here")


# --- damage ---


def test_header_stamps_that_run_backwards(tmp_path: Path) -> None:
    clouds = [cloud(at(0.3), POINTS), (*cloud(at(0.1), POINTS)[:2], at(0.4), cloud(at(0.1), POINTS)[3])]
    path = write_bag(tmp_path, "mcap", drive(*clouds))
    refuses(str(path), f"{path}: record 2: its stamp 1700000000.100000000 s runs backwards", "?backwards=drop")
    assert reasons(f"{path}?backwards=drop") == ["stamp runs backwards"]


@pytest.mark.parametrize(
    ("kind", "remedy"), [("bag", "`rosbag reindex`"), ("mcap", "`mcap recover`"), ("db3", "`.recover`")]
)
@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 0.9, 0.999])
def test_truncated_bags_name_the_file_and_the_remedy(tmp_path: Path, kind: str, remedy: str, share: float) -> None:
    many = [cloud(at(0.001 * i), some_points(2000, i)) for i in range(100)]
    path = write_bag(tmp_path, kind, drive(*many))
    whole = path if kind == "bag" else path / f"{path.name}.{kind}"
    cut = tmp_path / f"cut.{kind}"
    cut.write_bytes(whole.read_bytes()[: int(whole.stat().st_size * share)])
    message = refuses(str(cut), str(cut), error=LogError)
    assert remedy in message


def test_a_damaged_message_is_named(tmp_path: Path) -> None:
    many = [cloud(at(0.001 * i), some_points(2000, i)) for i in range(100)]
    path = write_bag(tmp_path, "bag", drive(*many))
    data = bytearray(path.read_bytes())
    middle = data.index(b"lidar", len(data) // 2)  # the frame's name: its length stands before it
    data[middle - 4 : middle] = b"\xff\xff\xff\x7f"
    path.write_bytes(data)
    refuses(str(path), f"{path}: /points: message", "truncated or damaged", "`rosbag reindex`", error=LogError)


def test_not_a_bag_at_all(tmp_path: Path) -> None:
    path = tmp_path / "x.bag"
    path.write_text("hello")
    refuses(str(path), f"{path}: can't be opened as a ROS bag (File magic is invalid.)", error=LogError)


def test_a_broken_metadata_yaml(tmp_path: Path) -> None:
    path = write_bag(tmp_path, "mcap", drive(cloud(at(0), POINTS)))
    (path / "metadata.yaml").write_text("nothing: here")
    refuses(str(path), f"{path}: can't be opened as a ROS bag", "`ros2 bag reindex`", error=LogError)


def test_clouds_are_streamed_not_collected(tmp_path: Path) -> None:
    path = write_bag(tmp_path, "mcap", drive(*[cloud(at(0.01 * i), POINTS) for i in range(50)]))
    records = open_log(str(path)).scans()
    first = next(records)
    assert isinstance(first, Scan)
    records.close()  # type: ignore[attr-defined]
    assert len(read(str(path))) == 50
