"""Argoverse 2 sensor logs: sensors/lidar/<stamp_ns>.feather, in the ego frame at that stamp."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from terrafuse.errors import LogError
from terrafuse.logs.base import Log, Reader, Record, Source
from terrafuse.logs.libraries import library
from terrafuse.logs.options import MAX_GAP_HELP, listed, max_gap_ns
from terrafuse.logs.trajectory import Trajectory, placed, trajectory
from terrafuse.types import Array

POSES = "city_SE3_egovehicle.feather"
POSE_COLUMNS = ("timestamp_ns", "tx_m", "ty_m", "tz_m", "qx", "qy", "qz", "qw")


def matches(path: Path) -> bool:
    return (path / POSES).is_file()


def open_av2(source: Source) -> Log:
    gap_ns = max_gap_ns(source)
    sweeps = _sweeps(source.path)
    poses = read_poses(source.path / POSES)
    return Log(source.path, READER.name, scans=lambda: _read(sweeps, poses, gap_ns), count=len(sweeps))


def _read(sweeps: dict[int, Path], poses: Trajectory, gap_ns: int) -> Iterator[Record]:
    for stamp_ns, path in sweeps.items():
        yield placed(stamp_ns, lambda at: poses.at(at, gap_ns), lambda path=path: read_sweep(path))  # type: ignore[misc]


def _sweeps(folder: Path) -> dict[int, Path]:
    files = sorted((folder / "sensors" / "lidar").glob("*.feather"))
    if not files:
        raise LogError(f"{folder}: no sensors/lidar/*.feather; download the lidar sweeps, poses alone map nothing")
    for path in files:
        if not path.stem.isdigit():
            raise LogError(f"{path}: a sweep is named by its stamp in nanoseconds; rename or remove this file")
    return dict(sorted((int(path.stem), path) for path in files))


def read_poses(path: Path) -> Trajectory:
    """Pose of the ego vehicle in the city's frame. Raises PoseError naming the row."""
    stamps, *rest = _columns(path, POSE_COLUMNS)
    values = np.stack(rest, axis=1)
    return trajectory(stamps, values[:, :3], values[:, 3:], lambda i: f"{path}: row {i + 1}")


def read_sweep(path: Path) -> Array:
    """(N, 3) float32 of the file's half floats: exact, and what arithmetic is fast on."""
    return np.stack([column.astype(np.float32) for column in _columns(path, ("x", "y", "z"))], axis=1)


def _columns(path: Path, names: tuple[str, ...]) -> list[Any]:
    feather = library("pyarrow.feather", "Argoverse 2", "av2")
    table = feather.read_table(path)
    missing = [name for name in names if name not in table.column_names]
    if missing:
        raise LogError(f"{path}: no column {listed(missing)}; it has {listed(table.column_names)}")
    return [table[name].to_numpy() for name in names]


READER = Reader(
    name="av2",
    summary=f"Argoverse 2 log folder: {POSES}, sensors/lidar/*.feather",
    matches=matches,
    open=open_av2,
    options={"max_gap_s": MAX_GAP_HELP},
)
