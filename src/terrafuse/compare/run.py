"""Two maps laid upon each other: B is looked up at the centres of A's cells."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from terrafuse.compare import figures
from terrafuse.compare.figures import FREE, OCCUPIED, UNKNOWN
from terrafuse.compare.sources import OCCUPANCY, RASTER, STORE, VALUES, Field, Source, open_source
from terrafuse.errors import InputError
from terrafuse.grids import ON_BORDER, Grid, bounds_in, transformed
from terrafuse.types import Array, Bounds, Floats

STRIP_CELLS = 2**20
MAX_CELLS = 10**9
"""More are minutes of looking at what is mostly empty."""


@dataclass(frozen=True)
class Question:
    """What is compared, and where. None leaves it to the maps."""

    layer: str | None = None
    band: str | None = None
    bounds: Bounds | None = None
    occupied_thresh: float = 0.65
    free_thresh: float = 0.196

    def __post_init__(self) -> None:
        if not 0 <= self.free_thresh < self.occupied_thresh <= 1:
            raise InputError(f"thresholds {self.free_thresh} and {self.occupied_thresh}: give 0 ≤ free < occupied ≤ 1")


@dataclass(frozen=True, eq=False)
class Overlay:
    """Two fields, and the grid of A's elements, as far as both reach or as the question bounds it."""

    a: Field
    b: Field
    grid: Grid

    def strips(self, whole: int = 1) -> Iterator[tuple[slice, Floats, Floats]]:
        """(rows, A, B) of strips of the grid, NaN where unknown; all but the last have a multiple of `whole` rows."""
        rows = max(1, STRIP_CELLS // self.grid.columns // whole) * whole
        for first in range(0, self.grid.rows, rows):
            last = min(first + rows, self.grid.rows)
            x, y = self.grid.centres(first, last)
            yield (
                slice(first, last),
                looked_up(self.a, x, y),
                looked_up(self.b, *transformed(x, y, self.a.grid.crs, self.b.grid.crs)),
            )


def looked_up(field: Field, x: Floats, y: Floats) -> Floats:
    """The values of the elements in which places (…) lie, NaN outside."""
    row, column, inside = field.grid.locate(x, y)
    return np.where(inside, field.values[row, column], np.nan)


def compare_maps(
    a: Path | str, b: Path | str, question: Question | None = None, picture: Path | str | None = None
) -> dict[str, Any]:
    """How A differs from B, as plain JSON; with `picture`, a PNG (or a folder for difference.png) shows where.

    Raises InputError where the two have nothing in common.
    """
    asked = question or Question()
    first, second = open_source(Path(a)), open_source(Path(b))
    check_asked(first, second, asked)
    kind = kind_of(first, second, asked)
    field_a, field_b = (source.field(kind, asked.layer, asked.band) for source in (first, second))
    overlay = laid_upon(field_a, field_b, asked.bounds)
    result = {
        "kind": kind,
        "a": {"map": str(a), "what": field_a.what},
        "b": {"map": str(b), "what": field_b.what},
        "bounds": list(overlay.grid.bounds),
        "remarks": remarks_on(overlay),
        **(value_result if kind == VALUES else occupancy_result)(overlay, asked),
    }
    if picture is not None:
        from terrafuse.compare.picture import draw

        result["picture"] = str(draw(overlay, kind, asked, Path(picture)))
    return result


def check_asked(a: Source, b: Source, asked: Question) -> None:
    """Raise InputError where neither map has what is asked for: to be told so is better than another comparison."""
    kinds = f"A is a {a.what}, B a {b.what}"
    if asked.band is not None and RASTER not in (a.what, b.what):
        raise InputError(f"--band {asked.band}: {kinds}; only rasters have bands" + _or_layer(a, b))
    if asked.layer is not None and STORE not in (a.what, b.what) and asked.layer not in a.names + b.names:
        known = ", ".join(filter(None, dict.fromkeys(a.names + b.names)))
        has = f"their bands are: {known}" if known else "only stores have layers"
        raise InputError(f"--layer {asked.layer}: {kinds}; {has}")


def _or_layer(a: Source, b: Source) -> str:
    return ": choose a --layer" if STORE in (a.what, b.what) else ""


def kind_of(a: Source, b: Source, asked: Question) -> str:
    """Occupancy where one of the two is a ROS map, or a store or raster of such a model; else, and where a layer of
    these is asked for, or the band of two rasters, values."""
    if a.only_occupancy or b.only_occupancy:
        return OCCUPANCY
    chosen = asked.layer is not None or (asked.band is not None and a.what == b.what == RASTER)
    return OCCUPANCY if not chosen and OCCUPANCY in (a.natural, b.natural) else VALUES


def laid_upon(a: Field, b: Field, bounds: Bounds | None) -> Overlay:
    """The overlay on A's elements, of everything that either covers, or of the bounds."""
    if not a.grid.straight:
        raise InputError(f"A ({a.what}) is turned; give it second: its values are looked up at the other's cells")
    if a.grid.crs is None or b.grid.crs is None or a.grid.crs == b.grid.crs:
        reach = b.grid.bounds
    else:
        reach = bounds_in(b.grid, a.grid.crs)
    own = a.grid.bounds
    if not _meet(own, reach):
        raise InputError(
            f"A and B have no place in common: A covers {_text(own)}, B {_text(reach)}; are both in one frame?"
        )
    whole = own.union(reach) if bounds is None else bounds
    if bounds is not None and not (_meet(bounds, own) and _meet(bounds, reach)):
        raise InputError(f"the bounds {_text(bounds)} hold nothing of both: A covers {_text(own)}, B {_text(reach)}")
    grid = _extended(a.grid, whole)
    if grid.rows * grid.columns > MAX_CELLS:
        raise InputError(f"A and B cover {grid.columns}×{grid.rows} of A's cells; look at a part, with --bounds")
    return Overlay(a, b, grid)


def _meet(one: Bounds, other: Bounds) -> bool:
    return one.west < other.east and other.west < one.east and one.south < other.north and other.south < one.north


def _text(bounds: Bounds) -> str:
    return ",".join(f"{value:.10g}" for value in bounds)


def _extended(grid: Grid, bounds: Bounds) -> Grid:
    """The elements of a straight grid, continued as far as need be, whose centres lie within bounds."""
    a, _, west, _, e, north = grid.affine
    first, last = (int(np.ceil((edge - west) / a - 0.5 - ON_BORDER)) for edge in (bounds.west, bounds.east))
    top, bottom = (int(np.ceil((edge - north) / e - 0.5 - ON_BORDER)) for edge in (bounds.north, bounds.south))
    if last <= first or bottom <= top:
        raise InputError(f"the bounds {_text(bounds)} hold the centre of no cell of A")
    return grid.part(top, first, bottom, last)


def remarks_on(overlay: Overlay) -> list[str]:
    """What a reader of the figures must know."""
    a, b = overlay.a.grid, overlay.b.grid
    out = []
    if not _same_elements(a, b):
        out.append("the cells differ: B is looked up at the centres of A's cells, the nearest value")
    if a.crs is not None and b.crs is not None and a.crs != b.crs:
        out.append("the CRS differ: places of A are brought to B's; heights are compared as they are")
    elif (a.crs is None) != (b.crs is None):
        out.append(f"{'A' if a.crs is None else 'B'} names no CRS: its coordinates are taken to be in the other's")
    if overlay.a.unit != overlay.b.unit:
        out.append(f"units differ: A in {overlay.a.unit}, B in {overlay.b.unit}; numbers are compared as they are")
    return out


def _same_elements(a: Grid, b: Grid) -> bool:
    if a.crs != b.crs and None not in (a.crs, b.crs):
        return False
    (wide, _, west, _, high, north), (wide_b, turn, west_b, turn_b, high_b, north_b) = a.affine, b.affine
    if turn or turn_b or abs(wide - wide_b) > 1e-9 * wide or abs(high - high_b) > -1e-9 * high:
        return False
    off = (west - west_b) / wide, (north - north_b) / high
    return all(abs(value - round(value)) <= ON_BORDER for value in off)


def value_result(overlay: Overlay, _: Question) -> dict[str, Any]:
    count_a = count_b = 0
    differences = []
    for _rows, a, b in overlay.strips():
        known_a, known_b = ~np.isnan(a), ~np.isnan(b)
        count_a, count_b = count_a + int(known_a.sum()), count_b + int(known_b.sum())
        differences.append((a - b)[known_a & known_b])
    both = sum(map(len, differences))
    if not both:
        raise InputError(f"no cell is known in both: A knows {count_a:,}, B {count_b:,}")
    return {
        "unit": overlay.a.unit,
        **figures.coverage(count_a, count_b, both, overlay.grid.rows * overlay.grid.columns),
        **figures.value_figures(np.concatenate(differences)),
    }


def occupancy_result(overlay: Overlay, question: Question) -> dict[str, Any]:
    table = np.zeros((3, 3), np.int64)
    for _rows, a, b in overlay.strips():
        table += figures.counts(*(kinds_of(values, question) for values in (a, b)))
    both = int(table[:UNKNOWN, :UNKNOWN].sum())
    if not both:
        raise InputError("no cell is known to be free or occupied in both")
    known_a, known_b = int(table[:UNKNOWN].sum()), int(table[:, :UNKNOWN].sum())
    return {
        "thresholds": {"occupied": question.occupied_thresh, "free": question.free_thresh},
        **figures.coverage(known_a, known_b, both, int(table.sum())),
        **figures.occupancy_figures(table),
    }


def kinds_of(values: Floats, question: Question) -> Array:
    low, high = np.nanmin(values, initial=0.0), np.nanmax(values, initial=1.0)
    if low < 0 or high > 1:
        raise InputError(f"values from {low:g} to {high:g} are no probabilities; choose a --layer or --band of 0 to 1")
    return figures.kinds(values, question.occupied_thresh, question.free_thresh)


__all__ = ["FREE", "OCCUPIED", "Overlay", "Question", "compare_maps", "laid_upon"]
