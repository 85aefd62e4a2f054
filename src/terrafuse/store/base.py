"""What a store does. A robot's contribution to a tile is the newest state of every cell that it reported there."""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from hashlib import blake2b
from typing import Protocol

import numpy as np

from terrafuse.errors import DeltaError
from terrafuse.exchange.delta import Delta, MapId, TileCells, check_content, check_outline, together
from terrafuse.exchange.erased import erased
from terrafuse.kernels.newer import put_newer
from terrafuse.models.base import Model
from terrafuse.tile import opaque
from terrafuse.types import Array, Pose, Stamp, TileKey

FEW_TILES = 4


@dataclass(frozen=True, eq=False)
class PathPoint:
    """Where a robot's sensor was: T_world_sensor at a stamp."""

    stamp_ns: Stamp
    T_world_sensor: Pose


@dataclass(frozen=True)
class HistoryEntry:
    """A delta that was accepted."""

    sequence: int
    robot: str
    since: int
    revision: int
    stamp_ns: Stamp
    arrival_ns: Stamp
    cells: int
    nbytes: int


class Store(Protocol):
    """Contributions of one map. What `accept` took is there after a crash; a delta is in whole or not at all."""

    @property
    def map(self) -> MapId: ...

    @property
    def model(self) -> Model: ...

    def accept(self, delta: Delta, path: Iterable[PathPoint] = (), message: bytes | None = None) -> bool:
        """Take a delta in, with the poses of its scans; False if this very delta was there already.

        `message`: bytes that decode to the same tiles, where they are at hand: a store may keep these as they are. A
        duplicate is then known by them. Raises DeltaError for a delta of another map. Order does not matter.
        """

    def together(self) -> AbstractContextManager[None]:
        """What is accepted within is made to last at the end, at once for all: who is told of it, is told after that.

        Other threads find nothing of it before; a crash takes all of it back.
        """

    def version(self) -> Hashable:
        """Changes with every delta that is accepted."""

    def robots(self) -> list[str]:
        """Names, sorted."""

    def keys(self) -> list[TileKey]:
        """Tiles that anybody reported, sorted."""

    def revision(self, robot: str) -> int:
        """The newest revision of any delta of this robot; 0 if there is none."""

    def level(self, robot: str) -> int:
        """The newest revision that a delta of this robot leads to: one that began before it (`since` < `revision`).

        A delta that begins where it ends brings cells and leads nowhere: a piece of a whole, of which more is to come.
        """

    def stamp(self, robot: str) -> Stamp:
        """The newest stamp of any delta of this robot; 0 if there is none."""

    def revisions(self, robot: str) -> dict[TileKey, int]:
        """The newest revision of each tile of this robot."""

    def load(self, robot: str, key: TileKey) -> TileCells | None:
        """The robot's contribution to a tile."""

    def poses(self, robot: str) -> list[PathPoint]:
        """In stamp order."""

    def history(self) -> list[HistoryEntry]:
        """In the order of arrival."""


def check_delta(delta: Delta, map_: MapId, model: Model, message: bytes | None = None) -> None:
    """Raise DeltaError unless the delta belongs to this map and a mapper can have made it.

    Of one that came as a message the codec has checked what cells of any model have.
    """
    if delta.map != map_:
        raise DeltaError(f"a delta of {delta.map} does not belong to the map {map_}")
    (check_outline if message else check_content)(delta)
    for tile in delta.tiles:
        if model.cell != tile.cells.dtype:
            raise DeltaError(f"cells of another kind than the model '{model.name}' has")
    # Many at once: coarse tiles have few cells each, and which of them is at fault is asked only where one is.
    if len(delta.tiles) > FEW_TILES and not model.check(together([tile.cells for tile in delta.tiles])):
        return
    for tile in delta.tiles:
        # Erased cells are no model's, and seldom: they are looked for only where something is at fault.
        if model.check(tile.cells) and (flaw := model.check(tile.cells[~erased(tile.cells)])):
            raise DeltaError(f"tile {tuple(tile.key)} has cells with {flaw}: no mapper makes such")


def identity_of(delta: Delta, message: bytes | None) -> tuple[str, int, int, str]:
    """What a delta is known by; its message is a thirtieth of its cells."""
    if message is None:
        return delta.identity
    return delta.robot, delta.since, delta.revision, blake2b(message, digest_size=16).hexdigest()


def newest(dense: Array, at: Array, cells: Array) -> None:
    """Put cells (K,) into a dense tile (T²,) where they are newer than what is there.

    The newer revision counts. Equal ones with other content come of a robot that was started afresh under its old name:
    of these the newer stamp counts, and of equal stamps the larger bytes, so that even then the order in which they
    arrive makes no difference.
    """
    given = np.ascontiguousarray(cells)
    ties = np.empty(len(at), np.int64)
    count = put_newer(_bytes(dense), dense["revision"], at, _bytes(given), given["revision"], ties)
    for k in ties[:count]:
        own, new = dense[at[k]], given[k]
        if (new["stamp"], new.tobytes()) > (own["stamp"], own.tobytes()):
            opaque(dense)[at[k]] = opaque(given)[k]


def _bytes(records: Array) -> Array:
    return records.view(np.uint8).reshape(len(records), records.dtype.itemsize)


def sparse(dense: Array) -> tuple[Array, Array]:
    """(positions, cells) that a dense tile holds."""
    at = np.flatnonzero(dense["revision"]).astype(np.int32)
    return at, opaque(dense)[at].view(dense.dtype)
