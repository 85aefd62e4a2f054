"""How many cells of each tile were known when: what tells how much of a tile is new to who holds an older state."""

from __future__ import annotations

from bisect import bisect_right

import numpy as np

from terrafuse.exchange.delta import TileCells
from terrafuse.types import Array, TileKey

MOST_STEPS = 32
"""Of a tile that are remembered; the oldest go first."""


class Growth:
    """Of one robot's own map, as its changes are noted. A bit a cell."""

    def __init__(self) -> None:
        self._seen: dict[TileKey, Array] = {}
        self._steps: dict[TileKey, list[tuple[int, int]]] = {}
        """Revision, and how many cells were known then."""

    def note(self, tile: TileCells, side: int) -> None:
        """These cells of a tile of side² changed."""
        packed = self._seen.get(tile.key)
        seen = np.zeros(side * side, np.uint8) if packed is None else np.unpackbits(packed, count=side * side)
        seen[tile.at] = 1
        self._seen[tile.key] = np.packbits(seen)
        steps = self._steps.setdefault(tile.key, [])
        steps.append((int(tile.cells["revision"].max()), int(seen.sum())))
        del steps[:-MOST_STEPS]

    def unknown(self, key: TileKey, since: int) -> float | None:
        """The share of a tile's cells that were not known at revision `since`; None for a tile of which nothing was
        noted."""
        steps = self._steps.get(key)
        if not steps:
            return None
        at = bisect_right(steps, since, key=lambda step: step[0])
        before = 0 if since == 0 else steps[max(at - 1, 0)][1]
        return 1 - before / steps[-1][1]
