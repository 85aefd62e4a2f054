"""Which tiles of a robot's own map stay in memory. The map itself has no bounds.

A policy is a small object in the dict `WINDOWS`; `all` is the null member. Tiles that a scan touches are loaded
wherever they lie, so no window loses a point; what is outside is written out and dropped when the window moves.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from terrafuse.errors import InputError
from terrafuse.types import TileKey


class Window(Protocol):
    def move(self, east_m: float, north_m: float) -> bool:
        """The robot is here now. True if the window moved, so that tiles may have to go."""

    def holds(self, key: TileKey) -> bool:
        """Whether this tile is inside the window."""


class KeepAll:
    """Every tile stays."""

    def __init__(self, tile_m: float) -> None:
        pass

    def move(self, east_m: float, north_m: float) -> bool:
        return False

    def holds(self, key: TileKey) -> bool:
        return True


class Tiles3x3:
    """3×3 tiles around the robot, with the hysteresis of the *tiles* paper.

    The window moves only when the robot leaves its central half (0.75 tiles from the middle on either axis), and then
    centres on the robot's tile: someone who walks along a tile border, or to and fro across it, moves it once.
    """

    def __init__(self, tile_m: float) -> None:
        self._tile_m = tile_m
        self._centre: tuple[int, int] | None = None

    def move(self, east_m: float, north_m: float) -> bool:
        x, y = east_m / self._tile_m, north_m / self._tile_m
        if self._centre is not None:
            cx, cy = self._centre
            if max(abs(x - cx - 0.5), abs(y - cy - 0.5)) <= 0.75:
                return False
        self._centre = (int(x // 1), int(y // 1))
        return True

    def holds(self, key: TileKey) -> bool:
        if self._centre is None:
            return False
        return max(abs(key.x - self._centre[0]), abs(key.y - self._centre[1])) <= 1


WINDOWS: dict[str, Callable[[float], Window]] = {"all": KeepAll, "tiles3x3": Tiles3x3}


def make_window(name: str, tile_m: float) -> Window:
    if name not in WINDOWS:
        raise InputError(f"no window '{name}'; there are: {', '.join(sorted(WINDOWS))}")
    return WINDOWS[name](tile_m)
