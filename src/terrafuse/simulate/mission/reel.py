"""Frames of a film as an animated GIF: one palette for all, so that what stays the same costs nothing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from terrafuse.errors import MissingExtra
from terrafuse.export.files import final
from terrafuse.export.looks import Look, look_of, painted
from terrafuse.export.shade import hillshade
from terrafuse.export.sheet import ROBOTS
from terrafuse.models.base import Layer
from terrafuse.types import Array, Floats

if TYPE_CHECKING:
    from PIL.Image import Image as Picture

SIDE, ENOUGH = 640, 480
"""Pixels of the map's longer side: at most so many, and a whole number a cell where that makes enough of them."""
LEAST_WIDTH, CAPTION, MARGIN = 360, 32, 10
"""Pixels: room for the caption, its height, and the space before it."""
FRAME_MS, LAST_MS = 100, 2500
PALE = 0.6
"""How much of the colour of the unknown is in what only the prior says."""
PAPER, INK = np.array([255.0, 255, 255]), np.array([34.0, 39, 46])
GREYS = 6
"""Steps from the paper to the ink."""
DOT, TRAIL, MANY = 4, 2, 20
"""Radius and width, pixels; of more robots than the last, both are smaller."""
SHARED = 255 - GREYS - len(ROBOTS)
"""Colours of the map; after them come greys and robots. One of 256 stays free: the encoder marks with it what did not
change."""


@dataclass(frozen=True, eq=False)
class Shot:
    """What one frame shows."""

    image: Callable[[], tuple[Floats, Array]]
    """The map (H, W), row 0 in the south, NaN unknown, and what of it robots saw."""
    trails: Sequence[Sequence[tuple[int, int]]]
    """Of each robot, in pixels of the drawn map from its upper left."""
    caption: str


def write_gif(path: Path | str, shots: Sequence[Shot], layer: Layer, pixel_m: float, station: tuple[int, int]) -> None:
    """Write the shots of a layer whose elements are `pixel_m` wide. Raises OutputError, MissingExtra."""
    try:
        import matplotlib  # noqa: F401
        import PIL  # noqa: F401
    except ImportError as error:
        raise MissingExtra("a film", "matplotlib and pillow", "plot") from error
    first, *others = _drawn(shots, _Paint(look_of(layer), shots[-1], pixel_m), station)
    with final(path) as temporary:
        first.save(
            temporary, "GIF", save_all=True, append_images=others, loop=0, disposal=1, optimize=True,
            duration=[FRAME_MS] * len(others) + [LAST_MS],
        )  # fmt: skip


class _Paint:
    """A layer's colours, on the scale of what robots saw in the end, or of all that is known if they saw nothing."""

    def __init__(self, look: Look, last: Shot, pixel_m: float) -> None:
        values, seen = last.image()
        known = np.isfinite(values)
        some = values[known & seen if (known & seen).any() else known]
        self._look, self._pixel_m = look, pixel_m
        self._norm = look.scale(some if len(some) else np.zeros(1))
        self._unknown = np.array(_rgb(look.unknown))

    def __call__(self, values: Floats, seen: Array) -> Picture:
        from PIL import Image

        bright = hillshade(values, self._pixel_m) if self._look.shaded else None
        full = 255 * painted(values, self._look, self._norm, bright)[..., :3]
        own = np.where(seen[..., None], full, (1 - PALE) * full + PALE * self._unknown)
        colours = np.where(np.isfinite(values)[..., None], own, self._unknown)
        return Image.fromarray(np.round(colours).clip(0, 255).astype(np.uint8)[::-1])


def _drawn(shots: Sequence[Shot], paint: _Paint, station: tuple[int, int]) -> list[Picture]:
    shared = _shared_palette([paint(*shot.image()) for shot in (shots[0], shots[-1])])
    own = [PAPER + (INK - PAPER) * k / (GREYS - 1) for k in range(GREYS)] + [np.array(_rgb(name)) for name in ROBOTS]
    held = shared.getpalette() or []
    palette = held + [0] * (3 * SHARED - len(held)) + [round(part) for colour in own for part in colour]
    return [_frame(shot, paint(*shot.image()), shared, palette, station) for shot in shots]


