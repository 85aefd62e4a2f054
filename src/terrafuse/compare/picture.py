"""Where two maps differ, as a picture on A's cells."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from terrafuse import crs
from terrafuse.compare.figures import FREE, OCCUPIED, UNKNOWN
from terrafuse.compare.run import Overlay, Question, kinds_of
from terrafuse.compare.sources import VALUES
from terrafuse.errors import InputError
from terrafuse.export import sheet as pixels
from terrafuse.export.looks import Look
from terrafuse.export.picture import Subject, draw_subject
from terrafuse.folders import folder_for
from terrafuse.grids import Grid
from terrafuse.lattice import Lattice
from terrafuse.models.base import Layer
from terrafuse.types import Array, Floats

if TYPE_CHECKING:
    from matplotlib.colors import Colormap, Normalize

NAME = "difference.png"
MOST = 0.98
"""Quantile of the distances at which the colours end."""
AGREEMENT = ("#cfe3d4", "#4a5560", "#7fb0e6", "#f2a541", "#d7263d")
"""Both free, both occupied, only A, only B, differ: what agrees is quiet. Of a block of cells the last counts."""
EMPTY = "#8f98a3"
"""Dark enough that a difference of nothing, which is white, stands out from where there is none."""
BOTH_FREE, BOTH_OCCUPIED, ONLY_A, ONLY_B, DIFFER = range(1, 6)
NAMES = {BOTH_FREE: "free", BOTH_OCCUPIED: "occupied", ONLY_A: "only A", ONLY_B: "only B", DIFFER: "differ"}


@dataclass(frozen=True)
class Way:
    """How a kind of comparison is drawn: what each cell shows, NaN nothing, and how a block of cells becomes one."""

    shown: Callable[[Floats, Floats, Question], Floats]
    block: Callable[[Floats, int], Floats]
    look: Look
    layer: Callable[[Overlay], Layer]


def draw(overlay: Overlay, kind: str, question: Question, path: Path) -> Path:
    """Write the picture, into `path` if that is a folder or has no ending; returns the file.

    Raises InputError where A's elements are no metric squares, OutputError where the file can't be written.
    """
    file = path if path.suffix.lower() == ".png" and not path.is_dir() else path / NAME
    if path.suffix and file.parent == path and not path.is_dir():
        raise InputError(f"{path}: give a .png, or a folder")
    with folder_for(file.parent):
        draw_subject(file, lambda: _subject(overlay, WAYS[kind], question), title=f"{overlay.a.quantity} compared")
    return file


def _subject(overlay: Overlay, way: Way, question: Question) -> Subject:
    wide, high = overlay.grid.sides_m
    if not math.isclose(wide, high, rel_tol=1e-6):
        raise InputError(f"A's pixels are {wide:g} × {high:g} and no squares; for a picture give it second")
    frame = None if overlay.grid.crs is None else crs.canonical(overlay.grid.crs)
    near = replace(overlay, grid=_trimmed(overlay, way, question))
    factor = math.ceil(max(near.grid.rows, near.grid.columns) / pixels.MOST_PIXELS)
    strips = near.strips(factor)
    image = np.concatenate([way.block(way.shown(a, b, question), factor) for _rows, a, b in strips])
    west, south = near.grid.bounds[:2]
    # Blocks count from the north: the last one may reach further south than the cells.
    south -= (-near.grid.rows % factor) * high
    return Subject(way.layer(overlay), Lattice(wide, 100 * wide, frame), factor, image[::-1], west, south, way.look)


def _trimmed(overlay: Overlay, way: Way, question: Question) -> Grid:
    """The part of the overlay's grid in which there is something to show."""
    grid = overlay.grid
    rows, columns = np.zeros(grid.rows, bool), np.zeros(grid.columns, bool)
    for part, a, b in overlay.strips():
        something = ~np.isnan(way.shown(a, b, question))
        rows[part] = something.any(axis=1)
        columns |= something.any(axis=0)
    (row, last_row), (column, last_column) = (np.flatnonzero(line)[[0, -1]].tolist() for line in (rows, columns))
    return grid.part(row, column, last_row + 1, last_column + 1)


def _difference(a: Floats, b: Floats, _: Question) -> Floats:
    return a - b


def _agreement(a: Floats, b: Floats, question: Question) -> Floats:
    kinds_a, kinds_b = kinds_of(a, question), kinds_of(b, question)
    known_a, known_b = kinds_a != UNKNOWN, kinds_b != UNKNOWN
    cases = [
        (known_a & known_b & (kinds_a != kinds_b), DIFFER),
        (known_a & ~known_b, ONLY_A),
        (known_b & ~known_a, ONLY_B),
        (kinds_a == OCCUPIED, BOTH_OCCUPIED),
        (kinds_a == FREE, BOTH_FREE),
    ]
    return np.select([mask for mask, _ in cases], [float(kind) for _, kind in cases], np.nan)


def _blocks(values: Floats, factor: int) -> Array:
    """(H', W', factor²), filled up with NaN."""
    rows, columns = values.shape
    full = np.pad(values, ((0, -rows % factor), (0, -columns % factor)), constant_values=np.nan)
    cut = full.reshape(full.shape[0] // factor, factor, -1, factor)
    return cut.transpose(0, 2, 1, 3).reshape(cut.shape[0], cut.shape[2], factor**2)


def _mean(values: Floats, factor: int) -> Floats:
    blocks = _blocks(values, factor)
    count = (~np.isnan(blocks)).sum(axis=2)
    return np.where(count, np.nansum(blocks, axis=2) / np.maximum(count, 1), np.nan)


def _last(values: Floats, factor: int) -> Floats:
    last = np.nan_to_num(_blocks(values, factor)).max(axis=2)
    return np.where(last > 0, last, np.nan)


def _red_and_blue() -> Colormap:
    import matplotlib

    return matplotlib.colormaps["RdBu_r"]


def _even(values: Floats) -> Normalize:
    from matplotlib.colors import Normalize

    most = float(np.quantile(np.abs(values), MOST)) or float(np.abs(values).max()) or 1.0
    return Normalize(-most, most)


def _five() -> Colormap:
    from matplotlib.colors import ListedColormap

    return ListedColormap(AGREEMENT)


def _whole(_: Floats) -> Normalize:
    from matplotlib.colors import BoundaryNorm

    return BoundaryNorm(np.arange(0.5, len(AGREEMENT) + 1), len(AGREEMENT))


def _of_no_cells(*_: object) -> Floats:
    raise TypeError("how two maps differ can't be computed from the cells of one")


def _layer_of_values(overlay: Overlay) -> Layer:
    return Layer("A − B", overlay.a.unit, _names(overlay), _of_no_cells)


def _layer_of_kinds(overlay: Overlay) -> Layer:
    return Layer("agreement", "1", f"of free and occupied; {_names(overlay)}", _of_no_cells)


def _names(overlay: Overlay) -> str:
    return f"A: {overlay.a.name}, B: {overlay.b.name}"


WAYS = {
    VALUES: Way(_difference, _mean, Look(_red_and_blue, _even, unknown=EMPTY), _layer_of_values),
    "occupancy": Way(_agreement, _last, Look(_five, _whole, named=True, names=NAMES), _layer_of_kinds),
}
