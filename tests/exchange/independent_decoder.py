"""A decoder of deltas, written from docs/delta-format.md alone: nothing of terrafuse is used.

    header, tiles = decode(message)     # tiles: {(x, y): [(position, stamp_ns, revision, {name: number}), ...]}

Numbers are as they travel; of the exact form they are the record's fields.
"""

from __future__ import annotations

import struct
import zlib
from itertools import accumulate
from typing import Any

import msgspec
import numpy as np
import zstandard

NAMES = ["model", "resolution_m", "tile_m", "crs", "robot", "revision", "span", "stamp_ns"]
EXACT, ROUNDED = ["tiles", "fields", "sizes"], ["tiles", "cells", "pairs", "digits"]
PLAIN, SIGNED, PREDICTED = "plain", "signed", "predicted"
COLUMNS: dict[tuple[str, int], list[tuple[str, str, str | None]]] = {
    ("elevation", 2): [("n", PREDICTED, None), ("height", PREDICTED, None), ("drop", PLAIN, None)],
    ("elevation", 1): [("n", PREDICTED, None), ("mean", PREDICTED, None), ("below", PLAIN, None),
                       ("above", PLAIN, None), ("variance", PLAIN, None), ("changes", PLAIN, None),
                       ("alike", PLAIN, None), ("ground_n", PLAIN, None), ("ground_mean", SIGNED, "ground_n"),
                       ("ground_below", PLAIN, "ground_n"), ("ground_above", PLAIN, "ground_n"),
                       ("ground_variance", PLAIN, "ground_n")],
    ("grey", 2): [("a", PREDICTED, None), ("c", PREDICTED, None)],
    ("occupancy", 2): [("sum", PREDICTED, None), ("updates", PREDICTED, None)],
    ("terrain", 2): [("rare", PLAIN, None), ("coarse", PLAIN, None), ("wall", PLAIN, None),
                     ("height", PREDICTED, None), ("confidence", PREDICTED, None), ("occupation", PREDICTED, "coarse")],
    ("terrain", 1): [("rare", PLAIN, None), ("coarse", PLAIN, None), ("wall", PLAIN, None), ("held", PLAIN, None),
                     ("plane", PLAIN, None), ("slopes", PLAIN, None), ("height", PREDICTED, None),
                     ("confidence", PREDICTED, None), ("gradient_x", SIGNED, "slopes"),
                     ("gradient_y", SIGNED, "slopes"), ("gradient_error", PLAIN, "slopes"),
                     ("occupation", PLAIN, None)],
}  # fmt: skip
COLUMNS["grey", 1], COLUMNS["occupancy", 1] = COLUMNS["grey", 2], COLUMNS["occupancy", 2]


