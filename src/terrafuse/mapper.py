"""One robot's own map: scans in, touched tiles out. The loop that reads like the paper."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Protocol

import numpy as np

from terrafuse.errors import InputError, StoreError
from terrafuse.exchange.delta import MAX_NAME, MAX_REVISION, Delta, TileCells, is_robot_name, map_id
from terrafuse.exchange.erased import observed
from terrafuse.lattice import MAX_CELL, MAX_TILE_CELLS, Lattice, union
from terrafuse.models import make_model
from terrafuse.models.base import AnyPatch, Model
from terrafuse.store.base import PathPoint
from terrafuse.tile import Tile
from terrafuse.types import Array, Pose, Scan, Stamp, TileKey, checked_pose, is_rigid
from terrafuse.window import Allocation, KeepAll, Residency, Window

LEAVING_SHARE = 4
"""Tiles that left the window are written once they are a quarter of those in memory: windows that move at every scan
shed tiles one by one, and a commit for each would cost more than the memory that it frees."""


FURTHEST_CELL = MAX_CELL - MAX_TILE_CELLS
"""Of a sensor: what models see near it without looking at each point's place is then on the lattice, tiles and all."""


class Archive(Protocol):
    """Where tiles go that leave the window: any store, or a `WriteBehind` of one."""

    def accept(self, delta: Delta, path: Iterable[PathPoint] = ()) -> bool: ...

    def load(self, robot: str, key: TileKey) -> TileCells | None: ...

    def revision(self, robot: str) -> int: ...

    def stamp(self, robot: str) -> Stamp: ...

    def revisions(self, robot: str) -> dict[TileKey, int]: ...


@dataclass(frozen=True)
class Integrated:
    """What a scan did."""

    revision: int
    points: int
    dropped: Mapping[str, int]
    """Points that did not count, by reason."""
    cells: int
    """Cells that it touched."""
    tiles: int


@dataclass
class Paging:
    """What the window cost so far."""

    loads: int = 0
    """Tiles read back from the archive."""
    evictions: int = 0
    """Tiles dropped from memory."""
    writes: int = 0
    """Tiles written, each time with the cells that had changed."""
    commits: int = 0
    """Transactions that they were written in."""
    most_resident: int = 0
    """Tiles in memory at once."""
    most_bytes: int = 0


