"""The program run as users run it, and small logs to run it on."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from terrafuse.logs.recorder import McapRecorder
from terrafuse.types import Pose

SCAN_NS = 100_000_000


@dataclass(frozen=True)
class Ran:
    code: int
    out: str
    err: str

    @property
    def json(self) -> dict[str, Any]:
        return json.loads(self.out)


PROGRAM = (sys.executable, "-m", "terrafuse")


def terrafuse(*arguments: str | Path, **options: Any) -> Ran:
    """Run the program in a process of its own."""
    done = subprocess.run(
        [*PROGRAM, *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=300,
        env=os.environ | {"COLUMNS": "200"},
        **options,
    )
    return Ran(done.returncode, done.stdout, done.stderr)


def record(path: Path, seed: int, scans: int, points: int = 2000, shift_m: float = 0.0) -> Path:
    """A log of a robot that drives east at 5 m/s over a rolling plain with blocks on it."""
    rng = np.random.default_rng(seed)
    with McapRecorder(path) as recorder:
        for k in range(scans):
            x = 0.5 * k + shift_m
            recorder.pose(k * SCAN_NS, Pose.identity().shifted(x, 0.0, 2.0))
            around = rng.uniform(-20, 20, (points, 2))
            world = around + np.array([x, 0.0])
            z = 0.3 * np.sin(world[:, 0] / 9) + (np.floor(world / 4).astype(int) % 3 == 0).all(axis=1) * 1.0
            recorder.scan(k * SCAN_NS, np.column_stack([around, z - 2.0 + rng.normal(0, 0.01, points)]))
    return path
