"""Folders for results: made when they are needed, gone again where nothing came of it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from terrafuse.errors import OutputError


@contextmanager
def folder_for(out: Path) -> Iterator[Path]:
    """The folder, made with its parents and seen to be writable; of these, the ones that the block leaves empty when
    it fails are removed. Raises OutputError."""
    made = [folder for folder in (out, *out.parents) if not folder.exists()]
    try:
        _make(out)
        yield out
    except BaseException:
        for folder in made:
            with suppress(OSError):
                folder.rmdir()
        raise


def _make(out: Path) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
        probe = out / f".terrafuse-{os.getpid()}"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise OutputError(f"{out}: can't write there ({error.strerror}); choose another --out") from error
