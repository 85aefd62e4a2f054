"""Which tiles of a robot's own map stay in memory. The map itself has no bounds.

A policy is a small object in the dict `WINDOWS`; `all` is the null member. Tiles that a scan touches are loaded
wherever they lie, so no window loses a point; what is outside is written out and dropped when the window moves.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from inspect import signature

from terrafuse.errors import InputError
from terrafuse.lattice import Lattice
from terrafuse.query import split_query
from terrafuse.window.allocation import Allocation
from terrafuse.window.area import EVERYWHERE, Area, disc, rectangle
from terrafuse.window.policies import Centred, KeepAll, NineBlock, Radius, Tiles3x3, Window
from terrafuse.window.residency import Residency

WINDOWS: dict[str, Callable[..., Window]] = {
    "all": KeepAll,
    "centred": Centred,
    "nine_block": NineBlock,
    "radius": Radius,
    "tiles3x3": Tiles3x3,
}
"""By name: `make(lattice, key=number, …)`. Add your own with `WINDOWS["mine"] = Mine`."""


def make_window(text: str, lattice: Lattice) -> Window:
    """The window that `NAME?key=number&key=number` asks for. Raises InputError for what there is none of."""
    name, options = split_query(text)
    if name not in WINDOWS:
        raise InputError(f"no window '{name}'; there are: {', '.join(sorted(WINDOWS))}")
    return WINDOWS[name](lattice, **_options(name, options))


def _options(name: str, options: Mapping[str, str]) -> dict[str, float]:
    takes = list(signature(WINDOWS[name]).parameters)[1:]
    for key in options:
        if key not in takes:
            raise InputError(f"window {name}: there is no option '{key}'; it takes: {', '.join(takes) or 'none'}")
    return {key: _number(name, key, value) for key, value in options.items()}


def _number(name: str, key: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError(f"window {name}: {key}={text}: give a number, as in '{name}?{key}=8'") from None


__all__ = [
    "EVERYWHERE", "WINDOWS", "Allocation", "Area", "Centred", "KeepAll", "NineBlock", "Radius", "Residency",
    "Tiles3x3", "Window", "disc", "make_window", "rectangle",
]  # fmt: skip
