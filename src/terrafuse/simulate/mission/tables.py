"""Tables that missions leave behind: plain values, and the one place where these become HTML and Markdown."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any, TypeVar

from terrafuse.export.page import Number, section
from terrafuse.export.page import table as html_table

Row = TypeVar("Row")
Cell = str | int | float | None
"""None is shown as a dash: not measured, or does not apply."""
NONE = "–"


@dataclass(frozen=True)
class Table:
    """Headings over rows of as many cells; a row's first cell names it."""

    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    note: str = ""
    """What the numbers are, and what they are held against."""

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.headings):
                raise ValueError(f"table '{self.title}': {len(row)} cells in {row}, {len(self.headings)} headings")

    def as_json(self) -> dict[str, Any]:
        return {"title": self.title, "headings": [*self.headings], "rows": [[*row] for row in self.rows],
                "note": self.note}  # fmt: skip


def from_json(plain: Any) -> Table:
    """The table of `as_json`."""
    return Table(plain["title"], tuple(plain["headings"]), tuple(map(tuple, plain["rows"])), plain["note"])


def moments(rows: Sequence[Row], most: int) -> list[Row]:
    """At most so many of the rows, evenly spread, the first and the last among them."""
    return [rows[k] for k in sorted({round(k * (len(rows) - 1) / (most - 1)) for k in range(most)})] if rows else []


def html(table: Table) -> str:
    """A section of a page; empty without rows."""
    numeric = _numeric(table)
    rows = [
        [Number(text) if right else text for text, right in zip(row, numeric, strict=True)] for row in _shown(table)
    ]
    note = f'<p class="quiet">{escape(table.note)}</p>' if table.note else ""
    return section(table.title, html_table(table.headings, rows) + note if rows else "")


def markdown(table: Table, level: int = 3) -> str:
    """A heading of this level, the table, the note; empty without rows."""
    if not table.rows:
        return ""
    rules = ["---:" if right else "---" for right in _numeric(table)]
    lines = [_line(row) for row in (table.headings, rules, *_shown(table))]
    parts = [f"{'#' * level} {table.title}", "\n".join(lines), table.note]
    return "\n\n".join(part for part in parts if part) + "\n"


def shown(cell: Cell) -> str:
    """Whole numbers with their thousands apart, others to four digits."""
    if cell is None:
        return NONE
    if isinstance(cell, str):
        return cell
    if isinstance(cell, int) or abs(cell) >= 1e3:
        return f"{cell:,.0f}"
    return f"{cell:.4g}"


def _shown(table: Table) -> Iterator[list[str]]:
    return ([shown(cell) for cell in row] for row in table.rows)


def _numeric(table: Table) -> list[bool]:
    """Which columns hold numbers alone."""
    return [all(not isinstance(cell, str) for cell in column) for column in zip(*table.rows, strict=True)]


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"
