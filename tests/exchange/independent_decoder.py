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
COLUMNS = {  # ~ predicted, ± signed, | where
    ("elevation", 1): "n~ mean~ below above variance changes alike ground_n ground_mean±|ground_n "
    "ground_below|ground_n ground_above|ground_n ground_variance|ground_n",
    ("elevation", 2): "n~ height~ drop",
    ("terrain", 1): "rare coarse wall held plane slopes height~ confidence~ gradient_x±|slopes gradient_y±|slopes "
    "gradient_error|slopes occupation",
    ("terrain", 2): "rare coarse wall height~ confidence~ occupation~|coarse",
} | {(model, form): names for model, names in (("grey", "a~ c~"), ("occupancy", "sum~ updates~")) for form in (1, 2)}


class Body:
    def __init__(self, data: bytes) -> None:
        self.state, self.words = int.from_bytes(data[:4], "little"), struct.iter_unpack("<H", data[4 : len(data) & ~1])
        self.bits = int.from_bytes(data[::-1], "little")
        self.taken, self.size = [32, 0], 8 * len(data)

    def plain(self, count: int) -> int:
        out, self.bits = self.bits & ((1 << count) - 1), self.bits >> count
        self.taken[1] += count
        return out

    def unary(self) -> int:
        return 0 if self.plain(1) else 1 + self.unary()

    def shares(self) -> list[int]:
        levels = [self.plain(4) for _ in range(self.plain(6))]
        weights = [level if level < 4 else (level - 2 * (level // 2 - 1)) << (level // 2 - 1) for level in levels]
        out = [max(1, w * 1024 // sum(weights)) if w else 0 for w in weights]
        out[levels.index(max(levels))] += 1024 - sum(out)
        return out

    def coded(self, shares: list[int]) -> int:
        kind, rest = 0, self.state % 1024
        while rest >= shares[kind]:
            kind, rest = kind + 1, rest - shares[kind]
        self.state = shares[kind] * (self.state // 1024) + rest
        if self.state < 2**16:
            self.state = self.state * 2**16 + next(self.words)[0]
            self.taken[0] += 16
        return kind

    def symbols(self, count: int) -> list[int]:
        mode = self.plain(2) if count else 0
        shares, out = self.shares() if mode == 1 else [], []
        for _ in range(1 if mode == 2 else count):
            kind = self.coded(shares) if mode == 1 else self.unary()
            out.append(kind if kind <= 2 else 2 ** (kind - 2) + 1 + self.plain(kind - 2))
        return out * count if mode == 2 else out

    def ended(self) -> bool:
        return self.state == 2**16 and 0 <= self.size - sum(self.taken) < 8


def unfold(symbol: int) -> int:
    return -(symbol + 1) // 2 if symbol % 2 else symbol // 2


def expected(at: dict[Any, int], x: int, j: int, i: int, last: int) -> int:
    w, n, nw = at.get((x, j, i - 1)), at.get((x, j - 1, i)), at.get((x, j - 1, i - 1))
    if w is not None and n is not None:
        return (w + n) // 2 if nw is None else sorted([w, n, w + n - nw])[1]
    return last if w is None and n is None else n if w is None else w


def decode(message: bytes) -> tuple[dict[str, Any], dict[tuple[int, int], list[Any]]]:
    magic, version, form, length = struct.unpack_from("<3sBBI", message)
    assert (magic, version) == (b"TFD", 4)
    assert zlib.crc32(message[:-4]) == struct.unpack("<I", message[-4:])[0]
    fields = msgspec.msgpack.decode(message[9 : 9 + length])
    header = dict(zip(NAMES + (ROUNDED if form else EXACT), fields, strict=True))
    return header, (rounded if form else exact)(header, form, message[9 + length : -4])


def exact(header: dict[str, Any], _: int, body: bytes) -> dict[tuple[int, int], list[Any]]:
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
    body, side, cells = Body(data), round(header["tile_m"] / header["resolution_m"]), header["cells"]
    x, y = (list(accumulate(map(unfold, body.symbols(header["tiles"])))) for _ in range(2))
    counts = [less + 1 for less in body.symbols(header["tiles"] - 1)]
    tile_of = [t for t, count in enumerate([*counts, cells - sum(counts)]) for _ in range(count)]
    backs, lows, highs = (body.symbols(header["pairs"]) for _ in range(3))
    revisions = [header["revision"] - back for back in accumulate(backs)]
    ages = accumulate(unfold(high << 32 | low) for low, high in zip(lows, highs, strict=True))
    stamps = [header["stamp_ns"] - age * 10 ** header["digits"] for age in ages]
    at: list[int] = []
    for k, gap in enumerate(body.symbols(cells)):
        at.append(gap if k == 0 or tile_of[k] != tile_of[k - 1] else at[-1] + 1 + gap)
    columns: dict[str, list[int]] = {}
    for column in ["seen~" if body.symbols(1)[0] else "seen", *COLUMNS[header["model"], form].split()]:
        name, _, where = column.partition("|")
        chosen = [k for k in range(cells) if not where or columns[where][k]]
        symbols, known, last = dict(zip(chosen, body.symbols(len(chosen)), strict=True)), {}, 0
        values = columns[name.strip("~±")] = [0] * cells
        for k, symbol in symbols.items():
            values[k] = unfold(symbol) if name[-1] in "~±" else symbol
        for k, (t, one) in enumerate(zip(tile_of, at, strict=True)):
            place = x[t], y[t] * side + one // side, one % side
            if name[-1] == "~" and k in symbols:
                values[k] += expected(known, *place, last)
            last = known[place] = values[k]
    assert body.ended()
    tiles: dict[tuple[int, int], list[Any]] = {}
    for k, seen in enumerate(columns.pop("seen")):
        numbers = {name: values[k] for name, values in columns.items()}
        tiles.setdefault((x[tile_of[k]], y[tile_of[k]]), []).append((at[k], stamps[seen], revisions[seen], numbers))
    return tiles
