"""What the robots of the analytic world would have brought home."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from terrafuse.logs.recorder import McapRecorder
from terrafuse.testing.analytic.scene import scan
from terrafuse.testing.analytic.world import GROUND, LIDAR, ROUNDS, SCENE, T_BASE_SENSOR, Round, pose_on
from terrafuse.types import Stamp

START_NS: Stamp = 1_760_000_000_000_000_000
SCAN_EVERY_NS = 500_000_000
POSE_EVERY_NS = 100_000_000
NS = 1_000_000_000


def write_logs(folder: Path | str, *, seconds: float = 30.0, seed: int = 0) -> dict[str, Path]:
    """One MCAP file for each robot, `folder`/NAME.mcap, of this many seconds of the drive: a lap in 30.

    Scans are taken at one instant each, twice a second; poses come ten times a second. The seed decides the ranges'
    noise and nothing else. Raises MissingExtra without the extra `ros`.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    paths = {name: folder / f"{name}.mcap" for name in ROUNDS}
    for number, (name, round_) in enumerate(ROUNDS.items()):
        _record(paths[name], round_, round(seconds * NS), np.random.default_rng([seed, number]))
    return paths


def _record(path: Path, round_: Round, duration_ns: int, rng: np.random.Generator) -> None:
    with McapRecorder(path) as recorder:
        recorder.static(T_BASE_SENSOR)
        for since_ns in range(0, duration_ns, POSE_EVERY_NS):
            time_s = since_ns / NS
            T_world_base = pose_on(GROUND, *round_.place(time_s))
            recorder.pose(START_NS + since_ns, T_world_base)
            if since_ns % SCAN_EVERY_NS == 0:
                points = scan(SCENE, LIDAR, T_world_base @ T_BASE_SENSOR, time_s, rng)
                recorder.scan(START_NS + since_ns, points)
