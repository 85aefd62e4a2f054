"""The option of every command that opens a log or a store."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer


def _load(paths: Sequence[Path] | None) -> Sequence[Path]:
    """Before the other options are looked at: what the files add may be named by them."""
    if paths:
        from terrafuse.plugins import load_plugin

        for path in paths:
            load_plugin(path)
        if "terrafuse.models" in sys.modules:
            sys.modules["terrafuse.models"].check_layers()
    return paths or ()


Plugins = Annotated[
    list[Path] | None,
    typer.Option(
        metavar="FILE.py",
        envvar="TERRAFUSE_PLUGINS",
        callback=_load,
        help="A file of yours that adds a model, layer, reader, window or format; repeatable. docs/extending.md",
    ),
]
