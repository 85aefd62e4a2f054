"""Sets of tiles that windows are made of: rows of neighbours, so that a window costs a few numbers a row."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from terrafuse.types import TileKey

SLACK_TILES = 1e-9
"""A disc is taken larger by this, so that rounding never leaves out a tile that it just meets."""


@dataclass(frozen=True)
class Area:
    """Tiles of the finest level: row `south + k` holds those from `rows[k][0]` up to, not including, `rows[k][1]`."""

    south: int
    rows: tuple[tuple[int, int], ...]

    def __contains__(self, key: TileKey) -> bool:
        k = key.y - self.south
        return key.level == 0 and 0 <= k < len(self.rows) and self.rows[k][0] <= key.x < self.rows[k][1]

    def __iter__(self) -> Iterator[TileKey]:
        return (TileKey(x, self.south + k) for k, (west, east) in enumerate(self.rows) for x in range(west, east))

    def __len__(self) -> int:
        return sum(east - west for west, east in self.rows)


class Everywhere(Area):
    """All tiles there are. It has no end, so iterating over it names none."""

    def __contains__(self, key: TileKey) -> bool:
        return True


NOWHERE = Area(0, ())
EVERYWHERE = Everywhere(0, ())


def rectangle(west: int, south: int, east: int, north: int) -> Area:
    """Tiles from (west, south) up to, not including, (east, north)."""
    return Area(south, ((west, east),) * (north - south))


def disc(x: float, y: float, radius: float) -> Area:
    """The tiles that a closed disc meets; centre and radius in tile sides."""
    radius += SLACK_TILES * max(1.0, abs(x), abs(y))
    south = math.floor(y - radius)
    rows = (_chord(x, _gap(y, row), radius) for row in range(south, math.floor(y + radius) + 1))
    return Area(south, tuple(rows))


def _gap(y: float, row: int) -> float:
    """How far y lies from the row [row, row + 1]."""
    return max(row - y, 0.0, y - row - 1)


def _chord(x: float, gap: float, radius: float) -> tuple[int, int]:
    half = math.sqrt(max(0.0, radius * radius - gap * gap))
    return math.floor(x - half), math.floor(x + half) + 1
