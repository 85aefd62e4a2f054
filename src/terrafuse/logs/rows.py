"""Text files with one record a line: `#` starts a comment, blank lines don't count, errors name file:line."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from terrafuse.errors import LogError


class Row(NamedTuple):
    """The words of one line; `place` is `file:line`, for messages."""

    place: str
    words: list[str]

    def numbers(self) -> list[float]:
        try:
            return [float(word) for word in self.words]
        except ValueError as error:
            raise LogError(f"{self.place}: {error}") from None


def rows(path: Path) -> Iterator[Row]:
    with path.open(encoding="utf-8", errors="replace") as lines:
        for number, line in enumerate(lines, 1):
            words = line.partition("#")[0].replace(",", " ").split()
            if words:
                yield Row(f"{path}:{number}", words)
