"""What several tests need: small recordings with a known answer, and how to read one whole."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from terrafuse.errors import InputError
from terrafuse.logs import open_log
from terrafuse.logs.base import Record
from terrafuse.types import Pose, Scan, Skipped

NS = 1_000_000_000
IDENTITY_QUATERNION = (0.0, 0.0, 0.0, 1.0)


def read(text: str) -> list[Record]:
    return list(open_log(text).scans())


def scans(text: str) -> list[Scan]:
    """All records, each of which must be a scan."""
    records = read(text)
    assert all(isinstance(record, Scan) for record in records)
    return records  # type: ignore[return-value]


def reasons(text: str) -> list[str]:
    return [record.reason for record in read(text) if isinstance(record, Skipped)]


def refuses(text: str, *parts: str, error: type[InputError] = InputError) -> str:
    """Opening or reading it raises, and the message has each part."""
    with pytest.raises(error) as caught:
        read(text)
    message = str(caught.value)
    for part in parts:
        assert part in message
    return message


def pose(x: float = 0.0, y: float = 0.0, z: float = 0.0, yaw: float = 0.0) -> Pose:
    return Pose.from_quaternion((x, y, z), (0, 0, np.sin(yaw / 2), np.cos(yaw / 2)))


def some_points(count: int = 7, seed: int = 0, dtype: Any = np.float32) -> Any:
    return np.random.default_rng(seed).uniform(-20, 20, (count, 3)).astype(dtype)


def write_tum(path: Path, rows: list[tuple[str, Any]]) -> Path:
    """`rows`: stamp as text, and (x, y, z) or all seven numbers."""
    lines = []
    for stamp, numbers in rows:
        full = tuple(numbers) if len(numbers) == 7 else (*numbers, *IDENTITY_QUATERNION)
        lines.append(f"{stamp} {' '.join(map(repr, map(float, full)))}")
    path.write_text("# stamp tx ty tz qx qy qz qw\n" + "\n".join(lines) + "\n")
    return path
