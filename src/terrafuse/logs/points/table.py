"""Points as text: .csv, .txt, .xyz; commas, semicolons, tabs or spaces; with or without a header line."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TextIO

import numpy as np

from terrafuse.errors import LogError
from terrafuse.logs.points.columns import need_xyz
from terrafuse.types import Array

LOOK_AHEAD = 100


@dataclass(frozen=True)
class Layout:
    """`columns` are those of x, y, z; `skip` lines come before the first point."""

    delimiter: str | None
    columns: list[int]
    skip: int


def is_table(path: Path) -> bool:
    """Whether the first lines look like points, not prose: .txt and .csv may be anything."""
    try:
        _layout(path)
    except (LogError, OSError):
        return False
    return True


def read_table(path: Path) -> Array:
    """Columns named x, y, z (any case), else the first three; float64. Raises LogError naming the file."""
    layout = _layout(path)
    try:
        with path.open(encoding="utf-8-sig", errors="replace") as lines:
            return np.loadtxt(
                lines,
                delimiter=layout.delimiter,
                usecols=layout.columns,
                skiprows=layout.skip,
                ndmin=2,
                comments="#",
            )
    except ValueError as error:
        raise LogError(f"{path}: {error}; each line needs the same columns of numbers") from None


def _layout(path: Path) -> Layout:
    with path.open(encoding="utf-8-sig", errors="replace") as lines:
        return _layout_of(lines, path)


def _layout_of(lines: TextIO, path: Path) -> Layout:
    for skip, line in enumerate(islice(lines, LOOK_AHEAD)):
        delimiter = next((mark for mark in ",;" if mark in line), None)
        words = line.strip().strip(",;").split(delimiter)
        if _numeric(words):
            if len(words) < 3:
                raise LogError(f"{path}: {len(words)} columns; points need x, y, z")
            return Layout(delimiter, [0, 1, 2], skip)
        names = [
            word.strip(" \r\n#/\"'").lower() for word in line.replace("#", " ").replace("//", " ").split(delimiter)
        ]
        if {"x", "y", "z"} <= set(names):
            return Layout(_next_delimiter(lines, delimiter), need_xyz(names, path), skip + 1)
        if line.strip() and not line.lstrip().startswith(("#", "//")):
            need_xyz(names, path)
    raise LogError(f"{path}: no line of numbers among the first {LOOK_AHEAD}; points need x, y, z")


def _next_delimiter(lines: TextIO, of_header: str | None) -> str | None:
    """CloudCompare heads its space-separated files with a comma-separated line."""
    line = next(lines, "")
    return next((mark for mark in ",;" if mark in line), None) if line else of_header


def _numeric(words: list[str]) -> bool:
    try:
        return bool([float(word) for word in words])
    except ValueError:
        return False
