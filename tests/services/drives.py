"""Small logs of a drive as KITTI folders, whose poses are text that a test can change."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from terrafuse.types import Pose


def drive(folder: Path, seed: int = 1, scans: int = 12, correct: Callable[[float, Pose], Pose] | None = None) -> str:
    """Scans a second apart, from second 1 on, each a metre further north-east; the source's text.

    `correct(second, pose)`: the pose that is written instead.
    """
    folder.mkdir(parents=True)
    rng = np.random.default_rng(seed)
    poses, times = [], []
    for k in range(scans):
        xy = rng.uniform(-9, 9, (400, 2))
        z = 0.1 * xy[:, 0] + rng.choice([0.0, 0.0, 1.5], 400) + rng.normal(0, 0.02, 400)
        np.column_stack([xy, z, np.zeros(400)]).astype("<f4").tofile(folder / f"{k:06d}.bin")
        pose = Pose.identity().shifted(1.0 * k, 0.5 * k)
        times.append(k + 1.0)
        pose = pose if correct is None else correct(times[-1], pose)
        poses.append(" ".join(repr(float(number)) for number in pose.matrix[:3].reshape(-1)))
    (folder / "poses.txt").write_text("\n".join(poses) + "\n")
    (folder / "times.txt").write_text("\n".join(map(repr, times)) + "\n")
    return f"{folder}?poses=poses.txt&calib=identity"
