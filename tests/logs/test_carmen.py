from __future__ import annotations

import bz2
import gzip
from pathlib import Path

import numpy as np
import pytest

from terrafuse.errors import LogError, PoseError
from terrafuse.logs import open_log
from terrafuse.logs.base import parse_source
from terrafuse.logs.carmen import flaser_angles
from terrafuse.types import Skipped

from .support import NS, pose, read, refuses, scans


def flaser(stamp: str, ranges: list[object], x: object = 1.0, y: object = 2.0, theta: object = 0.5) -> str:
    return f"FLASER {len(ranges)} {' '.join(map(str, ranges))} {x} {y} {theta} 9 9 9 {stamp} host 0.5"


def robotlaser(stamp: str, ranges: list[object], max_range: float = 20.0, remissions: int = 0) -> str:
    extra = " ".join(["0.1"] * remissions)
    return (
        f"ROBOTLASER1 0 -1.0 2.0 0.5 {max_range} 0.01 0 {len(ranges)} {' '.join(map(str, ranges))} "
        f"{remissions} {extra} 1 2 0.5 9 9 9 0 0 0.1 0.1 1e6 {stamp} host 0.5"
    )


def write(folder: Path, *lines: str, name: str = "a.log") -> Path:
    path = folder / name
    text = "\n".join(["# CARMEN Logfile", "PARAM robot_frontlaser_offset 0.0 host 0", *lines, ""])
    opener = {".gz": gzip.open, ".bz2": bz2.open}.get(path.suffix, open)
    with opener(path, "wt") as file:
        file.write(text)
    return path


@pytest.mark.parametrize("name", ["a.log", "a.clf", "a.log.gz", "a.clf.bz2"])
def test_flaser(tmp_path: Path, name: str) -> None:
    ranges = [3.0] * 180
    path = write(tmp_path, "ODOM 0 0 0 0 0 0 1 host 1", flaser("976052857.33753", ranges), name=name)
    log = open_log(str(path))
    assert (log.reader, log.count) == ("carmen", 1)
    (scan,) = scans(str(path))
    assert scan.stamp_ns == 976052857337530000  # a float would be off by 60 ns
    assert np.allclose(scan.T_world_sensor.matrix, pose(1, 2, 0, yaw=0.5).matrix)
    assert np.allclose(scan.points[[0, 90]], [[0, -3, 0], [3, 0, 0]], atol=1e-12)
    assert np.allclose(np.linalg.norm(scan.points, axis=1), 3)


@pytest.mark.parametrize(("beams", "last"), [(180, 89), (181, 90), (360, 89.5), (361, 90)])
def test_beams_go_from_right_to_left(beams: int, last: float) -> None:
    angles = np.rad2deg(flaser_angles(beams, "here", None))
    assert angles[[0, -1]].tolist() == pytest.approx([-90, last])
    assert np.allclose(np.diff(angles), 0.5 if beams > 200 else 1)


def test_another_number_of_beams_needs_the_field_of_view(tmp_path: Path) -> None:
    path = write(tmp_path, flaser("1", [1.0, 2.0, 3.0]))
    refuses(str(path), f"{path}:3: 3 beams, and an FLASER line does not state", "180, 181, 360, 361", "?fov_deg=")
    (scan,) = scans(f"{path}?fov_deg=180")
    assert np.allclose(scan.points, [[0, -1, 0], [2, 0, 0], [0, 3, 0]], atol=1e-12)


def test_described_beams_need_no_field_of_view(tmp_path: Path) -> None:
    """Readings are there; whose angles are known from a table is not stated, a field of view that is given is."""
    path = write(tmp_path, flaser("1", [1.0, 81.83, 3.0]))
    (scan,) = open_log(parse_source(str(path), aimed=True)).scans()
    assert scan.readings.ranges_m.tolist() == [1.0, 81.83, 3.0]
    assert scan.readings.returned.tolist() == [True, False, True]
    assert (scan.readings.directions, len(scan.points)) == (None, 0)
    (scan,) = open_log(parse_source(f"{path}?fov_deg=180", aimed=True)).scans()
    assert np.allclose(scan.readings.directions, [[0, -1, 0], [1, 0, 0], [0, 1, 0]], atol=1e-12)
    (scan,) = scans(str(write(tmp_path, flaser("1", [1.0] * 180))))
    assert scan.readings.directions is None
    (scan,) = scans(str(write(tmp_path, robotlaser("1", [1.0, 20.0]))))
    assert np.allclose(scan.readings.directions[1], [np.cos(-0.5), np.sin(-0.5), 0])
    assert scan.readings.returned.tolist() == [True, False]


def test_no_return_is_left_out(tmp_path: Path) -> None:
    ranges: list[object] = [1.0] * 180
    ranges[:8] = [0, "nan", 50, 51.16, 81.83, 81.91, "inf", -1]
    ranges[8] = 49.99
    path = write(tmp_path, flaser("1", ranges))
    assert len(scans(str(path))[0].points) == 172
    assert len(scans(f"{path}?max_range_m=20")[0].points) == 171
    assert len(scans(f"{path}?max_range_m=80")[0].points) == 174
    refuses(f"{path}?max_range_m=0", "?max_range_m=0 is not a positive number")


