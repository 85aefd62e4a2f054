"""KITTI odometry: velodyne/*.bin, poses of 3×4 rows, calib.txt, times.txt.

KITTI's poses are of the left camera (x right, y down, z forward) in the first camera's frame. The world here
is the first lidar frame, which has z up: T_world_velo = Tr⁻¹ · T_cam0_cam · Tr, where Tr takes lidar points
to the camera.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from terrafuse.errors import LogError, PoseError
from terrafuse.logs.base import Log, Reader, Record, Source
from terrafuse.logs.options import NS, file_option, listed, positive
from terrafuse.logs.rows import Row, rows
from terrafuse.logs.stamps import natural_order, seconds_to_ns
from terrafuse.types import Array, Pose, Scan, Stamp, checked_pose

POINT_BYTES = 16  # float32 x y z intensity
CALIBRATION_ROWS = ("Tr:", "Tr_velo_cam:", "Tr_velo_to_cam:", "Tr_velo_cam", "Tr_velo_to_cam", "Tr")


@dataclass(frozen=True)
class Frame:
    path: Path
    stamp_ns: Stamp
    T_world_velo: Pose


def matches(path: Path) -> bool:
    if not path.is_dir():
        return False
    return bool(list(islice(path.glob("velodyne/*.bin"), 1))) or (bool(_scans_in(path)) and bool(_pose_files(path)))


def open_kitti(source: Source) -> Log:
    frames = _frames(source)
    return Log(source.path, READER.name, scans=lambda: _read(frames), count=len(frames))


def _read(frames: list[Frame]) -> Iterator[Record]:
    for frame in frames:
        yield Scan(frame.stamp_ns, read_velodyne(frame.path), frame.T_world_velo)


def read_velodyne(path: Path) -> Array:
    """(N, 3) float32, metres, x forward, y left, z up."""
    return np.ascontiguousarray(np.fromfile(path, "<f4").reshape(-1, 4)[:, :3])


def _frames(source: Source) -> list[Frame]:
    folder = source.path
    scans = _scans_in(folder / "velodyne") or _scans_in(folder)
    if not scans:
        raise LogError(f"{folder}: no *.bin here, nor in velodyne/; give the folder of a KITTI sequence")
    for scan in scans:
        if scan.stat().st_size % POINT_BYTES:
            raise LogError(
                f"{scan}: {scan.stat().st_size} bytes are no whole number of points of {POINT_BYTES} bytes "
                "(float32 x y z intensity); truncated, or not KITTI's: then say ?reader=clouds&columns=N"
            )
    poses_file = _poses_file(source)
    T_world_velo = _lidar_poses(read_poses(poses_file), _calibration(source))
    places = _rows_of(scans, len(T_world_velo), poses_file)
    stamps = _stamps(source, places)
    return [Frame(s, t, T_world_velo[i]) for s, t, i in zip(scans, stamps, places, strict=True)]


def _scans_in(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.bin"), key=natural_order)


def _rows_of(scans: list[Path], count: int, poses_file: Path) -> list[int]:
    """Which pose row each scan has: KITTI numbers the files by row, so a subset keeps its rows."""
    if len(scans) > count:
        raise LogError(f"{poses_file}: {count} poses for {len(scans)} scans; remove those without, or give ?poses=FILE")
    stems = [scan.stem for scan in scans]
    if all(stem.isdigit() for stem in stems) and int(stems[-1]) < count:
        return [int(stem) for stem in stems]
    if len(scans) == count:
        return list(range(count))
    raise LogError(
        f"{poses_file}: {count} poses for {len(scans)} scans {stems[0]} … {stems[-1]}, "
        "whose names are not row numbers; give a file with one pose a scan"
    )


def _pose_files(folder: Path) -> list[Path]:
    return [path for path in sorted(folder.glob("*.txt")) if _all_rows_have_12(path)]


def _all_rows_have_12(path: Path) -> bool:
    widths = {len(row.words) if _numeric(row) else 0 for row in rows(path)}
    return widths == {12}


def _numeric(row: Row) -> bool:
    try:
        row.numbers()
    except LogError:
        return False
    return True


def _poses_file(source: Source) -> Path:
    given = file_option(source, "poses")
    if given is not None:
        return given
    if (source.path / "poses.txt").is_file():
        return source.path / "poses.txt"
    found = _pose_files(source.path)
    if not found:
        raise LogError(f"{source.path}: no poses.txt; give ?poses=FILE with a row of 12 numbers (3×4) a scan")
    if len(found) > 1:
        names = listed(path.name for path in found)
        raise LogError(f"{source.path}: several files could be the poses ({names}); say which: ?poses={found[0].name}")
    return found[0]


def read_poses(path: Path) -> list[Pose]:
    """KITTI's 3×4 rows. Raises LogError naming file:line for another width, NaN, or a matrix not rigid."""
    return [_matrix(row, row.words) for row in rows(path)]


def _matrix(row: Row, words: list[str]) -> Pose:
    if len(words) != 12:
        raise LogError(f"{row.place}: {len(words)} numbers, not the 12 of a 3×4 pose")
    try:
        return checked_pose(np.reshape(Row(row.place, words).numbers(), (3, 4)), row.place)
    except PoseError as error:
        raise LogError(str(error)) from None


def _calibration(source: Source) -> Pose:
    if source.options.get("calib") == "identity":
        return Pose.identity()
    path = file_option(source, "calib") or source.path / "calib.txt"
    if not path.is_file():
        raise LogError(
            f"{source.path}: no calib.txt with a 'Tr:' row to bring the camera's poses to the lidar; "
            "give ?calib=FILE, or ?calib=identity if the poses are the lidar's own"
        )
    for row in rows(path):
        if row.words[0] in CALIBRATION_ROWS:
            return _matrix(row, [word for word in row.words[1:] if word != ":"])
    raise LogError(f"{path}: no row 'Tr:' or 'Tr_velo_cam:'; give ?calib=FILE with one, or ?calib=identity")


def _lidar_poses(T_cam0_cam: list[Pose], Tr: Pose) -> list[Pose]:
    Tr_inverse = Tr.inverse()
    return [Tr_inverse @ pose @ Tr for pose in T_cam0_cam]


def _stamps(source: Source, places: list[int]) -> list[Stamp]:
    path = source.path / "times.txt"
    if not path.is_file():
        period = NS / positive(source, "rate_hz", 10.0)
        return [round(place * period) for place in places]
    if "rate_hz" in source.options:
        raise LogError(f"{path}: the recording has times; leave out ?rate_hz")
    found = list(rows(path))
    if len(found) <= max(places):
        raise LogError(f"{path}: {len(found)} times, but scan {max(places)}, counted from 0, needs one; complete it")
    return [_time(found[place]) for place in places]


def _time(row: Row) -> Stamp:
    try:
        return seconds_to_ns(row.words[0])
    except ValueError as error:
        raise LogError(f"{row.place}: {error}") from None


READER = Reader(
    name="kitti",
    summary="KITTI odometry folder: velodyne/*.bin (or *.bin), poses.txt, calib.txt, times.txt",
    matches=matches,
    open=open_kitti,
    options={
        "poses": "file of 3×4 pose rows, relative to the folder or absolute (default: poses.txt)",
        "calib": "file with a 'Tr:' row (default: calib.txt), or 'identity' if the poses are the lidar's own",
        "rate_hz": "scans a second where there is no times.txt (default 10)",
    },
)
