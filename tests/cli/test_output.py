"""How the program tells what it does while it does it."""

from __future__ import annotations

import subprocess
import sys

import pytest

from terrafuse.cli.output import Lines, count_text, rate_text


@pytest.mark.parametrize(
    ("count", "text"),
    [(0.0, "0 "), (740.4, "740 "), (9_999, "9,999 "), (45_300, "45 k "), (999_400, "999 k "), (1_250_000, "1.2 M ")],
)
def test_counts_have_a_unit_that_suits_them(count: float, text: str) -> None:
    assert count_text(count) == text
    assert rate_text(count) == f"{text}points/s"


def test_a_line_for_each_robot_every_five_seconds() -> None:
    """Started at 0. r1 at 1 and 5 s, r2 at 6, r1 at 7 and 10.5: said at 5, 6 and 10.5; 10,500 points in that are 1,000
    a second."""
    times = iter([0.0, 1.0, 5.0, 6.0, 7.0, 10.5, 11.0])
    lines: list[str] = []
    tell = Lines(lines.append, lambda: next(times))
    tell("r1", 1, 40, 100)
    tell("r1", 10, 40, 5_000)
    tell("r2", 9, None, 60_000_000)
    tell("r1", 12, 40, 6_000)
    tell("r1", 20, 40, 10_500)
    tell.stage("raster")
    assert lines == [
        "r1: 10 of 40 done, 1,000 points/s",
        "r2: 9 done, 10.0 M points/s",
        "r1: 20 of 40 done, 1,000 points/s",
        "raster …",
    ]


def test_what_is_quick_is_not_spoken_of() -> None:
    times = iter([0.0, 1.0, 2.0])
    lines: list[str] = []
    tell = Lines(lines.append, lambda: next(times))
    tell("r1", 40, 40, 100)
    tell.stage("raster")
    assert lines == []


def test_compiling_is_told_once() -> None:
    code = (
        "import numba; from terrafuse.cli.output import tell_of_compiling as tell; tell(); tell(); print('ready');"
        "[numba.njit(f)(1) for f in (lambda x: x + 1, lambda x: x + 2)]"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout == "ready\n"
    assert ran.stderr == "compiling kernels, once; this can take a minute\n"
