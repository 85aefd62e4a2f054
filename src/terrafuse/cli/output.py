"""How the commands speak: text or one JSON object on stdout, progress and errors on stderr."""

from __future__ import annotations

import json
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from terrafuse.errors import TerrafuseError


def say(text: str) -> None:
    print(text)


def say_json(value: Mapping[str, Any]) -> None:
    print(json.dumps(value, allow_nan=False))


def fail(error: TerrafuseError, as_json: bool) -> int:
    """Report an error; returns the exit code."""
    if as_json:
        say_json({"error": str(error), "kind": type(error).__name__, "exit_code": error.exit_code, **error.facts})
    print(f"error: {error}", file=sys.stderr)
    return error.exit_code


class LogProgress:
    """A bar for each robot: records done, points a second, time left."""

    def __init__(self, progress: Any) -> None:
        self._progress = progress
        self._tasks: dict[str, Any] = {}
        self._last: dict[str, float] = {}
        self._started = time.perf_counter()
        self._lock = threading.Lock()

    def __call__(self, robot: str, done: int, total: int | None, points: int) -> None:
        now = time.perf_counter()
        with self._lock:
            if robot not in self._tasks:
                self._tasks[robot] = self._progress.add_task(robot, total=total, rate="")
            if done != total and now - self._last.get(robot, 0.0) < 0.1:
                return
            self._last[robot] = now
            rate = points / max(now - self._started, 1e-9) / 1e6
            self._progress.update(self._tasks[robot], completed=done, rate=f"{rate:.1f} M points/s")

    def stage(self, word: str) -> None:
        with self._lock:
            self._progress.add_task(word, total=None, rate="")


@contextmanager
def log_progress() -> Iterator[LogProgress]:
    """Bars on stderr where that is a terminal, else nothing."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    console = Console(stderr=True)
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        yield LogProgress(progress)


def bytes_text(count: float) -> str:
    for unit in ("B", "kB", "MB", "GB"):
        if count < 1000:
            return f"{count:.0f} {unit}" if unit == "B" else f"{count:.1f} {unit}"
        count /= 1000
    return f"{count:.1f} TB"
