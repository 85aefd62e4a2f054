"""A listener, written from docs/protocol.md alone: nothing of terrafuse is used. It hears frames, and holds what a
station would.

listener = Listener(decode)              # of deltas: independent_decoder.decode
listener.hear(topic, payload)
listener.base["fine", "r1"], listener.cells["fine", "r1"][x, y][position] == (revision, stamp_ns, ...)
"""

from __future__ import annotations

import struct
import zlib
from collections import defaultdict
from collections.abc import Callable
from hashlib import blake2b
from typing import Any

import msgspec

SUMMARY = ["version", "born_ns", "said_ns", "robots", "held", "missing", "finished", "ahead", "roots", "area"]
POST = ["born_ns", "number", "kind", "payload"]


class Listener:
    def __init__(self, decode: Callable[[bytes], tuple[dict[str, Any], dict[Any, Any]]]) -> None:
        self.decode = decode
        self.parts: dict[bytes, dict[int, bytes]] = defaultdict(dict)
        self.base: dict[tuple[str, str], int] = defaultdict(int)
        self.ahead: dict[tuple[str, str], dict[Any, int]] = defaultdict(dict)
        self.claims: dict[tuple[str, str], Any] = {}
        self.cells: dict[tuple[str, str], Any] = defaultdict(lambda: defaultdict(dict))
        self.summaries: dict[str, dict[str, Any]] = {}
        self.posts: dict[tuple[str, str, str], dict[str, Any]] = {}

    def hear(self, topic: str, frame: bytes) -> None:
        check, version, id_, number, count = struct.unpack("<IB7sHH", frame[:16])
        if check != zlib.crc32(topic.encode() + frame[4:]) or version != 1:
            return
        self.parts[id_][number] = frame[16:]
        if len(self.parts[id_]) < count:
            return
        parts = self.parts.pop(id_)
        message = b"".join(parts[k] for k in range(count))
        if blake2b(topic.encode() + b"\0" + message, digest_size=7).digest() != id_:
            return
        kind, *where = topic.split("/")
        if kind == "summary":
            self.summaries[where[0]] = dict(zip(SUMMARY, msgspec.msgpack.decode(message), strict=True))
        elif kind == "post":
            post = dict(zip(POST, msgspec.msgpack.decode(message), strict=True))
            self.posts[where[0], where[1], post["kind"]] = post
        elif kind == "delta":
            self.take(where[0], *msgspec.msgpack.decode(message))

    def take(self, channel: str, until: int, sinces: list[int], claim: Any, again: bool, delta: bytes) -> None:
        header, tiles = self.decode(delta)
        robot = channel, header["robot"]
        if len(sinces) == 1:
            sinces = sinces * len(tiles)
        for (key, cells), since in zip(tiles.items(), sinces, strict=True):
            if again or since <= self.known(robot, key) < until:
                for position, stamp_ns, revision, fields in cells:
                    state = (revision, stamp_ns, tuple(sorted(fields.items())))
                    held = self.cells[robot][key].get(position)
                    self.cells[robot][key][position] = state if held is None else max(held, state)
                self.ahead[robot][key] = max(until, self.known(robot, key))
        if claim is not None and claim[1] > self.base[robot]:
            since, to, flat = claim
            needs = [((x, y), to - back) for x, y, back in zip(flat[::3], flat[1::3], flat[2::3], strict=True)]
            self.claims[robot] = since, to, needs + [(key, min(until, to)) for key in tiles]
        if robot in self.claims:
            since, to, needs = self.claims[robot]
            if self.base[robot] >= since and all(self.known(robot, key) >= least for key, least in needs):
                self.base[robot] = max(to, self.base[robot])

    def known(self, robot: tuple[str, str], key: Any) -> int:
        return max(self.base[robot], self.ahead[robot].get(key, 0))
