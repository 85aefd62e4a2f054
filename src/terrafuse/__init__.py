"""terrafuse: one terrain map from many robots.

    from terrafuse import Lattice, Mapper, Replica, Scan

    lattice = Lattice(resolution_m=0.1, crs="EPSG:32632")
    mapper = Mapper("r1", lattice)
    mapper.integrate(Scan(stamp_ns, points, T_world_sensor))   # once a scan
    replica = Replica(lattice)
    replica.apply(mapper.delta(since=0))                        # and the other robots' deltas, in any order
    replica.layer("height", (west, south, east, north))         # an xarray.DataArray with its CRS

Names load when they are first used: importing the package costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

_HOME = {
    "Bounds": "types",
    "Delta": "exchange.delta",
    "InputError": "errors",
    "Lattice": "lattice",
    "Mapper": "mapper",
    "Pose": "types",
    "Replica": "replica",
    "Scan": "types",
    "SqliteStore": "store.sqlite",
    "TerrafuseError": "errors",
    "TileKey": "types",
    "checked_pose": "types",
    "decode": "exchange.codec",
    "encode": "exchange.codec",
    "make_model": "models",
    "open_log": "logs",
}

if TYPE_CHECKING:
    from terrafuse.errors import InputError, TerrafuseError
    from terrafuse.exchange.codec import decode, encode
    from terrafuse.exchange.delta import Delta
    from terrafuse.lattice import Lattice
    from terrafuse.logs import open_log
    from terrafuse.mapper import Mapper
    from terrafuse.models import make_model
    from terrafuse.replica import Replica
    from terrafuse.store.sqlite import SqliteStore
    from terrafuse.types import Bounds, Pose, Scan, TileKey, checked_pose

__all__ = [
    "Bounds",
    "Delta",
    "InputError",
    "Lattice",
    "Mapper",
    "Pose",
    "Replica",
    "Scan",
    "SqliteStore",
    "TerrafuseError",
    "TileKey",
    "checked_pose",
    "decode",
    "encode",
    "make_model",
    "open_log",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'terrafuse' has no attribute '{name}'")
    return getattr(import_module(f"terrafuse.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
