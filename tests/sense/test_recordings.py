"""Presets on the recordings that they describe."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from terrafuse.logs import Source, open_log
from terrafuse.sense import applied, load_sensor, scan_of, undescribed
from terrafuse.types import Array, Pose, Scan


def scans(text: str, count: int) -> list[Scan]:
    found: list[Scan] = []
    for record in open_log(text).scans():
        assert isinstance(record, Scan)
        found.append(record)
        if len(found) == count:
            break
    return found


@pytest.fixture(scope="module")
def sonar_rows(recordings: Path) -> Array:
    path = recordings / "sonar" / "scitos_g5_24sonar" / "sensor_readings_24.data"
    return np.loadtxt(path, delimiter=",", skiprows=1, usecols=range(24))


def test_the_scitos_ring(sonar_rows: Array) -> None:
    """5456 rows of 24. 13.8 % are saturated: those are misses, all others are points, and nothing else happens."""
    sensor = load_sensor("scitos_g5_sonar")
    seen = [scan_of(sensor, row, 0, Pose.identity()) for row in sonar_rows]
    assert len(seen) == 5456
    points = np.concatenate([scan.points for scan in seen])
    misses = np.concatenate([scan.misses for scan in seen])
    assert len(points) + len(misses) == 5456 * 24
    assert len(misses) / (5456 * 24) == pytest.approx(0.138, abs=0.0005)
    assert not any(scan.dropped for scan in seen)
    assert np.allclose(np.linalg.norm(misses, axis=1), 5.3)  # 0.3 m of the ring and 5 m
    distances = np.linalg.norm(points, axis=1)
    assert distances.min() == pytest.approx(0.3 + 0.34)
    assert distances.max() < 5.3
    assert (points[:, 2] == 0).all()


def test_the_scitos_first_row(sonar_rows: Array) -> None:
    """Sensor 1, 0.438 m: ahead, at 0.738. Sensor 7, 90° clockwise, is silent: 5.3 m to the right. Sensor 13, 1.698 m:
    behind, at -1.998. Sensor 19, 0.504 m: to the left, at 0.804."""
    scan = scan_of(load_sensor("scitos_g5_sonar"), sonar_rows[0], 0, Pose.identity())
    assert len(scan.points) == 22  # sensors 5 and 7 are silent
    assert np.allclose(scan.points[[0, 10, 16]], [[0.738, 0, 0], [-1.998, 0, 0], [0, 0.804, 0]])
    assert np.allclose(scan.misses[1], [0, -5.3, 0])
    assert np.allclose(scan.origins[-1], [0, -0.3, 0])


def test_the_scitos_follows_its_wall_on_the_left(sonar_rows: Array) -> None:
    """It drove clockwise along the walls of a room, so these were on its left: the nearest echo comes from there."""
    sensor = load_sensor("scitos_g5_sonar")
    near = [scan_of(sensor, row, 0, Pose.identity()).points for row in sonar_rows[::10]]
    nearest = np.array([points[np.argmin(np.linalg.norm(points, axis=1))] for points in near])
    assert (nearest[:, 1] > 0).mean() > 0.9


def test_the_scitos_ring_from_a_table(sonar_rows: Array, tmp_path: Path) -> None:
    """Its readings as a log; the poses are made up, as the recording has none."""
    path = tmp_path / "scitos.csv"
    header = "stamp_s,x_m,y_m,yaw_rad," + ",".join(f"r{k}_m" for k in range(24))
    rows = [f"{k / 9:.9f},{k / 100},0,0," + ",".join(map(str, row)) for k, row in enumerate(sonar_rows[:200])]
    path.write_text("\n".join([header, *rows]))
    sensor = load_sensor("scitos_g5_sonar")
    for row, scan in zip(sonar_rows, open_log(Source(path, aimed=True)).scans(), strict=False):
        assert isinstance(scan, Scan)
        out, direct = applied(sensor, scan), scan_of(sensor, row, 0, scan.T_world_sensor)
        assert np.array_equal(out.points, direct.points)
        assert np.array_equal(out.misses, direct.misses)
        assert len(out.points) + len(out.misses) == 24


@pytest.mark.parametrize(
    ("log", "preset"),
    [
        ("radish_raw/intel.clf.bz2", "sick_lms_180"),
        ("radish_raw/fr079.clf.bz2", "sick_lms_360"),
        ("ple_corrected/intel-corrected.log.gz", "sick_lms_180"),
        ("ple_corrected/edmonton-corrected.log.gz", "sick_lms_180"),
        ("ple_corrected/csail-corrected.log.gz", "sick_lms_361"),
        ("ple_corrected/freiburg-101-corrected.log.gz", "sick_lms_360"),
    ],
)
def test_carmen_logs_give_the_same_points(recordings: Path, log: str, preset: str) -> None:
    sensor = load_sensor(preset)
    count = sensor.beams.count
    dropped = 0
    for scan in scans(f"{recordings / 'lidar2d' / log}?stamps=index&rate_hz=5", 200):
        out = applied(sensor, scan)
        np.testing.assert_allclose(out.points, scan.points, rtol=0, atol=1e-13)  # by the preset's angles
        assert np.array_equal(out.T_world_sensor.matrix, scan.T_world_sensor.matrix)
        assert out.dropped == undescribed(scan).dropped
        assert len(out.points) + out.dropped.get("no return", 0) == count
        dropped += count - len(out.points)
    assert dropped > 0


def test_a_carmen_log_where_silence_clears(recordings: Path, tmp_path: Path) -> None:
    """The same log with a description that says so: every silent beam is a miss of 30 m."""
    path = tmp_path / "clear.yaml"
    path.write_text("name: clear\nmax_range_m: 30\nno_return: clear\nring: {count: 180, first_deg: -90, step_deg: 1}\n")
    sensor = load_sensor(path)
    for scan in scans(f"{recordings / 'lidar2d/ple_corrected/intel-corrected.log.gz'}?stamps=index&rate_hz=5", 50):
        out = applied(sensor, scan)
        assert len(out.points) + len(out.misses) == 180
        assert np.allclose(np.linalg.norm(out.misses, axis=1), 30)
        assert not out.dropped


def test_the_codes_of_loop5(recordings: Path) -> None:
    """Codes of 8.183, 8.187 and 8.191 m are 6.7 % of its readings: 6726 of 99731; the longest return is 8.178 m."""
    sensor = load_sensor("sick_lms_181_8m")
    lines = (recordings / "lidar2d" / "dpslam_loop5" / "loop5.log").read_text().splitlines()
    rows = [np.array(line.split()[2:183], float) for line in lines if line.startswith("Laser 181")]
    seen = [scan_of(sensor, row, 0, Pose.identity()) for row in rows]
    assert len(seen) == 551
    points = np.concatenate([scan.points for scan in seen])
    assert sum(scan.dropped["no return"] for scan in seen) == 6726
    assert len(points) == 99731 - 6726
    assert np.linalg.norm(points, axis=1).max() == pytest.approx(8.178, abs=1e-5)


def test_kitti_points_stay(recordings: Path) -> None:
    folder = recordings / "lidar3d" / "patchworkpp_kitti"
    (scan,) = scans(f"{folder}?poses=poses_velo_first6.txt&calib=identity", 1)
    out = applied(load_sensor("velodyne_hdl_64e"), scan)
    assert np.shares_memory(out.points, scan.points)
    assert len(out.points) == len(scan.points)
    assert out.origins is None


def test_av2_points_stay_and_know_where_their_beams_start(recordings: Path) -> None:
    pytest.importorskip("pyarrow")
    folder = recordings / "lidar3d" / "av2" / "7fab2350-7eaf-3b7e-a39d-6937a4c1bede"
    (scan,) = scans(str(folder), 1)
    out = applied(load_sensor("av2_lidars"), scan)
    assert np.shares_memory(out.points, scan.points)
    assert len(out.points) == len(scan.points)
    assert out.origins.shape == scan.points.shape
    assert np.allclose(out.origins[0], [1.349, 0.002, 1.583])
