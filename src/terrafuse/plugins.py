"""Files of users that add to the registries: `terrafuse map … --plugin mine.py`.

A plug-in is a Python file that is run once. What it adds it puts into a plain dict, as in `MODELS["mine"] = Mine`;
there is nothing to inherit from, to register with or to install.
"""

from __future__ import annotations

import hashlib
import sys
import traceback
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

from terrafuse.errors import InputError, TerrafuseError

HINT = "what a file of yours adds is there with --plugin FILE.py"

_loaded: dict[Path, str] = {}


def load_plugin(path: Path | str) -> None:
    """Run the file, once for each process. Raises InputError that names the line where it fails."""
    file = Path(path).resolve()
    if file in _loaded:
        return
    if file.suffix != ".py" or not file.is_file():
        raise InputError(f"plug-in {path}: give an existing Python file, like mine.py")
    content = file.read_bytes()
    _run(file)
    _loaded[file] = hashlib.sha256(content).hexdigest()


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
    except Exception as error:
        line = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(file)]
        where = f" line {line[-1]}" if line else ""
        raise InputError(f"plug-in {file}:{where} {type(error).__name__}: {error}") from error
