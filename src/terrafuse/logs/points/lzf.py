"""LZF, by Marc Lehmann: what PCD calls binary_compressed."""

from __future__ import annotations


def decompress(data: bytes, size: int) -> bytes:
    """Raises ValueError unless the data unpacks to exactly `size` bytes."""
    out = bytearray()
    at, end = 0, len(data)
    while at < end:
        control = data[at]
        at += 1
        if control < 32:  # a run of control + 1 literal bytes
            out += data[at : at + control + 1]
            at += control + 1
            continue
        length = control >> 5
        if length == 7:
            length += data[at]
            at += 1
        start = len(out) - ((control & 31) << 8) - data[at] - 1
        at += 1
        if start < 0:
            raise ValueError("a back reference points before the start")
        out += _repeated(out, start, length + 2)
    if len(out) != size:
        raise ValueError(f"unpacks to {len(out)} bytes, {size} expected")
    return bytes(out)


def _repeated(out: bytearray, start: int, length: int) -> bytes:
    """What stands at `start`; a reference that runs into what it itself writes repeats the pattern."""
    piece = bytes(out[start : start + length])
    return piece if len(piece) == length else (piece * (length // len(piece) + 1))[:length]