class Mapper:
    """The map that one robot makes of its own scans, on a shared lattice.

    Each scan is a revision; `delta(since)` says what changed after one. Without an `archive` every tile stays in memory
    and `window` must keep all. With one, `commit()` writes what is new to it, tiles that leave the window are committed
    and dropped, and the mapper goes on from the newest revision that the archive holds of this robot.
    """

    def __init__(
        self,
        robot: str,
        lattice: Lattice,
        model: Model | None = None,
        window: Window | None = None,
        archive: Archive | None = None,
    ) -> None:
        if not is_robot_name(robot):
            raise InputError(f"robot name {robot!r}: give 1 to {MAX_NAME} printable characters")
        if archive is None and window is not None and not isinstance(window, KeepAll):
            raise InputError("a window that drops tiles needs an archive to drop them into")
        self.robot = robot
        self.lattice = lattice
        self.model = model or make_model("elevation")
        self.paging = Paging()
        self.seconds = {"observe": 0.0, "load": 0.0, "merge": 0.0, "evict": 0.0}
        """Time spent, by stage."""
        self._observe = self.model.observer(lattice)
        self._window = Residency(window or KeepAll(lattice))
        self._leaving: set[TileKey] = set()
        self._archive = archive
        self._resident: dict[TileKey, Tile] = {}
        self._revisions = archive.revisions(robot) if archive else {}
        self._committed = self._revision = archive.revision(robot) if archive else 0
        self._stamp_ns = archive.stamp(robot) if archive else 0
        self._resident_bytes = 0
        self._path: list[PathPoint] = []

    @property
    def observing(self) -> Mapping[str, float]:
        """Of the seconds in `observe`, those of each stage, where the model times its stages."""
        return dict(getattr(self._observe, "seconds", {}))

    @property
    def revision(self) -> int:
        """The number of the newest scan."""
        return self._revision

    @property
    def stamp_ns(self) -> Stamp:
        """The newest stamp of any scan."""
        return self._stamp_ns

    @property
    def resident_bytes(self) -> int:
        return self._resident_bytes

    @property
    def keys(self) -> list[TileKey]:
        """Every tile that the robot ever touched, in memory or not, sorted."""
        return sorted(self._revisions)

    def touched(self, since: int) -> list[TileKey]:
        """The tiles that scans after revision `since` touched, sorted."""
        return sorted(key for key, revision in self._revisions.items() if revision > since)

    def coarse(self, key: TileKey, factor: int) -> Array:
        """The robot's own map of a tile that it touched, coarsened: (T/k, T/k) records, [j, i]."""
        side = self.lattice.tile_cells
        if (tile := self._resident.get(key)) is None:
            tile, held = self.model.tile(self.lattice), self._load(key)
            tile.put(held.at, held.cells)
        return self.model.coarsen(tile.surface().reshape(side, side), factor)

    def integrate(self, scan: Scan) -> Integrated:
        """Take a scan into the map: observe, page in, merge, page out."""
        scan = self._checked(scan)
        t0 = perf_counter()
        patch = self._observe(scan)
        self._check_reach(scan, patch.keys)
        t1 = perf_counter()
        tiles = [self._tile(key) for key in patch.keys]
        t2 = perf_counter()
        self._revision += 1
        self._stamp_ns = max(self._stamp_ns, scan.stamp_ns)
        patch.merge_into(tiles, scan.stamp_ns, self._revision)
        self._revisions.update(dict.fromkeys(patch.keys, self._revision))
        if self._archive is not None:
            self._path.append(PathPoint(scan.stamp_ns, scan.T_world_sensor))
        t3 = perf_counter()
        self._page(patch.keys, *self._whereabouts(scan, patch))
        for stage, seconds in zip(self.seconds, (t1 - t0, t2 - t1, t3 - t2, perf_counter() - t3), strict=True):
            self.seconds[stage] += seconds
        return Integrated(self._revision, patch.points, patch.dropped, patch.cells, len(patch.keys))

    def _checked(self, scan: Scan) -> Scan:
        """The scan with a stamp of Python's own, which no arithmetic turns into a float."""
        if not isinstance(scan.T_world_sensor, Pose):
            raise InputError("a scan's T_world_sensor is a Pose; make one of a matrix with checked_pose(matrix)")
        if not isinstance(scan.stamp_ns, int | np.integer):
            raise InputError(f"stamp {scan.stamp_ns!r}: give whole nanoseconds since 1970")
        if not 0 <= scan.stamp_ns < 2**63:
            raise InputError(f"stamp {scan.stamp_ns}: give nanoseconds since 1970 that fit 63 bits")
        if not is_rigid(scan.T_world_sensor.matrix):
            checked_pose(scan.T_world_sensor.matrix, f"pose of robot '{self.robot}' at stamp {scan.stamp_ns}")
        position = scan.T_world_sensor.position.tolist()
        if not all(abs(value) * self.lattice.cells_per_m <= FURTHEST_CELL for value in position):
            raise InputError(f"position {position} lies beyond the lattice")
        if self._revision == MAX_REVISION:
            raise InputError(
                f"robot '{self.robot}' has reported {MAX_REVISION} scans, the most there can be; rename it"
            )
        return scan if type(scan.stamp_ns) is int else replace(scan, stamp_ns=int(scan.stamp_ns))

    def _check_reach(self, scan: Scan, keys: Iterable[TileKey]) -> None:
        """Raise InputError where a scan touches tiles that reach beyond the lattice, which no delta can have."""
        most = MAX_CELL // self.lattice.tile_cells
        if any(abs(key.x) > most or abs(key.y) > most for key in keys):
            raise InputError(
                f"the scan at {scan.T_world_sensor.position.tolist()} sees places beyond the lattice; is it in metres?"
            )

    def _whereabouts(self, scan: Scan, patch: AnyPatch) -> tuple[float, float]:
        """Where the window should be: the sensor's place, or the middle of what it saw if that is elsewhere.

        A cloud that came in world coordinates has its "sensor" at the world's origin.
        """
        east_m, north_m, _ = scan.T_world_sensor.position.tolist()
        if self.lattice.tile_at(east_m, north_m) in patch.keys:
            return east_m, north_m
        seen = union(list(patch.keys), self.lattice)
        if seen is None or (seen.west <= east_m <= seen.east and seen.south <= north_m <= seen.north):
            return east_m, north_m
        return (seen.west + seen.east) / 2, (seen.south + seen.north) / 2

    def delta(self, since: int = 0) -> Delta:
        """The cells that changed after revision `since`, as absolute states. Asking changes nothing."""
        changed = (self._changed(key, since) for key in self.touched(since))
        tiles = tuple(part for part in changed if len(part.at))
        return Delta(map_id(self.model.name, self.lattice), self.robot, since, self._revision, self._stamp_ns, tiles)

    def contribution(self, key: TileKey) -> TileCells:
        """The robot's own cells of a tile that it touched, as they are now."""
        return self._changed(key, 0)

    def commit(self) -> Delta:
        """Write what changed since the last commit to the archive, whole; returns it."""
        delta = self.delta(self._committed)
        if self._archive is not None and self._revision > self._committed:
            self._archive.accept(delta, self._path)
            self.paging.commits += 1
            self.paging.writes += len(delta.tiles)
        self._committed = self._revision
        self._path = []
        self._drop_leaving()
        return delta

    def allocation(self) -> Allocation:
        """What the window claimed and what of it was seen. Looks at every tile: a question for the end."""
        cells = self.lattice.tile_cells**2
        claimed = self._window.visited | self._revisions.keys()
        return Allocation(
            window_cells=len(claimed) * cells,
            allocated_cells=len(self._revisions) * cells,
            observed_cells=sum(len(self._changed(key, 0).at) for key in self._revisions),
            most_window_cells=max(self._window.most_tiles, self.paging.most_resident) * cells,
            most_allocated_cells=self.paging.most_resident * cells,
        )

    def _changed(self, key: TileKey, since: int) -> TileCells:
        if key in self._resident:
            return TileCells(key, *self._resident[key].changed(since))
        held = self._load(key)
        newer = held.cells["revision"] > since
        return TileCells(key, held.at[newer], held.cells[newer])

    def _load(self, key: TileKey) -> TileCells:
        held = self._archive.load(self.robot, key) if self._archive else None
        if held is None:
            raise InputError(f"tile {tuple(key)} of robot '{self.robot}' is not in the archive any more")
        if len(held.cells) and held.cells["revision"].max() > self._revision:
            raise StoreError(
                f"tile {tuple(key)} of robot '{self.robot}' has cells newer than the robot's newest report, revision "
                f"{self._revision}: the store is damaged, map again from the logs"
            )
        return observed(held)

    def _tile(self, key: TileKey) -> Tile:
        """The tile, from memory, from the archive, or new."""
        tile = self._resident.get(key)
        if tile is None:
            tile = self.model.tile(self.lattice)
            if key in self._revisions:
                held = self._load(key)
                tile.put(held.at, held.cells)
                self.paging.loads += 1
            # Only now: a load that failed must not leave an empty tile in the place of what is stored.
            self._resident[key] = tile
            self._resident_bytes += tile.nbytes
            self.paging.most_resident = max(self.paging.most_resident, len(self._resident))
            self.paging.most_bytes = max(self.paging.most_bytes, self.resident_bytes)
        return tile

    def _page(self, touched: Iterable[TileKey], east_m: float, north_m: float) -> None:
        """Let what left the window go once it is worth a commit; at any other commit it goes for nothing.

        Not what this very scan touched: the next one will, too.
        """
        if self._window.move(east_m, north_m):
            self._leaving = {key for key in self._resident if key not in self._window.area}
        if self._leaving:
            self._leaving.difference_update(touched)
            if len(self._leaving) * LEAVING_SHARE >= len(self._resident):
                self.commit()

    def _drop_leaving(self) -> None:
        """After a commit. That wrote all that was new, not only these tiles: every state of the archive is then the map
        after some scan, from which a restarted robot can go on."""
        for key in self._leaving:
            self._resident_bytes -= self._resident.pop(key).nbytes
        self.paging.evictions += len(self._leaving)
        self._leaving = set()
