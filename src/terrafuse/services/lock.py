"""One process a store: a second node on the same file would write what the first takes for its own."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from terrafuse.errors import StoreMismatch

try:
    import fcntl
except ImportError:  # no Unix: nothing is locked
    fcntl = None  # type: ignore[assignment]


@contextmanager
def alone(store: Path) -> Iterator[None]:
    """Nobody else may enter this for the store, in this process or another, while the block runs. What only reads it
    need not ask. Raises StoreMismatch while another is in it.

    The lock is the kernel's, of STORE.lock, and goes with the process, however that ends.
    """
    held = _taken(store.resolve())
    try:
        yield
    finally:
        if held is not None:
            Path(held.name).unlink(missing_ok=True)  # before it is released: see `_taken`
            held.close()


def _taken(store: Path) -> IO[str] | None:
    """The open, locked file. None: nothing can be written there, as the store itself will say."""
    file = Path(f"{store}.lock")
    while fcntl is not None:
        try:
            opened = file.open("a+")
        except OSError:
            return None
        try:
            fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise StoreMismatch(_taken_words(store, opened)) from error
        except OSError:  # a file system without locks
            opened.close()
            return None
        if _is_still(file, opened):
            opened.truncate(0)
            opened.write(str(os.getpid()))
            opened.flush()
            return opened
        opened.close()  # whoever had it before has deleted it meanwhile
    return None


def _taken_words(store: Path, opened: IO[str]) -> str:
    with opened:
        opened.seek(0)
        process = opened.read(20)
    who = f" (process {process})" if process.isdecimal() else ""
    return f"{store}: another station or robot{who} runs on this store; stop that, or give this one another --store"


def _is_still(file: Path, opened: IO[str]) -> bool:
    try:
        return os.path.samestat(os.stat(file), os.fstat(opened.fileno()))
    except FileNotFoundError:
        return False
