"""A window on its way: what is inside it now, and what the whole way claimed."""

from __future__ import annotations

from terrafuse.types import TileKey
from terrafuse.window.area import NOWHERE, Area
from terrafuse.window.policies import Window


class Residency:
    """Follows one robot's window. `area` is what is inside it now."""

    def __init__(self, window: Window) -> None:
        self.area: Area = NOWHERE
        self.visited: set[TileKey] = set()
        """Every tile that was ever inside; none for a window without bounds."""
        self.most_tiles = 0
        """Most that were inside at once."""
        self._window = window

    def move(self, east_m: float, north_m: float) -> bool:
        """The robot is here now. Returns whether the window holds other tiles than before."""
        area = self._window.around(east_m, north_m)
        if area is self.area or area == self.area:
            return False
        self.area = area
        self.visited.update(area)
        self.most_tiles = max(self.most_tiles, len(area))
        return True
