"""Prints the golden bytes of the delta format, a comment a line: python -m tests.exchange.make_golden"""

from __future__ import annotations

import struct

from terrafuse.exchange.codec import encode
from terrafuse.lattice import Lattice
from terrafuse.mapper import Mapper
from terrafuse.testing.deltas import scan_of


def golden_delta():
    """Two scans of robot r1 on 1 m cells in 4 m tiles: two cells in tile (0, 0), one in (-1, 0)."""
    mapper = Mapper("r1", Lattice(1.0, 4.0))
    mapper.integrate(scan_of([(0.5, 0.5, 1.0), (2.5, 1.5, 2.0), (-0.5, 0.5, -1.0)], 1_000_000_000))
    mapper.integrate(scan_of([(0.5, 0.5, 5.0)], 2_000_000_000))
    return mapper.delta(since=0)


def parts(message: bytes) -> list[tuple[str, bytes]]:
    """The message cut as the format describes it."""
    (length,) = struct.unpack("<I", message[4:8])
    return [
        ("magic", message[:3]),
        ("format version", message[3:4]),
        ("header length", message[4:8]),
        ("header, msgpack", message[8 : 8 + length]),
        ("frames, zstd, one a tile", message[8 + length : -4]),
        ("CRC-32 of all before", message[-4:]),
    ]


if __name__ == "__main__":
    for name, part in parts(encode(golden_delta())):
        print(f"    # {name}")
        for k in range(0, len(part), 48):
            print(f'    "{part[k : k + 48].hex()}"')
