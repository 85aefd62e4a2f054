"""Whether a tile is of interest: to whom an area is."""

from __future__ import annotations

import math
import sys

from terrafuse.types import Bounds, TileKey


def meets(key: TileKey, tile_m: float, area: Bounds) -> bool:
    """Whether tile and area have more than a border in common."""
    west, south = key.x * tile_m, key.y * tile_m
    return west < area.east and area.west < west + tile_m and south < area.north and area.south < south + tile_m


def tiles_in(area: Bounds, tile_m: float) -> int:
    """How many tiles meet an area; more than there can be of one that is not finite."""
    if not all(map(math.isfinite, area)):
        return sys.maxsize
    columns = math.ceil(area.east / tile_m) - math.floor(area.west / tile_m)
    rows = math.ceil(area.north / tile_m) - math.floor(area.south / tile_m)
    return max(columns, 0) * max(rows, 0)
