"""How a layer is drawn: its colours, its range, whether light falls on it."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from terrafuse.models.base import Layer
from terrafuse.types import Floats

if TYPE_CHECKING:
    from matplotlib.colors import Colormap, Normalize

TERRAIN = ("#173340", "#1d4c50", "#2f6650", "#567f4e", "#8a954f", "#b9a95f", "#dcc083", "#f3ddae")
"""Wet lowland to pale summits; lightness rises in even steps, so that the order survives grey print and colour-blind
eyes, and ends short of white, which is kept for light."""
KINDS = ("#5b8e7d", "#c8553d", "#f2c14e", "#4d6cfa", "#8e5572", "#3c3c3c")
"""For layers that name kinds of cells."""

ROBUST = (0.02, 0.98)
"""Quantiles that the colours span: a bird or a reflection must not flatten the rest."""

Scale = Callable[[Floats], "Normalize"]
"""The known values of a layer (at least one) → which of them get which place in the colours."""


@dataclass(frozen=True)
class Look:
    colours: Callable[[], Colormap]
    scale: Scale
    shaded: bool = False
    """Whether the values are heights that light falls on."""
    named: bool = False
    """Whether the values are kinds, named in the layer's description as '1 flat, 2 vertical', or by `names`."""
    names: Mapping[int, str] | None = None
    clock: bool = False
    """Whether the values are seconds since 1970 UTC."""
    unknown: str = "#eceef1"
    """The colour of what nobody saw, which must not pass for a value."""


def look_of(layer: Layer) -> Look:
    """The look of this name, else one that suits the unit."""
    return LOOKS.get(layer.name) or (HEIGHT if layer.unit == "m" else AMOUNT)


def kinds(layer: Layer) -> dict[int, str]:
    """The kinds that a description names."""
    return {int(value): name for value, name in re.findall(r"(\d+) (\w+)", layer.description)}


def _terrain() -> Colormap:
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("terrain", TERRAIN)


def _kinds() -> Colormap:
    from matplotlib.colors import ListedColormap

    return ListedColormap(KINDS)


def _named(name: str) -> Callable[[], Colormap]:
    def colours() -> Colormap:
        import matplotlib

        return matplotlib.colormaps[name]

    return colours


def _robust(values: Floats) -> Normalize:
    from matplotlib.colors import Normalize

    low, high = (float(q) for q in np.quantile(values, ROBUST))
    if high <= low:
        low, high = low - 0.5, high + 0.5
    return Normalize(low, high)


def _whole(values: Floats) -> Normalize:
    from matplotlib.colors import BoundaryNorm

    return BoundaryNorm(np.arange(0.5, len(KINDS) + 1), len(KINDS))


def _share(values: Floats) -> Normalize:
    from matplotlib.colors import Normalize

    return Normalize(0.0, 1.0)


def _counts(values: Floats) -> Normalize:
    from matplotlib.colors import LogNorm

    return LogNorm(1.0, max(10.0, float(np.quantile(values, ROBUST[1]))))


HEIGHT = Look(_terrain, _robust, shaded=True)
AMOUNT = Look(_named("viridis"), _robust)
LOOKS: dict[str, Look] = {
    "state": Look(_kinds, _whole, named=True),
    "n": Look(_named("cividis"), _counts),
    "traversability": Look(_named("viridis"), _share),
    "dynamic": Look(_named("inferno"), _share),
    "occupancy": Look(_named("gray_r"), _share, unknown="#bcc3cc"),
    "white": Look(_named("gray_r"), _share, unknown="#bcc3cc"),
    "stamp": Look(_named("viridis"), _robust, clock=True),
}
"""Layers with a look of their own, in any model; add yours with `LOOKS["mine"] = Look(...)`."""


def painted(values: Floats, look: Look, norm: Any, bright: Floats | None) -> Any:
    """(H, W, 4) colours, see-through where unknown; `bright` is a hillshade."""
    rgba = np.asarray(look.colours()(norm(np.nan_to_num(values))))
    if bright is not None:
        rgba[..., :3] = _lit(rgba[..., :3], np.nan_to_num(bright, nan=1.0)[..., None])
    rgba[..., 3] = ~np.isnan(values)
    return rgba


def _lit(colour: Any, bright: Floats) -> Any:
    """Shadow darkens towards black, light mixes in white, so that pale summits keep their relief."""
    dark = colour * (0.4 + 0.6 * np.minimum(bright, 1.0))
    glow = 0.75 * np.clip(bright - 1.0, 0.0, 0.5)
    return dark + (1.0 - dark) * glow
