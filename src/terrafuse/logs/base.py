"""What a reader is: a small object in the plain dict `READERS`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from terrafuse.query import split_query
from terrafuse.types import Scan, Skipped

Record = Scan | Skipped


@dataclass(frozen=True)
class Source:
    """Where a log lies and how to read it: `PATH?key=value&key=value` on the command line."""

    path: Path
    options: Mapping[str, str] = field(default_factory=dict)
    aimed: bool = False
    """Whether somebody else says where the beams look, by what scans have as `readings`: logs that do not state it
    are then taken, their scans without points."""


@dataclass(frozen=True)
class Log:
    """An opened recording.

    `scans()` starts a fresh pass over it, in stamp order; it may be called more than once.
    `count` is how many records a pass yields, where that is known beforehand (for progress).
    `crs` is the CRS of the world frame, where the recording states one; `georeferenced` says that coordinates
    are already in it (airborne LAS), so that no origin is added.
    """

    path: Path
    reader: str
    scans: Callable[[], Iterator[Record]]
    count: int | None = None
    crs: str | None = None
    georeferenced: bool = False


@dataclass(frozen=True)
class Reader:
    """`matches(path)` looks at names and first bytes only; `open(source)` checks everything that is cheap to
    check.

    `options` are the keys it takes after the `?`, each with a line of help.
    """

    name: str
    summary: str
    matches: Callable[[Path], bool]
    open: Callable[[Source], Log]
    options: Mapping[str, str] = field(default_factory=dict)


def parse_source(text: str, aimed: bool = False) -> Source:
    """`PATH?key=value&key=value` → Source. A path that exists as written may contain `?`."""
    path, options = split_query(text)
    return Source(Path(path), options, aimed)
