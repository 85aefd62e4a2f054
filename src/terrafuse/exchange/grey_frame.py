"""The grey paper's frame: a rectangle of grey cells in 12 + 2 bytes a cell, 2312 bytes at most.

That is what one IEEE 802.11b frame carries. The layout is fixed by golden bytes in the tests; docs/grey-frame.md
describes it. A frame is a picture of a map, rounded outward and without stamps or revisions; what robots report as
their contributions are deltas.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from terrafuse.errors import CodecError, InputError
from terrafuse.kernels.grey import CELL, FULL
from terrafuse.types import Array, Stamp

VERSION = 1
HEADER = struct.Struct("<BBBBii")
"""version, sequence, width, height, i0, j0"""
MAX_FRAME = 2312
MAX_CELLS = (MAX_FRAME - HEADER.size) // 2
MAX_SIDE = 255
SQUARE_SIDE = 33
"""Of the largest square that a frame holds."""
MAX_MAP_CELLS = 1 << 24
"""Of a map put together: whatever frames claim, it takes no more than 256 MB of cells."""

TICKS = FULL // 255
"""257 ticks of a cell are one step of a frame."""


@dataclass(frozen=True, eq=False)
class Frame:
    """The cells (i0 …, j0 …) of a map: `a` and `b` (height, width) uint8 in 1/255, [j, i], row 0 southernmost.

    `sequence`, 0 to 255, is the same for all frames of one map, and is counted up from one map to the next.
    """

    sequence: int
    i0: int
    j0: int
    a: Array
    b: Array


def frames_of(cells: Array, i0: int, j0: int, sequence: int) -> list[Frame]:
    """Grey cells (H, W), the south-western one (i0, j0), as frames; a rounded down and b rounded up.

    A map of at most 1150 cells and 255 a side is one frame; of a larger one each frame is a part, nearly square.
    """
    height, width = cells.shape
    if not height or not width:
        return []
    whole = width <= MAX_SIDE and height <= MAX_SIDE and height * width <= MAX_CELLS
    columns = 1 if whole else -(-width // SQUARE_SIDE)
    wide = -(-width // columns)
    high = min(MAX_SIDE, MAX_CELLS // wide)
    return [
        Frame(sequence, i0 + i, j0 + j, *_rounded(cells[j : j + high, i : i + wide]))
        for j in range(0, height, high)
        for i in range(0, width, wide)
    ]


def _rounded(cells: Array) -> tuple[Array, Array]:
    return (cells["a"] // TICKS).astype(np.uint8), (255 - cells["c"] // TICKS).astype(np.uint8)


def encode_frame(frame: Frame) -> bytes:
    """The frame as bytes. Raises InputError for one that is too large, or too far from the origin for its header."""
    height, width = frame.a.shape
    if not (0 < height <= MAX_SIDE and 0 < width <= MAX_SIDE and height * width <= MAX_CELLS):
        raise InputError(f"{width}×{height} cells do not fit a frame of {MAX_FRAME} bytes: cut the map with frames_of")
    if not -(2**31) <= min(frame.i0, frame.j0) <= max(frame.i0, frame.j0) < 2**31 - MAX_SIDE:
        raise InputError(f"cell ({frame.i0}, {frame.j0}) is too far from the origin for a frame: use larger cells")
    header = HEADER.pack(VERSION, frame.sequence % 256, width, height, frame.i0, frame.j0)
    return header + np.stack([frame.a, frame.b], axis=-1).tobytes()


def decode_frame(message: bytes) -> Frame:
    """Bytes → frame. Raises CodecError for anything but a whole, well-formed one."""
    if not HEADER.size < len(message) <= MAX_FRAME:
        raise CodecError(f"{len(message)} bytes are no grey frame; it has {HEADER.size + 2} to {MAX_FRAME}")
    version, sequence, width, height, i0, j0 = HEADER.unpack_from(message)
    if version != VERSION:
        raise CodecError(f"a grey frame of version {version}; this terrafuse reads version {VERSION}")
    if len(message) != HEADER.size + 2 * width * height:
        raise CodecError(f"a grey frame of {width}×{height} cells with {len(message) - HEADER.size} bytes of them")
    if max(i0, j0) >= 2**31 - MAX_SIDE:
        raise CodecError(f"a grey frame at ({i0}, {j0}) that runs over the edge")
    cells = np.frombuffer(message, np.uint8, offset=HEADER.size).reshape(height, width, 2)
    a, b = cells[..., 0].copy(), cells[..., 1].copy()
    if (a > b).any():
        raise CodecError("a grey frame with intervals that end before they begin")
    return Frame(sequence, i0, j0, a, b)


def cells_of(frame: Frame, stamp_ns: Stamp, revision: int) -> Array:
    """(H, W) grey cells of a frame, unknown where it says [0, 1]; the others get this stamp and revision (≥ 1)."""
    out = np.zeros(frame.a.shape, CELL)
    out["a"], out["c"] = frame.a.astype(np.uint16) * TICKS, (255 - frame.b).astype(np.uint16) * TICKS
    informed = (out["a"] > 0) | (out["c"] > 0)
    out["stamp"], out["revision"] = np.where(informed, stamp_ns, 0), np.where(informed, revision, 0)
    return out


def assemble(frames: Iterable[Frame], stamp_ns: Stamp, revision: int) -> tuple[int, int, Array]:
    """The frames of one map, in any order and however often → (i0, j0, cells (H, W)).

    Frames that are missing leave their cells unknown. Raises CodecError for frames of different maps, for ones that
    overlap, and for none.
    """
    parts = _distinct(frames)
    i0, j0 = min(part.i0 for part in parts), min(part.j0 for part in parts)
    width = max(part.i0 + part.a.shape[1] for part in parts) - i0
    height = max(part.j0 + part.a.shape[0] for part in parts) - j0
    if width * height > MAX_MAP_CELLS:
        raise CodecError(f"grey frames spread over {width}×{height} cells; at most {MAX_MAP_CELLS} are put together")
    out, taken = np.zeros((height, width), CELL), np.zeros((height, width), bool)
    for part in parts:
        rows, columns = part.a.shape
        where = np.s_[part.j0 - j0 : part.j0 - j0 + rows, part.i0 - i0 : part.i0 - i0 + columns]
        if taken[where].any():
            raise CodecError(f"a grey frame at ({part.i0}, {part.j0}) that overlaps another one of the same map")
        taken[where] = True
        out[where] = cells_of(part, stamp_ns, revision)
    return i0, j0, out


def _distinct(frames: Iterable[Frame]) -> Sequence[Frame]:
    """Each frame once, in order of place. Raises CodecError unless all are of one map."""
    parts = {encode_frame(frame): frame for frame in frames}
    sequences = sorted({frame.sequence for frame in parts.values()})
    if len(sequences) != 1:
        raise CodecError(f"grey frames of {len(sequences)} maps ({sequences}); give those of one")
    return sorted(parts.values(), key=lambda frame: (frame.j0, frame.i0))
