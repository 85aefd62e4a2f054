from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from terrafuse.errors import PoseError
from terrafuse.logs.stamps import natural_order, seconds_to_ns, stamp_of_name
from terrafuse.logs.trajectory import (
    NoPose,
    Trajectory,
    in_world,
    placed,
    quaternion_of,
    read_tum,
    slerp,
    trajectory,
)
from terrafuse.types import Pose, Scan, Skipped

from .support import NS, write_tum

GAP = 2**62
coordinate = st.floats(-1e4, 1e4)
positions = st.tuples(coordinate, coordinate, coordinate)
quaternions = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1)


def unit(quaternion: tuple[float, ...]) -> np.ndarray:
    return np.array(quaternion) / np.linalg.norm(quaternion)


@st.composite
def trajectories(draw: st.DrawFn) -> Trajectory:
    stamps = sorted(draw(st.sets(st.integers(0, 2 * 10**18), min_size=2, max_size=6)))
    places = [draw(positions) for _ in stamps]
    turns = [unit(draw(quaternions)) for _ in stamps]
    return trajectory(stamps, places, turns, str)


def between(start: int, end: int, part: float) -> int:
    return min(end, start + int((end - start) * part))


def close(a: Pose, b: Pose, tolerance: float = 1e-9) -> bool:
    return bool(np.allclose(a.matrix, b.matrix, atol=tolerance, rtol=1e-9))


@given(trajectories())
def test_at_a_stamp_it_is_the_pose_given(poses: Trajectory) -> None:
    for i, stamp in enumerate(poses.stamps_ns.tolist()):
        assert close(poses.at(stamp, 0), Pose.from_quaternion(poses.positions[i], poses.quaternions[i]))


@given(trajectories(), st.floats(0, 1))
def test_between_two_poses_it_stays_rigid_and_on_the_chord(poses: Trajectory, part: float) -> None:
    start, end = poses.stamps_ns[:2].tolist()
    middle = poses.at(between(start, end, part), GAP)
    assert np.allclose(middle.matrix[:3, :3].T @ middle.matrix[:3, :3], np.eye(3), atol=1e-9)
    chord = np.linalg.norm(poses.positions[1] - poses.positions[0])
    there = np.linalg.norm(middle.position - poses.positions[0])
    back = np.linalg.norm(middle.position - poses.positions[1])
    assert there + back == pytest.approx(chord, abs=1e-6)


@given(trajectories(), positions, quaternions, st.floats(0, 1))
def test_moving_the_world_moves_what_is_interpolated(
    poses: Trajectory, shift: tuple[float, ...], turn: tuple[float, ...], part: float
) -> None:
    T_new_world = Pose.from_quaternion(shift, turn)
    # a half turn between neighbours has two shortest arcs, and rounding chooses
    assume(all(abs(a @ b) > 1e-3 for a, b in pairwise(poses.quaternions)))
    all_poses = [T_new_world @ poses.at(stamp, 0) for stamp in poses.stamps_ns.tolist()]
    moved = trajectory(poses.stamps_ns, [p.position for p in all_poses], [quaternion_of(p) for p in all_poses], str)
    start, end = poses.stamps_ns[:2].tolist()
    stamp = between(start, end, part)
    assert close(moved.at(stamp, GAP), T_new_world @ poses.at(stamp, GAP), 1e-6)


@given(trajectories(), st.lists(st.sampled_from([-1, 1]), min_size=6, max_size=6), st.floats(0, 1))
def test_the_sign_of_a_quaternion_does_not_matter(poses: Trajectory, signs: list[int], part: float) -> None:
    assume(all(abs(a @ b) > 1e-3 for a, b in pairwise(poses.quaternions)))
    flipped = poses.quaternions * np.array(signs[: len(poses.stamps_ns)])[:, None]
    other = trajectory(poses.stamps_ns, poses.positions, flipped, str)
    start, end = poses.stamps_ns[:2].tolist()
    stamp = between(start, end, part)
    assert close(other.at(stamp, GAP), poses.at(stamp, GAP))


@given(st.floats(-3.1, 3.1), st.floats(0, 1))
def test_a_steady_turn_is_met_exactly(angle: float, part: float) -> None:
    start, end = np.array([0, 0, 0, 1.0]), np.array([0, 0, np.sin(angle / 2), np.cos(angle / 2)])
    expected = [0, 0, np.sin(part * angle / 2), np.cos(part * angle / 2)]
    assert np.allclose(slerp(start, end, part), expected, atol=1e-9)


@given(quaternions)
def test_quaternion_of_undoes_from_quaternion(quaternion: tuple[float, ...]) -> None:
    back = quaternion_of(Pose.from_quaternion((1, 2, 3), quaternion))
    assert abs(back @ unit(quaternion)) == pytest.approx(1, abs=1e-12)
    assert np.linalg.norm(back) == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize("stamp", [-1, 4 * NS, 2 * NS])
