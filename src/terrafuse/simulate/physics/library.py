"""MuJoCo, late: it is an extra."""

from __future__ import annotations

from typing import Any

from terrafuse.errors import MissingExtra


def mujoco() -> Any:
    """The package. Raises MissingExtra where it is not installed."""
    try:
        import mujoco
    except ImportError as error:
        raise MissingExtra("robots with physics", "mujoco-core", "sim") from error
    return mujoco
