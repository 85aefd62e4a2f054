"""A robot's own map at a coarser lattice, as what it reports: the *patrol* paper's low-resolution map (LLRM)."""

from __future__ import annotations

from terrafuse.exchange.delta import Delta, MapId, map_id
from terrafuse.mapper import Mapper
from terrafuse.store.base import Store
from terrafuse.types import Stamp


class CoarseContribution:
    """What `mapper` holds, coarsened by `factor`: each coarse cell is the model's `coarsen` of k×k of the robot's cells.

    A replica on `map.lattice` that took its deltas in holds what `Replica(store of the fine contributions,
    factor=factor)` holds, cell for cell, revisions aside. Raises LatticeError for a factor that doesn't divide a tile.
    """

    def __init__(self, mapper: Mapper, factor: int) -> None:
        self.robot = mapper.robot
        self.map: MapId = map_id(mapper.model.name, mapper.lattice.coarser(factor))
        self.revision = 0
        """The mapper's, as of the last `update`."""
        self.stamp_ns: Stamp = 0

    def update(self) -> int:
        """Take in what the mapper changed since the last call; returns how many coarse cells that changed.

        These get the mapper's revision. Others keep theirs, so that what looks the same is not sent again.
        """
        raise NotImplementedError

    def delta(self, since: int = 0) -> Delta:
        """The coarse cells that changed after revision `since`, as absolute states, as of the last `update`."""
        raise NotImplementedError


def delta_since(store: Store, robot: str, since: int = 0) -> Delta:
    """What a store holds of a robot that is newer than revision `since`: for passing on what others report."""
    raise NotImplementedError
