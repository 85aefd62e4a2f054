"""Seconds as text → nanoseconds, and what a file's name says of its time and order."""

from __future__ import annotations

import re
from decimal import Decimal, InvalidOperation
from pathlib import Path

from terrafuse.logs.options import NS
from terrafuse.types import Stamp

LAST_STAMP = 2**63
"""Stamps are kept in int64 arrays."""


def seconds_to_ns(text: str) -> Stamp:
    """Exact, since floats of seconds since 1970 are good to 0.2 µs only and equal stamps would not meet.

    Raises ValueError.
    """
    try:
        stamp = Decimal(text) * NS
    except InvalidOperation:
        stamp = Decimal("NaN")
    if not (stamp.is_finite() and abs(stamp) < LAST_STAMP):
        raise ValueError(f"'{text}' is not a number of seconds")
    return int(stamp.to_integral_value())


def in_seconds(stamp_ns: Stamp) -> str:
    """For messages: all nine digits, as they stand in the file."""
    sign, ns = ("-", -stamp_ns) if stamp_ns < 0 else ("", stamp_ns)
    return f"{sign}{ns // NS}.{ns % NS:09d}"


def stamp_of_name(stem: str) -> Stamp | None:
    """The time in a name like 1305031102.175304 (s), 1305031102 (s) or 315966265259836000 (ns), else None.

    Whole numbers of other lengths are frame numbers (000012), or milli- or microseconds: not told apart.
    """
    if re.fullmatch(r"\d+\.\d+", stem) or re.fullmatch(r"\d{9,10}", stem):
        return seconds_to_ns(stem)
    return int(stem) if re.fullmatch(r"\d{18,19}", stem) else None


def natural_order(path: Path) -> list[tuple[int, str]]:
    """Sort key: numbers in names count as numbers, so scan_2 comes before scan_10."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.name)]
