"""Whether two nodes that say they hold the same do: digests of what is held of a robot, tile by tile.

Revisions tell that as long as a robot never uses one twice. One that lost its memory may: it tells others who hold less
of its earlier life than some, and counts on from there. So nodes also compare contents: of robots whose nodes were
born again, or that were quiet for a while. Where the digest of all of a robot differs though the revisions are equal,
they tell each other the digests of its tiles, and send the tiles that differ; of two states of a cell the newer counts,
at both.

The digests of a robot's tiles travel as msgpack, an array of

    robot       str
    base        int: all up to this revision was held, and nothing more
    tiles       array of [x, y, digest]
"""

from __future__ import annotations

from collections.abc import Iterable
from hashlib import blake2b

import msgspec
import numpy as np

from terrafuse.errors import CodecError
from terrafuse.exchange.delta import TileCells
from terrafuse.store.base import Store
from terrafuse.types import TileKey

MOST_TILES = 1 << 16


class Digests(msgspec.Struct, array_like=True, forbid_unknown_fields=True):
    """Fields as in the module's text."""

    robot: str
    base: int
    tiles: list[tuple[int, int, int]]


encode_digests = msgspec.msgpack.Encoder().encode
_decode = msgspec.msgpack.Decoder(Digests).decode


def decode_digests(message: bytes) -> Digests:
    """Bytes → digests. Raises CodecError for anything else."""
    try:
        digests = _decode(message)
    except ValueError as error:
        raise CodecError(f"digests that can't be read: {error}") from error
    if len(digests.tiles) > MOST_TILES:
        raise CodecError(f"digests of {len(digests.tiles)} tiles; the most is {MOST_TILES}")
    return digests


def digest_of(tile: TileCells) -> int:
    """BLAKE2b, 8 bytes of digest, little endian: of x and y (int64), the positions (int32), and the records as they
    are in memory, without gaps."""
    content = blake2b(np.array([tile.key.x, tile.key.y], "<i8").tobytes(), digest_size=8)
    content.update(tile.at.astype("<i4").tobytes())
    content.update(tile.cells.tobytes())
    return int.from_bytes(content.digest(), "little")


class Contents:
    """Of what a store holds; found out tile by tile, when it is asked for."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._digests: dict[str, dict[TileKey, int]] = {}
        self._stale: dict[str, set[TileKey]] = {}

    def changed(self, robot: str, keys: Iterable[TileKey]) -> None:
        self._stale.setdefault(robot, set()).update(keys)

    @property
    def stale(self) -> list[str]:
        """Robots of which some tiles changed since they were last looked at."""
        return [robot for robot, tiles in self._stale.items() if tiles]

    def find(self, robot: str, most: int) -> int:
        """Look at so many tiles of a robot at most that changed since they were last looked at; at how many it did."""
        stale = self._stale.get(robot, set())
        some = sorted(stale)[:most]
        for key in some:
            held = self._store.load(robot, key)
            if held is not None:
                self._digests.setdefault(robot, {})[key] = digest_of(held)
            stale.discard(key)
        return len(some)

    def of(self, robot: str) -> dict[TileKey, int] | None:
        """By tile; None as long as some were not looked at."""
        return None if self._stale.get(robot) else self._digests.get(robot, {})

    def root(self, robot: str) -> int | None:
        """Of all tiles of a robot: the XOR of theirs."""
        tiles = self.of(robot)
        if tiles is None:
            return None
        root = 0
        for digest in tiles.values():
            root ^= digest
        return root
