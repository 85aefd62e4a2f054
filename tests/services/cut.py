"""Real recordings, cut by time into a log for each of three robots."""

from __future__ import annotations

import gzip
from collections.abc import Sequence
from pathlib import Path

ROBOTS = ("r1", "r2", "r3")


def thirds(items: Sequence[object]) -> list[slice]:
    cut = len(items) // 3
    return [slice(0, cut), slice(cut, 2 * cut), slice(2 * cut, len(items))]


def kitti(recordings: Path, folder: Path) -> dict[str, str]:
    """Six scans, two a robot; their poses in the frame of the first."""
    whole = recordings / "lidar3d/patchworkpp_kitti"
    scans = sorted(whole.glob("*.bin"))
    poses = (whole / "poses_velo_first6.txt").read_text().splitlines()
    assert len(scans) == len(poses) == 6
    sources = {}
    for name, part in zip(ROBOTS, thirds(scans), strict=True):
        own = folder / name
        own.mkdir()
        for scan in scans[part]:
            (own / scan.name).symlink_to(scan)
        (own / "poses.txt").write_text("\n".join(poses[part]) + "\n")
        sources[name] = f"{own}?poses=poses.txt&calib=identity"
    return sources


def freiburg(recordings: Path, folder: Path, every: int) -> dict[str, str]:
    """Of Freiburg's building 079 one scan in so many."""
    path = recordings / "lidar2d/ple_corrected/freiburg-079-corrected.log.gz"
    with gzip.open(path, "rt") as lines:
        scans = [line for line in lines if line.startswith("FLASER ")][::every]
    sources = {}
    for name, part in zip(ROBOTS, thirds(scans), strict=True):
        own = folder / f"{name}.log"
        own.write_text("".join(scans[part]))
        sources[name] = str(own)
    return sources