def test_beams_without_return_keep_their_direction_and_reading(tmp_path: Path) -> None:
    """Beams 0 (to the right, -y), 45 and 90 (ahead) of 180; cos 45° = 0.707107."""
    ranges: list[object] = [1.0] * 180
    ranges[0], ranges[45], ranges[90] = 81.83, "nan", 0
    (scan,) = scans(str(write(tmp_path, flaser("1", ranges))))
    silent = scan.no_returns
    assert np.allclose(silent.directions, [[0, -1, 0], [0.707107, -0.707107, 0], [1, 0, 0]], atol=1e-6)
    assert np.array_equal(silent.readings_m, [81.83, np.nan, 0], equal_nan=True)
    assert scan.misses is None  # the log does not say that they are empty space


@pytest.mark.parametrize("remissions", [0, 4])
def test_robotlaser_states_its_angles_and_limit(tmp_path: Path, remissions: int) -> None:
    path = write(tmp_path, robotlaser("7.5", [1.0, 2.0, 20.0, 4.0], remissions=remissions))
    (scan,) = scans(str(path))
    assert scan.stamp_ns == 7_500_000_000
    angles = np.array([-1, -0.5, 0.5])
    expected = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1) * [[1], [2], [4]]
    assert np.allclose(scan.points, expected)
    assert scan.no_returns.readings_m.tolist() == [20.0]
    assert np.allclose(scan.T_world_sensor.matrix, pose(1, 2, 0, yaw=0.5).matrix)


def test_both_messages_at_once_need_a_choice(tmp_path: Path) -> None:
    path = write(tmp_path, flaser("1", [1.0] * 180), robotlaser("1", [1.0, 2.0]))
    refuses(str(path), "holds both FLASER and ROBOTLASER1", "?message=FLASER")
    assert len(scans(f"{path}?message=ROBOTLASER1")[0].points) == 2
    assert len(scans(f"{path}?message=FLASER")[0].points) == 180
    refuses(f"{path}?message=RLASER", "?message=RLASER is not one of FLASER, ROBOTLASER1")


def test_a_log_without_scans(tmp_path: Path) -> None:
    refuses(str(write(tmp_path, "ODOM 0 0 0 0 0 0 1 host 1")), "no FLASER or ROBOTLASER1 line", error=LogError)


def test_a_clock_that_stands_still(tmp_path: Path) -> None:
    path = write(tmp_path, *[flaser("1.13486e+09", [1.0] * 180)] * 5)
    refuses(str(path), "the clock stands still, 1 different stamps in 5 scans", "?stamps=index&rate_hz=5")
    assert [scan.stamp_ns for scan in scans(f"{path}?stamps=index&rate_hz=5")] == [i * NS // 5 for i in range(5)]
    refuses(f"{path}?stamps=index", "?stamps=index needs the scans a second")
    refuses(f"{path}?rate_hz=5", "?rate_hz only counts with ?stamps=index")
    refuses(f"{path}?stamps=no", "?stamps=no is not one of log, index")


def test_a_clock_that_runs_backwards(tmp_path: Path) -> None:
    path = write(tmp_path, *(flaser(stamp, [1.0] * 180) for stamp in ("1", "3", "2", "4")))
    refuses(str(path), f"{path}: record 3: its stamp 2.000000000 s", "?backwards=drop", "?stamps=index&rate_hz=5")
    records = read(f"{path}?backwards=drop")
    assert [isinstance(record, Skipped) for record in records] == [False, False, True, False]
    assert len(scans(f"{path}?stamps=index&rate_hz=5")) == 4


@pytest.mark.parametrize(
    ("line", "why"),
    [
        (flaser("1", [1.0] * 180).rsplit(maxsplit=4)[0] + " 1 host 0", ":4: not a whole FLASER line"),
        (flaser("soon", [1.0] * 180), ":4: not a whole scan line (its stamp: 'soon' is not a number"),
        (flaser("1", ["x"] * 180), ":4: not a whole FLASER line"),
        ("FLASER x 1 1 1", ":4: not a whole"),
        ("FLASER 180", ":4: not a whole"),
    ],
)
def test_a_broken_line_is_named(tmp_path: Path, line: str, why: str) -> None:
    path = write(tmp_path, flaser("1", [1.0] * 180), line)
    refuses(str(path), f"{path}{why}", error=LogError)


def test_a_pose_that_is_not_finite(tmp_path: Path) -> None:
    path = write(tmp_path, flaser("1", [1.0] * 180, x="nan"))
    refuses(str(path), f"{path}:3: the laser's pose [nan, 2.0, 0.5] is not finite", error=PoseError)


@pytest.mark.parametrize("name", ["a.log.gz", "a.log.bz2"])
def test_a_cut_archive(tmp_path: Path, name: str) -> None:
    rng = np.random.default_rng(0)
    lines = [flaser(str(i), [*rng.uniform(1, 9, 180)]) for i in range(200)]
    path = write(tmp_path, *lines, name=name)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    refuses(str(path), f"{path}: can't be opened as carmen: truncated or damaged", error=LogError)


def test_other_logs_are_not_carmens(tmp_path: Path) -> None:
    (tmp_path / "a.log").write_text("2024-01-01 INFO started\n")
    (tmp_path / "b.log.gz").write_bytes(b"not gzip")
    for name in ("a.log", "b.log.gz"):
        refuses(str(tmp_path / name), "not a recording of a known format", error=LogError)
