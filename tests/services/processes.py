"""Processes of the program: started, killed and started again; what they said is shown where one fails."""

from __future__ import annotations

import os
import signal
import socket
import sqlite3
import subprocess
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from types import TracebackType
from typing import Self

from terrafuse.replica import Replica
from terrafuse.store.sqlite import SqliteStore
from tests.program import PROGRAM

STEP_S = 0.02
SHOWN_BYTES = 12_000
WITH = {"COLUMNS": "200", "PYTHONFAULTHANDLER": "1"}
MOST_S = 100
"""Of a test, on a machine that is busy with others, too."""


def free_port() -> int:
    with closing(socket.socket()) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def answers(port: int) -> bool:
    """Whether somebody listens there."""
    with closing(socket.socket()) as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def cells_in(store: Path) -> int:
    """Cells of all deltas that are in the store, as another process sees them."""
    if not store.exists():
        return 0
    try:
        with closing(sqlite3.connect(f"file:{store}?mode=ro", uri=True)) as connection:
            return int(connection.execute("SELECT coalesce(sum(cells), 0) FROM deltas").fetchone()[0])
    except sqlite3.OperationalError:
        return 0


def digest(store: Path, factor: int = 1) -> str:
    with SqliteStore.open(store) as opened:
        return Replica(store=opened, factor=factor).digest()


class Processes:
    """By name; each start writes on where the one before ended. All are killed in the end."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._arguments: dict[str, list[str]] = {}
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self.deadline = time.monotonic() + MOST_S

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for process in self._running.values():
            if process.poll() is None:
                process.send_signal(signal.SIGKILL if error is None else signal.SIGABRT)  # which says where it hangs
            process.wait()
        if error is not None:
            error.add_note(self.said())

    def start(self, name: str, *arguments: str | Path) -> None:
        self._arguments[name] = [*PROGRAM, *map(str, arguments)]
        self.again(name)

    def again(self, name: str) -> None:
        """The same command once more."""
        with (self._folder / f"{name}.log").open("ab") as log:
            self._running[name] = subprocess.Popen(
                self._arguments[name], stdout=log, stderr=log, cwd=self._folder, env=os.environ | WITH
            )

    def kill(self, name: str) -> None:
        """With SIGKILL, while it runs."""
        assert self._running[name].poll() is None, f"{name} ended before it could be killed"
        self._running[name].kill()
        self._running[name].wait()

    def stop(self, name: str, number: signal.Signals = signal.SIGTERM) -> tuple[int, float]:
        """(exit code, seconds that it took)."""
        assert self._running[name].poll() is None, f"{name} ended before it could be stopped"
        started = time.monotonic()
        self._running[name].send_signal(number)
        code = self._running[name].wait(20)
        return code, time.monotonic() - started

    def pid(self, name: str) -> int:
        return self._running[name].pid

    def code(self, name: str) -> int | None:
        return self._running[name].poll()

    def until(self, condition: Callable[[], bool], what: str) -> None:
        while not condition():
            assert time.monotonic() < self.deadline, f"in vain: {what}"
            time.sleep(STEP_S)

    def text(self, name: str) -> str:
        path = self._folder / f"{name}.log"
        return path.read_text(errors="replace") if path.exists() else ""

    def said(self) -> str:
        parts = [f"--- {name}, exit code {self.code(name)}\n{self.text(name)[-SHOWN_BYTES:]}" for name in self._running]
        return "\n".join(parts)
