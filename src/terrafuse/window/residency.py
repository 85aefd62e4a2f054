"""A window on its way: what each move adds and drops, and what the whole way claimed."""

from __future__ import annotations

from dataclasses import dataclass

from terrafuse.types import TileKey
from terrafuse.window.area import NOWHERE, Area
from terrafuse.window.policies import Window


@dataclass(frozen=True)
class Move:
    """What changed when the robot came to a new place."""

    resident: Area
    """All that is inside the window now."""
    added: frozenset[TileKey]
    """Inside now and not before: to be loaded, where anything is known of them."""
    dropped: frozenset[TileKey]
    """Inside before and not now."""


class Residency:
    """Follows one robot's window. `area` is what is inside it now."""

    def __init__(self, window: Window) -> None:
        self.area: Area = NOWHERE
        self.visited: set[TileKey] = set()
        """Every tile that was ever inside; none for a window without bounds."""
        self.most_tiles = 0
        """Most that were inside at once."""
        self._window = window

    def move(self, east_m: float, north_m: float) -> Move | None:
        """The robot is here now. None if the window holds what it held before."""
        area = self._window.around(east_m, north_m)
        if area is self.area or area == self.area:
            return None
        now, before = frozenset(area), frozenset(self.area)
        self.area = area
        self.visited |= now
        self.most_tiles = max(self.most_tiles, len(now))
        return Move(area, now - before, before - now)
