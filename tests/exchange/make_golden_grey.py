"""Prints the golden bytes of the grey frame, a comment a line: python -m tests.exchange.make_golden_grey"""

from __future__ import annotations

import numpy as np

from terrafuse.exchange.grey_frame import Frame, encode_frame, frames_of
from terrafuse.kernels.grey import CELL, FULL


def golden_frame() -> Frame:
    """3×2 cells from (-2, 5) on, of map 7: unknown, free, occupied; without information, narrow, certain."""
    cells = np.zeros((2, 3), CELL)
    cells["a"] = [[0, 0, FULL // 2], [0, 30_000, FULL]]
    cells["c"] = [[0, 50_000, 0], [0, 30_001, 0]]
    (frame,) = frames_of(cells, -2, 5, 7)
    return frame


def parts(message: bytes) -> list[tuple[str, bytes]]:
    """The message cut as the format describes it."""
    return [
        ("version", message[:1]),
        ("sequence", message[1:2]),
        ("width, height", message[2:4]),
        ("i0", message[4:8]),
        ("j0", message[8:12]),
        ("a and b of each cell", message[12:]),
    ]


if __name__ == "__main__":
    for name, part in parts(encode_frame(golden_frame())):
        print(f"    # {name}")
        print(f'    "{part.hex()}"')
