"""Heavy libraries are imported where they are first needed, so that listing the readers costs nothing."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from terrafuse.errors import MissingExtra


def library(module: str, what: str, extra: str) -> Any:
    """The module, or MissingExtra with the `pip install` line; `what` is what needs it."""
    try:
        return import_module(module)
    except ImportError as error:
        raise MissingExtra(what, module.partition(".")[0], extra) from error
