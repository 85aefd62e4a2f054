"""Files that appear whole or not at all."""

from __future__ import annotations

import errno
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from terrafuse.errors import OutputError

NEARLY_FULL = 1 << 20
"""Libraries that write files themselves seldom say why that failed; with fewer bytes free, it was the disk."""


@contextmanager
def final(path: Path | str) -> Iterator[Path]:
    """A temporary path beside `path`, of the same ending, that takes its place when the block ends without an error.

    Whatever the block leaves under a name that begins like the temporary one, without its ending, is removed. Raises
    OutputError, and leaves what existed before, where the file can't be written.
    """
    target = Path(path)
    stem = f".{target.stem}.{secrets.token_hex(4)}.partial"
    temporary = target.with_name(stem + target.suffix)
    try:
        if target.exists() and not target.is_file():
            raise OutputError(f"{target}: is not a regular file; choose another name")
        # Tells a missing folder or permission before the work, not after it.
        temporary.touch(exist_ok=False)
        yield temporary
        _sync(temporary)
        os.replace(temporary, target)
        with suppress(OSError):  # some file systems can't sync a folder
            _sync(target.parent)
    except OSError as error:
        raise OutputError(f"{target}: can't be written: {_reason(error, target)}") from error
    finally:
        with suppress(OSError):
            for left in target.parent.glob(f"{_literal(stem)}*"):
                left.unlink(missing_ok=True)


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _literal(name: str) -> str:
    return "".join(f"[{letter}]" if letter in "*?[" else letter for letter in name)


def _reason(error: OSError, target: Path) -> str:
    folder = target.parent
    if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG) or _nearly_full(folder):
        return f"no space left in {folder}; free some, or choose another folder"
    if error.errno in (errno.ENOENT, errno.ENOTDIR) or not folder.is_dir():
        return f"there is no folder {folder}; create it first"
    if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        return f"no permission in {folder}; change its rights, or choose another folder"
    return f"{error.__cause__ or error}; choose another name or folder"


def _nearly_full(folder: Path) -> bool:
    try:
        return shutil.disk_usage(folder).free < NEARLY_FULL
    except OSError:
        return False