def _shared_palette(pictures: Sequence[Picture]) -> Picture:
    """An image of the SHARED colours that suit these best."""
    from PIL import Image

    return Image.fromarray(np.concatenate([np.asarray(picture) for picture in pictures])).quantize(SHARED)


def _frame(shot: Shot, picture: Picture, shared: Picture, palette: list[int], station: tuple[int, int]) -> Picture:
    from PIL import Image, ImageDraw

    index = _scaled(np.asarray(picture.quantize(palette=shared, dither=Image.Dither.NONE)))
    rows, columns = index.shape
    canvas = np.full((rows + CAPTION, max(columns, LEAST_WIDTH)), SHARED, np.uint8)
    canvas[rows:] = SHARED + _caption(shot.caption, canvas.shape[1])
    field = Image.fromarray(index)
    field.putpalette(palette)
    _draw_robots(ImageDraw.Draw(field), shot.trails, station)
    left = (canvas.shape[1] - columns) // 2
    canvas[:rows, left : left + columns] = np.asarray(field)
    out = Image.fromarray(canvas)
    out.putpalette(palette)
    return out


def scale_of(shape: tuple[int, ...]) -> float:
    """Drawn pixels an element of a map (H, W)."""
    side = max(shape)
    whole = SIDE // side
    return float(whole) if whole * side >= ENOUGH else SIDE / side


def _scaled(index: Array) -> Array:
    """The nearest element at each drawn pixel."""
    scale = scale_of(index.shape)
    down, right = ((np.arange(round(scale * side)) / scale).astype(np.int64) for side in index.shape)
    return np.ascontiguousarray(index[np.ix_(down, right)])


def _draw_robots(draw: Any, trails: Sequence[Sequence[tuple[int, int]]], station: tuple[int, int]) -> None:
    paper, ink = SHARED, SHARED + GREYS - 1
    dot, width = (DOT, TRAIL) if len(trails) <= MANY else (DOT - 2, 1)
    for robot, trail in enumerate(trails):
        draw.line([*trail, trail[-1]], fill=_own(robot), width=width)
    x, y = station
    draw.polygon([(x - 8, y + 6), (x + 8, y + 6), (x, y - 9)], fill=paper)
    draw.polygon([(x - 5, y + 4), (x + 5, y + 4), (x, y - 6)], fill=ink)
    for robot, trail in enumerate(trails):
        x, y = trail[-1]
        draw.ellipse([x - dot - 2, y - dot - 2, x + dot + 2, y + dot + 2], fill=paper)
        draw.ellipse([x - dot, y - dot, x + dot, y + dot], fill=_own(robot))


def _own(robot: int) -> int:
    return SHARED + GREYS + robot % len(ROBOTS)


def _caption(text: str, width: int) -> Array:
    """(CAPTION, width): each pixel's grey, 0 paper."""
    from PIL import Image, ImageDraw, ImageFont

    strip = Image.new("L", (width, CAPTION), 0)
    ImageDraw.Draw(strip).text((MARGIN, CAPTION // 2), text, 255, ImageFont.truetype(_font(), 15), anchor="lm")
    return np.round(np.asarray(strip) * ((GREYS - 1) / 255)).astype(np.uint8)


def _font() -> str:
    import matplotlib

    return f"{matplotlib.get_data_path()}/fonts/ttf/DejaVuSans.ttf"


def _rgb(name: str) -> tuple[float, float, float]:
    """#rrggbb → 0 to 255."""
    red, green, blue = (float(int(name[k : k + 2], 16)) for k in (1, 3, 5))
    return red, green, blue