def test_no_pose_outside_nor_in_a_gap(stamp: int) -> None:
    poses = trajectory([0, NS, 3 * NS], np.zeros((3, 3)), [[0, 0, 0, 1]] * 3, str)
    with pytest.raises(NoPose, match=r"^no pose within 0\.5 s$"):
        poses.at(stamp, NS // 2)


def test_a_gap_of_exactly_the_limit_is_bridged() -> None:
    poses = trajectory([0, NS], [[0, 0, 0], [4, 0, 0]], [[0, 0, 0, 1]] * 2, str)
    assert poses.at(NS // 4, NS).position.tolist() == [1, 0, 0]


def test_placed_reads_no_points_where_there_is_no_pose() -> None:
    poses = trajectory([0], [[0, 0, 0]], [[0, 0, 0, 1]], str)

    def fail() -> np.ndarray:
        raise AssertionError("read")

    assert placed(5, lambda at: poses.at(at, NS), fail) == Skipped(5, "no pose within 1 s")
    assert isinstance(placed(5, in_world, lambda: np.zeros((0, 3))), Scan)


def test_tum_round_trip_is_exact_to_the_nanosecond(tmp_path: Path) -> None:
    path = write_tum(tmp_path / "a.tum", [("1305031102.175304123", (1, 2, 3)), ("1305031102.2", (1, 2, 4))])
    poses = read_tum(path)
    assert poses.stamps_ns.tolist() == [1305031102175304123, 1305031102200000000]
    assert poses.positions.tolist() == [[1, 2, 3], [1, 2, 4]]


@pytest.mark.parametrize(
    ("line", "parts"),
    [
        ("1.0 0 0 0 0 0 0", ":3: 7 numbers; a line reads `stamp tx ty tz qx qy qz qw`"),
        ("1.0 0 0 nan 0 0 0 1", ":3: the pose holds NaN or infinity"),
        ("1.0 0 0 0 0 0 0 nan", ":3: the pose holds NaN or infinity"),
        ("1.0 0 0 0 0 0 0 2", ":3: quaternion [0.0, 0.0, 0.0, 2.0] has length 2, not 1"),
        ("1.0 0 0 0 0 0 0 0", ":3: quaternion [0.0, 0.0, 0.0, 0.0] has length 0, not 1"),
        ("0.5 0 0 0 0 0 0 1", ":3: stamp 0.500000000 s is not after the one before, 0.500000000 s"),
        ("0.4 0 0 0 0 0 0 1", ":3: stamp 0.400000000 s is not after"),
        ("now 0 0 0 0 0 0 1", ":3: 'now' is not a number of seconds"),
        ("nan 0 0 0 0 0 0 1", ":3: 'nan' is not a number of seconds"),
        ("1.0 0 x 0 0 0 0 1", ":3: could not convert string to float: 'x'"),
    ],
)
def test_a_bad_row_is_named_with_file_and_line(tmp_path: Path, line: str, parts: str) -> None:
    path = tmp_path / "poses.tum"
    path.write_text(f"# header\n0.5 0 0 0 0 0 0 1\n{line}\n")
    with pytest.raises(PoseError) as caught:
        read_tum(path)
    assert f"{path}{parts}" in str(caught.value)


def test_an_empty_trajectory_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "poses.tum"
    path.write_text("# nothing\n\n")
    with pytest.raises(PoseError, match="holds no pose"):
        read_tum(path)


def test_a_quaternion_printed_with_two_digits_passes() -> None:
    poses = trajectory([0], [[0, 0, 0]], [[0, 0, 0.71, 0.71]], str)
    assert np.allclose(poses.at(0, 0).matrix[:2, :2], [[0, -1], [1, 0]])


@given(st.integers(0, 2 * 10**18))
def test_seconds_are_read_exactly(stamp: int) -> None:
    assert seconds_to_ns(f"{stamp // NS}.{stamp % NS:09d}") == stamp


@pytest.mark.parametrize(
    ("stem", "stamp"),
    [
        ("1305031102.175304", 1305031102175304000),
        ("1305031102", 1305031102 * NS),
        ("315966265259836000", 315966265259836000),
        ("000012", None),
        ("1305031102175", None),
        ("scan_3", None),
    ],
)
def test_stamps_of_names(stem: str, stamp: int | None) -> None:
    assert stamp_of_name(stem) == stamp


def test_numbers_in_names_sort_as_numbers() -> None:
    names = ["scan_10.pcd", "scan_2.pcd", "scan_1.pcd", "a.pcd"]
    ordered = sorted(map(Path, names), key=natural_order)
    assert [path.name for path in ordered] == ["a.pcd", "scan_1.pcd", "scan_2.pcd", "scan_10.pcd"]
