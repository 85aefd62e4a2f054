"""Point files and a TUM trajectory: what most SLAM systems export."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from terrafuse.errors import LogError
from terrafuse.logs.base import Log, Reader, Record, Source
from terrafuse.logs.las import read_points
from terrafuse.logs.las_size import check_sizes
from terrafuse.logs.libraries import library
from terrafuse.logs.options import MAX_GAP_HELP, file_option, listed, max_gap_ns, whole_numbers
from terrafuse.logs.points.pcd import read_pcd
from terrafuse.logs.points.ply import read_ply
from terrafuse.logs.points.raw import read_bin, read_npy
from terrafuse.logs.points.table import is_table, read_table
from terrafuse.logs.stamps import natural_order, stamp_of_name
from terrafuse.logs.trajectory import PoseAt, Trajectory, in_world, placed, read_tum
from terrafuse.types import Array, Stamp

ReadPoints = Callable[[Path], Array]


def read_las(path: Path) -> Array:
    """Coordinates as the file has them: with a trajectory, LAS is a mere container whose CRS says nothing."""
    check_sizes(path)
    return read_points(library("laspy", "LAS", "las").read(path))


POINT_FILES: dict[str, ReadPoints] = {
    ".pcd": read_pcd,
    ".ply": read_ply,
    ".npy": read_npy,
    ".csv": read_table,
    ".txt": read_table,
    ".xyz": read_table,
    ".las": read_las,
    ".laz": read_las,
}
SUFFIXES = (*POINT_FILES, ".bin")
GEOREFERENCED = (".las", ".laz")


def matches(path: Path) -> bool:
    if path.is_file():
        return path.suffix.lower() in SUFFIXES and (path.suffix.lower() != ".txt" or is_table(path))
    return any(_is_cloud(file) for file in path.iterdir())


def open_clouds(source: Source) -> Log:
    gap_ns = max_gap_ns(source)
    trajectory_file = _trajectory_file(source)
    files = _files(source, trajectory_file)
    read = _reading(source, files)
    if trajectory_file is None:
        return _log(source, [stamp_of_name(file.stem) or 0 for file in files], files, read, in_world)
    poses = read_tum(trajectory_file)
    stamps = _stamps(files, poses, trajectory_file)
    return _log(source, stamps, files, read, lambda stamp_ns: poses.at(stamp_ns, gap_ns))


def _log(source: Source, stamps: list[Stamp], files: list[Path], read: ReadPoints, pose_at: PoseAt) -> Log:
    ordered = sorted(zip(stamps, files, strict=True), key=lambda pair: pair[0])

    def scans() -> Iterator[Record]:
        for stamp_ns, file in ordered:
            yield placed(stamp_ns, pose_at, partial(read, file))

    return Log(source.path, READER.name, scans=scans, count=len(files))


def _is_cloud(path: Path) -> bool:
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES or not path.is_file():
        return False
    return POINT_FILES.get(suffix) is not read_table or is_table(path)


def _is_trajectory(path: Path) -> bool:
    return path.suffix == ".tum" or path.name == "trajectory.txt"


def _trajectory_file(source: Source) -> Path | None:
    """The trajectory, None where the clouds are said to be in the world's frame."""
    if source.options.get("poses") == "identity":
        return None
    given = file_option(source, "poses")
    if given is not None:
        return given
    found = [file for file in sorted(source.path.iterdir()) if _is_trajectory(file)] if source.path.is_dir() else []
    if not found:
        raise LogError(
            f"{source.path}: no trajectory (trajectory.txt or *.tum); give ?poses=FILE with lines "
            "`stamp tx ty tz qx qy qz qw`, or ?poses=identity if the points are already in the world's frame"
        )
    if len(found) > 1:
        names = listed(file.name for file in found)
        raise LogError(f"{source.path}: several trajectories ({names}); say which: ?poses={found[0].name}")
    return found[0]


def _files(source: Source, trajectory_file: Path | None) -> list[Path]:
    if source.path.is_file():
        return [source.path]
    pattern = source.options.get("files", "*")
    files = [
        file
        for file in sorted(source.path.glob(pattern), key=natural_order)
        if _is_cloud(file) and not _is_trajectory(file) and not _same(file, trajectory_file)
    ]
    if not files:
        raise LogError(f"{source.path}: no point file matches '{pattern}'; known are {listed(SUFFIXES)}")
    kinds = {file.suffix.lower() for file in files}
    if len(kinds) > 1:
        raise LogError(
            f"{source.path}: point files of several kinds ({listed(sorted(kinds))}); say which: "
            f"?files=*{files[0].suffix}"
        )
    return files


def _same(file: Path, other: Path | None) -> bool:
    return other is not None and file.samefile(other)


def _reading(source: Source, files: list[Path]) -> ReadPoints:
    suffix = files[0].suffix.lower()
    if source.options.get("poses") == "identity" and suffix in GEOREFERENCED:
        raise LogError(f"{source.path}: LAS in world coordinates has a unit and a CRS to heed: say ?reader=las")
    if suffix == ".bin":
        return partial(read_bin, columns=_columns(source))
    if "columns" in source.options:
        raise LogError(f"{source.path}: ?columns only counts for .bin files; {suffix} files state their own")
    return POINT_FILES[suffix]


def _columns(source: Source) -> int:
    """No .bin says how many numbers a point has; 3 and 4 are both common, and a wrong one still parses."""
    given = whole_numbers(source, "columns")
    if given is None or len(given) != 1 or given[0] < 3:
        raise LogError(f"{source.path}: say how many float32 a point has in the .bin files: ?columns=3 or ?columns=4")
    return given[0]


def _stamps(files: list[Path], poses: Trajectory, trajectory_file: Path) -> list[Stamp]:
    by_name = [stamp_of_name(file.stem) for file in files]
    stamps = [stamp for stamp in by_name if stamp is not None]
    if len(stamps) == len(files):
        return stamps
    if len(files) == len(poses.stamps_ns):
        return [int(stamp) for stamp in poses.stamps_ns]
    raise LogError(
        f"{trajectory_file}: {len(poses.stamps_ns)} poses for {len(files)} files, and names like "
        f"'{files[by_name.index(None)].name}' are no time; name each file by its stamp, as "
        "1305031102.175304.pcd, or give a trajectory with one line a file"
    )


READER = Reader(
    name="clouds",
    summary=f"folder of point files ({listed(SUFFIXES)}) with a TUM trajectory, or one such file",
    matches=matches,
    open=open_clouds,
    options={
        "poses": "TUM trajectory (default: trajectory.txt or *.tum), or 'identity' for points in the world",
        "max_gap_s": MAX_GAP_HELP,
        "columns": "float32 numbers a point in .bin files: 3, 4, …",
        "files": "pattern of the point files, as *.pcd (default: all, if of one kind)",
    },
)
