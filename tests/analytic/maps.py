"""The map that logs make."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from terrafuse.lattice import Lattice
from terrafuse.logs import open_log
from terrafuse.mapper import Mapper
from terrafuse.models import make_model
from terrafuse.replica import Replica
from terrafuse.types import Scan


def map_of(logs: Mapping[str, Path], lattice: Lattice, static: bool) -> Replica:
    """All robots' logs as one elevation map; no scan may be skipped."""
    replica = Replica(lattice, make_model("elevation", {"static": static}))
    for robot, path in logs.items():
        mapper = Mapper(robot, lattice, replica.model)
        for record in open_log(str(path)).scans():
            assert isinstance(record, Scan)
            mapper.integrate(record)
        replica.apply(mapper.delta())
    return replica