class Body:
    def __init__(self, data: bytes) -> None:
        self.data, self.front, self.back = data, 4, 0
        self.state = int.from_bytes(data[:4], "little")

    def plain(self, count: int) -> int:
        out = 0
        for k in range(count):
            byte, bit = divmod(self.back + k, 8)
            out |= (self.data[-1 - byte] >> bit & 1) << k
        self.back += count
        return out

    def table(self) -> list[int]:
        weights = []
        for _ in range(self.plain(6)):
            level = self.plain(5)
            s = max((level >> 1) - 1, 0)
            weights.append((level - (s << 1)) << s)
        if not weights:
            return [1024]
        shares = [max(1, w * 1024 // sum(weights)) if w else 0 for w in weights]
        shares[weights.index(max(weights))] += 1024 - sum(shares)
        return shares

    def coded(self, shares: list[int]) -> int:
        kind, rest = 0, self.state % 1024
        while rest >= shares[kind]:
            kind, rest = kind + 1, rest - shares[kind]
        self.state = shares[kind] * (self.state // 1024) + rest
        if self.state < 2**16:
            self.state = self.state * 2**16 + int.from_bytes(self.data[self.front : self.front + 2], "little")
            self.front += 2
        return kind

    def unary(self) -> int:
        kind = 0
        while not self.plain(1):
            kind += 1
        return kind

    def symbols(self, count: int) -> list[int]:
        mode = self.plain(2) if count else 0
        assert mode < 3
        tables = [self.table() for _ in range((0, 1, 4)[mode])]
        out, kind = [], 0
        for _ in range(count):
            kind = self.coded(tables[min(kind, len(tables) - 1)]) if tables else self.unary()
            out.append(kind if kind <= 2 else 2 ** (kind - 2) + 1 + self.plain(kind - 2))
        return out

    def ended(self) -> bool:
        left = 8 * len(self.data) - 8 * self.front - self.back
        return self.state == 2**16 and 0 <= left < 8 and self.plain(left) == 0


def unfold(symbol: int) -> int:
    return -(symbol + 1) // 2 if symbol % 2 else symbol // 2


def expected(at: dict[Any, int], x: int, j: int, i: int, last: int) -> int:
    w, n, nw = at.get((x, j, i - 1)), at.get((x, j - 1, i)), at.get((x, j - 1, i - 1))
    if w is not None and n is not None:
        return (w + n) // 2 if nw is None else sorted([w, n, w + n - nw])[1]
    return last if w is None and n is None else n if w is None else w


def column(body: Body, kind: str, chosen: list[int], places: list[tuple[int, int, int]]) -> list[int]:
    numbers, known = [0] * len(places), {}
    (alike,) = body.symbols(1)
    symbols = [] if alike else body.symbols(len(chosen))
    following, last, picked = iter(symbols), 0, set(chosen)
    for k, place in enumerate(places):
        if k in picked:
            symbol = alike - 1 if alike else next(following)
            numbers[k] = symbol if kind == PLAIN and not alike else unfold(symbol)
            if kind == PREDICTED and not alike:
                numbers[k] += expected(known, *place, last)
        last = known[place] = numbers[k]
    return numbers


def decode(message: bytes) -> tuple[dict[str, Any], dict[tuple[int, int], list[Any]]]:
    magic, version, form, length = struct.unpack_from("<3sBBI", message)
    assert (magic, version) == (b"TFD", 3)
    assert zlib.crc32(message[:-4]) == struct.unpack("<I", message[-4:])[0]
    fields = msgspec.msgpack.decode(message[9 : 9 + length])
    header = dict(zip(NAMES + (ROUNDED if form else EXACT), fields, strict=True))
    body = message[9 + length : -4]
    return header, rounded(header, form, body) if form else exact(header, body)


def exact(header: dict[str, Any], body: bytes) -> dict[tuple[int, int], list[Any]]:
    tiles, frames = {}, 0
    for (x, y, _, count), size in zip(header["tiles"], header["sizes"], strict=True):
        raw = zstandard.ZstdDecompressor().decompress(body[frames : frames + size])
        frames, at, columns = frames + size, 0, {}
        for name, kind in [("at", "<u4"), *header["fields"]]:
            wide = np.dtype(kind).itemsize
            turned = np.frombuffer(raw, np.uint8, wide * count, at).reshape(wide, count).T
            columns[name] = np.cumsum(turned.copy().view(f"<u{wide}")[:, 0], dtype=f"<u{wide}").view(kind).tolist()
            at += wide * count
        rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
        tiles[x, y] = [(row.pop("at"), row["stamp"], row["revision"], row) for row in rows]
    return tiles


def rounded(header: dict[str, Any], form: int, data: bytes) -> dict[tuple[int, int], list[Any]]:
    body, side = Body(data), round(header["tile_m"] / header["resolution_m"])
    x, y = (list(accumulate(map(unfold, body.symbols(header["tiles"])))) for _ in range(2))
    tile_of = [t for t, less in enumerate(body.symbols(header["tiles"])) for _ in range(less + 1)]
    backs, lows, highs = (body.symbols(header["pairs"]) for _ in range(3))
    at: list[int] = []
    for k, gap in enumerate(body.symbols(header["cells"])):
        at.append(gap if k == 0 or tile_of[k] != tile_of[k - 1] else at[-1] + 1 + gap)
    places = [(x[t], y[t] * side + one // side, one % side) for t, one in zip(tile_of, at, strict=True)]
    columns: dict[str, list[int]] = {}
    for name, kind, where in [("seen", PLAIN, None), *COLUMNS[header["model"], form]]:
        chosen = [k for k in range(len(at)) if where is None or columns[where][k]]
        columns[name] = column(body, kind, chosen, places)
    assert body.ended()
    tiles: dict[tuple[int, int], list[Any]] = {}
    for k, seen in enumerate(columns.pop("seen")):
        stamp_ns = header["stamp_ns"] - unfold(highs[seen] << 32 | lows[seen]) * 10 ** header["digits"]
        revision = header["revision"] - backs[seen]
        numbers = {name: values[k] for name, values in columns.items()}
        tiles.setdefault((x[tile_of[k]], y[tile_of[k]]), []).append((at[k], stamp_ns, revision, numbers))
    return tiles
