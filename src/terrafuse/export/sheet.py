"""Where things stand on a picture of the map, in pixels."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

MOST_PIXELS = 1400
"""Longest side of the map itself; larger ones are drawn in blocks of whole numbers of cells."""
WANTED_PIXELS, MOST_ZOOM = 1000, 64
"""Small maps are drawn with a whole number of pixels a cell, as long as the side stays within the first."""
LEAST_WIDTH = 460
"""Room for title and footer over narrow maps."""
LEFT, RIGHT, TOP, BOTTOM, LINE = 96, 110, 62, 96, 24
"""Around the map: axis, colour bar, title, footer, and a line of robots' names."""
BAR_MIN, BAR_MAX, BAR_BELOW = 160, 640, 56
"""Lengths of the colour bar; maps lower than the first have it below them, which takes the last more."""

ROBOTS = ["#e6007e", "#1565ff", "#ff9100", "#7b2ff2", "#00b8d4", "#d50000", "#64dd17", "#8d4a00", "#ff80c0", "#102a9c"]
"""Colours of paths: apart from each other and from the terrain."""
LONGEST_NAME = 28


@dataclass(frozen=True)
class Chip:
    """A robot's entry in the legend: its place right of the page's left margin, and its line below the title."""

    name: str
    colour: str
    x: int
    line: int

    @property
    def width(self) -> int:
        return 56 + 8 * len(self.name)


@dataclass(frozen=True)
class Sheet:
    """Where things are, from the lower left."""

    width: int
    height: int
    left: int
    bottom: int
    map_width: int
    map_height: int
    bar_below: bool


def legend(names: Iterable[str]) -> list[Chip]:
    """The robots in as many lines as they need."""
    chips: list[Chip] = []
    x, line = 0, 0
    for k, name in enumerate(names):
        short = name if len(name) <= LONGEST_NAME else name[: LONGEST_NAME - 1] + "…"
        chip = Chip(short, ROBOTS[k % len(ROBOTS)], x, line)
        if x and x + chip.width > MOST_PIXELS // 2:
            x, line = 0, line + 1
            chip = Chip(chip.name, chip.colour, x, line)
        chips.append(chip)
        x += chip.width
    return chips


def sheet_for(rows: int, columns: int, chips: list[Chip]) -> Sheet:
    """The page for an image of the map."""
    zoom = min(MOST_ZOOM, max(1, WANTED_PIXELS // max(rows, columns)))
    map_width, map_height = columns * zoom, rows * zoom
    bar_below = map_height < BAR_MIN
    room = max(map_width, LEAST_WIDTH, *(chip.x + chip.width for chip in chips))
    left = LEFT + (room - map_width) // 2
    right = 40 if bar_below else RIGHT
    bottom = BOTTOM + (BAR_BELOW if bar_below else 0)
    top = TOP + LINE * len({chip.line for chip in chips})
    return Sheet(LEFT + room + right, bottom + map_height + top, left, bottom, map_width, map_height, bar_below)


def round_length(most: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that is not more than `most`."""
    power = 10.0 ** math.floor(math.log10(most))
    return max(step for step in (1.0, 2.0, 5.0) if step * power <= most * (1 + 1e-9)) * power
