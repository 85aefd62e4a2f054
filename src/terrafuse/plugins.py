"""Files of users that add to the registries: `terrafuse map … --plugin mine.py`.

A plug-in is a Python file that is run once. What it adds it puts into a plain dict, as in `MODELS["mine"] = Mine`;
there is nothing to inherit from, to register with or to install.
"""

from __future__ import annotations

import hashlib
import os
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

from terrafuse.errors import InputError, TerrafuseError, shown

HINT = "what a file of yours adds is there with --plugin FILE.py"

_loaded: dict[Path, str] = {}


def load_plugin(path: Path | str) -> None:
    """Run the file, once for each process. Raises InputError that names the line where it fails."""
    file = _existing(path)
    if file in _loaded:
        return
    content = file.read_bytes()
    _run(file)
    _loaded[file] = hashlib.sha256(content).hexdigest()


def _existing(path: Path | str) -> Path:
    try:
        file = Path(path).resolve()
        there = file.suffix == ".py" and file.is_file()
    except (OSError, ValueError):  # too long a name, or none
        there = False
    if not there:
        raise InputError(f"plug-in {shown(str(path))}: give an existing Python file, like mine.py")
    return file


def blamed(error: BaseException) -> InputError | None:
    """What to say of an error that a loaded plug-in caused, or had a part in; None of others."""
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if Path(frame.filename) in _loaded]
    return InputError(f"plug-in {frames[-1].filename}: {_said(error, frames[-1].lineno)}") if frames else None


def file_of(function: object) -> str:
    """Where a function stands, for errors."""
    code = getattr(function, "__code__", None)
    return str(getattr(code, "co_filename", None) or function)[:200]


@contextmanager
def said_of(what: str) -> Iterator[None]:
    """What code of users raises, as an InputError that names `what` and the line."""
    try:
        yield
    except TerrafuseError:
        raise
    except Exception as error:
        theirs = [frame for frame in traceback.extract_tb(error.__traceback__) if not frame.filename.startswith(OURS)]
        lines = [frame.lineno for frame in theirs if frame.filename == theirs[0].filename]
        raise InputError(f"{what}: {_said(error, lines[-1] if lines else None)}") from error


OURS = str(Path(__file__).parent) + os.sep


def _said(error: BaseException, line: int | None) -> str:
    """The error in one line."""
    where = "" if line is None else f"line {line} "
    return f"{where}{type(error).__name__}: {shown(' '.join(str(error).split()))}"


def fingerprints() -> list[str]:
    """SHA-256 of each loaded file's content: a map that was begun with other code must not go on with this."""
    return sorted(_loaded.values())


def _run(file: Path) -> None:
    name = f"terrafuse_plugin_{file.stem}"
    spec = spec_from_file_location(name, file)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up
    try:
        spec.loader.exec_module(module)
    except TerrafuseError:
        raise
    except (Exception, SystemExit) as error:
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(file)]
        raise InputError(f"plug-in {file}: {_said(error, lines[-1] if lines else None)}") from error
