"""Whether a tile is of interest: to whom an area is."""

from __future__ import annotations

from terrafuse.types import Bounds, TileKey


def meets(key: TileKey, tile_m: float, area: Bounds) -> bool:
    """Whether tile and area have more than a border in common."""
    west, south = key.x * tile_m, key.y * tile_m
    return west < area.east and area.west < west + tile_m and south < area.north and area.south < south + tile_m
