"""How the commands speak: text or one JSON object on stdout, progress and errors on stderr."""

from __future__ import annotations

import json
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from typing import Any, Protocol

from terrafuse.errors import TerrafuseError

LINES_EVERY_S = 5.0


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


class LogProgress(Protocol):
    """Told of each record of each robot, and of what else takes time."""

    def __call__(self, robot: str, done: int, total: int | None, points: int) -> None: ...

    def stage(self, word: str) -> None: ...


class Bars:
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
            rate = rate_text(points / max(now - self._started, 1e-9))
            self._progress.update(self._tasks[robot], completed=done, rate=rate)

    def stage(self, word: str) -> None:
        with self._lock:
            self._progress.add_task(word, total=None, rate="")


class Lines:
    """The same for files and pipes: a line for each robot every few seconds, nothing where all takes no longer."""

    def __init__(self, write: Callable[[str], None], clock: Callable[[], float] = time.perf_counter) -> None:
        self._write, self._clock = write, clock
        self._started = clock()
        self._last: dict[str, float] = {}
        self._lock = threading.Lock()

    def __call__(self, robot: str, done: int, total: int | None, points: int) -> None:
        now = self._clock()
        with self._lock:
            if now - self._last.get(robot, self._started) < LINES_EVERY_S:
                return
            self._last[robot] = now
            of = "" if total is None else f" of {total}"
            self._write(f"{robot}: {done}{of} done, {rate_text(points / (now - self._started))}")

    def stage(self, word: str) -> None:
        if self._clock() - self._started >= LINES_EVERY_S:
            self._write(f"{word} …")


@contextmanager
def log_progress() -> Iterator[LogProgress]:
    """On stderr: bars where that is a terminal, else lines."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    console = Console(stderr=True)
    if not console.is_terminal:
        yield Lines(note)
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console) as progress:
        yield Bars(progress)


def note(text: str) -> None:
    """What is no result: on stderr, at once."""
    print(text, file=sys.stderr, flush=True)


@cache
def tell_of_compiling() -> None:
    """From now on, say so when a kernel is first compiled: that can be half a minute of silence, after an installation
    or an update; later runs find it in the cache."""
    from numba.core import event

    class Notice(event.Listener):
        told = False

        def on_start(self, _: Any) -> None:
            if not self.told:
                self.told = True
                note("compiling kernels, once; this can take a minute")

        def on_end(self, _: Any) -> None:
            pass

    event.register("numba:compile", Notice())  # type: ignore[no-untyped-call]


def rate_text(points_per_s: float) -> str:
    return f"{count_text(points_per_s)}points/s"


def count_text(count: float) -> str:
    """With the unit that goes before what is counted: `1.2 M `, `45 k `, `740 `."""
    if count >= 1e6:
        return f"{count / 1e6:.1f} M "
    return f"{count / 1e3:.0f} k " if count >= 1e4 else f"{count:,.0f} "


def bytes_text(count: float) -> str:
    for unit in ("B", "kB", "MB", "GB"):
        if count < 1000:
            return f"{count:.0f} {unit}" if unit == "B" else f"{count:.1f} {unit}"
        count /= 1000
    return f"{count:.1f} TB"
