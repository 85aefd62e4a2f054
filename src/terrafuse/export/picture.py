"""The map as a picture: one layer in colours under a light, the robots' paths over it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from terrafuse import views
from terrafuse.errors import MissingExtra
from terrafuse.export import sheet as pixels
from terrafuse.export.files import final
from terrafuse.export.looks import Look, kinds, look_of, painted
from terrafuse.export.shade import hillshade
from terrafuse.export.sheet import Chip, Sheet
from terrafuse.lattice import Lattice
from terrafuse.models.base import Layer
from terrafuse.replica import Replica
from terrafuse.types import Bounds, Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DPI = 100
INK, QUIET, EDGE = "#22272e", "#68717d", "#b6bcc5"
SMALL: dict[str, Any] = {"fontsize": 8, "color": QUIET, "va": "center", "parse_math": False}
EXTEND = {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}
"""Which ends of the colour bar are pointed, by whether values lie below and above it."""


def write_picture(
    replica: Replica,
    path: Path | str,
    layer: str | None = None,
    bounds: Bounds | None = None,
    paths: Mapping[str, Any] | None = None,
    title: str | None = None,
) -> None:
    """Write a PNG of a layer (the model's own choice by default), over the bounds or all that is known.

    `paths`: (N, 2) east and north in metres of each robot. `title`: the layer with its unit, by default. Raises
    InputError for an empty map, OutputError where the file can't be written.
    """
    draw_subject(path, lambda: _subject(replica, layer or replica.model.picture_layer, bounds), paths, title)


def draw_subject(
    path: Path | str,
    choose: Callable[[], Subject],
    paths: Mapping[str, Any] | None = None,
    title: str | None = None,
    marks: Mapping[str, tuple[float, float]] | None = None,
) -> None:
    """Write a PNG of what `choose` gives, which is asked when it is sure that pictures can be made.

    `marks`: places with a name, east and north.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtra("a picture", "matplotlib", "plot") from error
    subject = choose()
    chips = pixels.legend(paths or {})
    sheet = pixels.sheet_for(subject.image.shape[0], subject.image.shape[1], chips)
    figure = Figure((sheet.width / DPI, sheet.height / DPI), DPI, facecolor="white")
    FigureCanvasAgg(figure)
    axes = _draw_map(figure, sheet, subject)
    for chip, track in zip(chips, (paths or {}).values(), strict=True):
        _draw_path(axes, np.asarray(track, np.float64).reshape(-1, 2), chip.colour)
    for name, place in (marks or {}).items():
        _draw_mark(axes, name, place)
    _draw_frame(figure, sheet, subject, title, chips)
    with final(path) as temporary:
        figure.savefig(temporary, format="png", dpi=DPI)


def robot_paths(replica: Replica) -> dict[str, Floats]:
    """East and north of each robot's sensor at its scans, (N, 2) metres, as the store remembers them."""
    return {
        name: np.array([point.T_world_sensor.position[:2] for point in replica.store.poses(name)]).reshape(-1, 2)
        for name in replica.robots
    }


@dataclass(frozen=True, eq=False)
class Subject:
    """What is drawn: an image [j, i] of a layer, each element the mean of `factor`×`factor` cells."""

    layer: Layer
    lattice: Lattice
    factor: int
    image: Floats
    west: float
    south: float
    look: Look
    colours: Any = None
    """(H, W, 3 or 4) to be shown instead of the values in the look's; there is no colour bar then."""

    @property
    def step_m(self) -> float:
        return self.factor * self.lattice.resolution_m

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """West, east, south, north."""
        rows, columns = self.image.shape
        return self.west, self.west + columns * self.step_m, self.south, self.south + rows * self.step_m


def _subject(replica: Replica, name: str, bounds: Bounds | None) -> Subject:
    (layer,) = views.chosen_layers(replica, [name])
    window = views.window_of(replica, bounds)
    factor = math.ceil(max(views.shape_of(window)) / pixels.MOST_PIXELS)
    image = views.reduced(replica, layer, window, factor)
    west, south = views.bounds_of(replica, window)[:2]
    return Subject(layer, replica.lattice, factor, image, west, south, look_of(layer))


def _axes(figure: Figure, sheet: Sheet, left: float, bottom: float, width: float, height: float) -> Axes:
    return figure.add_axes((left / sheet.width, bottom / sheet.height, width / sheet.width, height / sheet.height))


def _draw_map(figure: Figure, sheet: Sheet, subject: Subject) -> Axes:
    axes = _axes(figure, sheet, sheet.left, sheet.bottom, sheet.map_width, sheet.map_height)
    look, image = subject.look, subject.image
    axes.set_facecolor(look.unknown)
    values = image[~np.isnan(image)]
    if subject.colours is not None:
        axes.imshow(subject.colours, origin="lower", extent=subject.extent, interpolation="nearest", aspect="auto")
    elif len(values):
        norm = look.scale(values)
        colours = painted(image, look, norm, hillshade(image, subject.step_m) if look.shaded else None)
        axes.imshow(colours, origin="lower", extent=subject.extent, interpolation="nearest", aspect="auto")
        _draw_bar(figure, sheet, subject.layer, look, norm, values)
    axes.set_xlim(subject.extent[:2])
    axes.set_ylim(subject.extent[2:])
    _mark_metres(axes, sheet)
    return axes


def _mark_metres(axes: Axes, sheet: Sheet) -> None:
    from matplotlib.ticker import FuncFormatter, MaxNLocator

    for axis, room in ((axes.xaxis, sheet.map_width // 110), (axes.yaxis, sheet.map_height // 70)):
        axis.set_major_locator(MaxNLocator(max(1, min(8, room)), steps=[1, 2, 5, 10]))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.10g}"))
    axes.tick_params(labelsize=8, colors=QUIET, length=3)
    axes.set_xlabel("east (m)", fontsize=8, color=QUIET)
    axes.set_ylabel("north (m)", fontsize=8, color=QUIET)
    for spine in axes.spines.values():
        spine.set_color(EDGE)
        spine.set_linewidth(0.8)


def _draw_bar(figure: Figure, sheet: Sheet, layer: Layer, look: Look, norm: Any, values: Floats) -> None:
    from matplotlib.cm import ScalarMappable

    if sheet.bar_below:
        axes = _axes(figure, sheet, pixels.LEFT, 76, pixels.LEAST_WIDTH, 12)
    else:
        length = min(sheet.map_height, pixels.BAR_MAX)
        top = sheet.bottom + sheet.map_height
        axes = _axes(figure, sheet, sheet.left + sheet.map_width + 18, top - length, 14, length)
    beyond = bool(values.min() < norm.vmin), bool(values.max() > norm.vmax)
    bar = figure.colorbar(
        ScalarMappable(norm, look.colours()),
        cax=axes,
        orientation="horizontal" if sheet.bar_below else "vertical",
        extend="neither" if look.named else EXTEND[beyond],
        extendfrac=0.02,
    )
    bar.outline.set_visible(False)
    origin = math.floor(norm.vmin) if look.clock else 0
    _mark_bar(bar, layer, look, norm, origin)
    axes.tick_params(labelsize=8, colors=QUIET, length=3)
    if sheet.bar_below:
        axes.text(1.04, 0.5, _quantity(layer, look, origin), transform=axes.transAxes, **SMALL)
    else:
        away = 1 + 62 / 14
        axes.text(
            away, 0.5, _quantity(layer, look, origin), rotation=90, ha="center", transform=axes.transAxes, **SMALL
        )


def _mark_bar(bar: Any, layer: Layer, look: Look, norm: Any, origin: int) -> None:
    from matplotlib.colors import LogNorm
    from matplotlib.ticker import FuncFormatter, LogLocator

    if look.named:
        names = look.names or kinds(layer)
        limits = min(names, default=1) - 0.5, max(names, default=1) + 0.5
        (bar.ax.set_ylim if bar.orientation == "vertical" else bar.ax.set_xlim)(*limits)
        bar.set_ticks(list(names), labels=list(names.values()))
        return
    if isinstance(norm, LogNorm):
        bar.locator = LogLocator(subs=(1, 2, 5))
    bar.minorticks_off()
    bar.formatter = FuncFormatter(lambda value, _: f"{round(value - origin, 6) if look.clock else value:.7g}")
    bar.update_ticks()


def _quantity(layer: Layer, look: Look, origin: int) -> str:
    if look.clock:
        return f"{layer.name} (s after {datetime.fromtimestamp(origin, UTC):%Y-%m-%d %H:%M:%S} UTC)"
    return _with_unit(layer)


def _with_unit(layer: Layer) -> str:
    return layer.name if layer.unit == "1" else f"{layer.name} ({layer.unit.replace('m2', 'm²')})"


def _draw_path(axes: Axes, track: Floats, colour: str) -> None:
    from matplotlib.patheffects import Normal, Stroke

    casing = [Stroke(linewidth=4.0, foreground="white", alpha=0.85), Normal()]
    axes.plot(*track.T, color=colour, linewidth=2.0, solid_capstyle="round", path_effects=casing, zorder=3)
    known = track[~np.isnan(track).any(axis=1)]
    for marker, end in (("o", known[:1]), ("s", known[-1:])):
        axes.plot(
            *end.T,
            marker=marker,
            markersize=7,
            color=colour,
            markeredgecolor="white",
            markeredgewidth=1.2,
            linestyle="none",
            zorder=4,
        )


def _draw_mark(axes: Axes, name: str, place: tuple[float, float]) -> None:
    from matplotlib.patheffects import Normal, Stroke

    axes.plot(*place, marker="^", markersize=11, color=INK, markeredgecolor="white", markeredgewidth=1.5, zorder=5)
    casing = [Stroke(linewidth=3.0, foreground="white"), Normal()]
    text = axes.annotate(name, place, (9, 0), textcoords="offset points", **SMALL | {"color": INK}, zorder=5)
    text.set_path_effects(casing)


def _draw_frame(figure: Figure, sheet: Sheet, subject: Subject, title: str | None, chips: list[Chip]) -> None:
    """Title, robots, scale bar, and what the cells are."""
    page = _axes(figure, sheet, 0, 0, sheet.width, sheet.height)
    page.set_xlim(0, sheet.width)
    page.set_ylim(0, sheet.height)
    page.set_axis_off()
    layer, lattice = subject.layer, subject.lattice
    about = layer.description if title is None else f"{layer.name}: {layer.description}"
    bold = {**SMALL, "color": INK, "fontsize": 13, "fontweight": "bold"}
    page.text(pixels.LEFT, sheet.height - 24, title or _with_unit(layer), **bold)
    page.text(pixels.LEFT, sheet.height - 47, about, **SMALL)
    for chip in chips:
        _draw_chip(page, chip, sheet.height - pixels.TOP - pixels.LINE * chip.line - 14)
    metres_a_pixel = (subject.extent[1] - subject.extent[0]) / sheet.map_width
    length_m = pixels.round_length(0.25 * max(sheet.map_width, 200) * metres_a_pixel)
    right = pixels.LEFT + length_m / metres_a_pixel
    page.plot([pixels.LEFT, pixels.LEFT, right, right], [28, 22, 22, 28], color=INK, linewidth=1.4)
    page.text(right + 10, 25, f"{length_m:g} m", **{**SMALL, "color": INK, "fontsize": 9})
    drawn = f", drawn at {subject.step_m:g} m" if subject.factor > 1 else ""
    cells = f"cells of {lattice.resolution_m:g} m{drawn} · {_frame_name(lattice)}"
    page.text(sheet.width - 24, 25, cells, ha="right", **SMALL)


def _draw_chip(page: Axes, chip: Chip, y: float) -> None:
    left, right = pixels.LEFT + 4 + chip.x, pixels.LEFT + 30 + chip.x
    page.plot([left, right], [y, y], color=chip.colour, linewidth=2.5)
    for marker, x in (("o", left), ("s", right)):
        page.plot([x], [y], marker=marker, markersize=6, color=chip.colour, markeredgecolor="white")
    page.text(right + 12, y, chip.name, **{**SMALL, "color": INK, "fontsize": 9})


def _frame_name(lattice: Lattice) -> str:
    """EPSG:n; a WKT is too long to print."""
    if lattice.crs is None:
        return "local frame"
    return lattice.crs if len(lattice.crs) < 20 else "projected frame"
