"""The benchmark maps of movingai.com: octile maps, and problems with the lengths of their shortest ways."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from terrafuse.types import Array

FREE_GROUND = ".GS"


@dataclass(frozen=True)
class Problem:
    start: tuple[int, int]
    goal: tuple[int, int]
    length: float
    """In sides of cells."""


def read_map(path: Path) -> Array:
    """(H, W) int16 costs of free ground and obstacles; rows as in the file, which problems count from its top."""
    rows = path.read_text().split("map\n", 1)[1].split()
    return np.where(np.isin([list(row) for row in rows], list(FREE_GROUND)), 100, 0).astype(np.int16)


def read_problems(path: Path) -> list[Problem]:
    lines = [line.split() for line in path.read_text().splitlines()[1:] if line.strip()]
    return [Problem((int(f[4]), int(f[5])), (int(f[6]), int(f[7])), float(f[8])) for f in lines]


def scenarios(recordings: Path) -> Iterator[tuple[str, Array, list[Problem]]]:
    """(name, costs, problems) of each scenario file beside its map."""
    for scenario in sorted((recordings / "maps/movingai").glob("*.scen")):
        name = scenario.name.split(".map")[0].split("-random-")[0].removesuffix(".scen")
        yield name, read_map(scenario.parent / f"{name}.map"), read_problems(scenario)
