"""Whether a LAS header and its file agree on size: laspy believes counts, and runs for minutes or out of memory."""

from __future__ import annotations

import struct
from pathlib import Path

from terrafuse.errors import LogError

HEADER_1_4_BYTES = 375
VLR_HEADER_BYTES = 54
EVLR_HEADER_BYTES = 60


def check_sizes(path: Path) -> None:
    """Raises LogError if the file is shorter than what its header counts (LAS 1.4 R15, table 3)."""
    size = path.stat().st_size
    with path.open("rb") as file:
        header = file.read(HEADER_1_4_BYTES).ljust(HEADER_1_4_BYTES, b"\0")
    header_bytes, points_at, vlrs = struct.unpack_from("<HII", header, 94)
    _, point_bytes, points = struct.unpack_from("<BHI", header, 104)
    if header[24:26] >= b"\x01\x04":
        evlrs_at, evlrs, points = struct.unpack_from("<QIQ", header, 235)
        _check(path, size, evlrs_at + evlrs * EVLR_HEADER_BYTES if evlrs else 0, f"{evlrs} extended records")
    _check(path, points_at, header_bytes + vlrs * VLR_HEADER_BYTES, f"{vlrs} records before the points")
    if path.suffix.lower() == ".las":  # how far points are compressed nobody can say
        _check(path, size, points_at + points * point_bytes, f"{points} points of {point_bytes} bytes")
    _check(path, size, points_at, "its points")


def _check(path: Path, size: int, needed: int, what: str) -> None:
    if size < needed:
        raise LogError(f"{path}: truncated or damaged: {what} need {needed} bytes, there are {size}")
