"""Writing off the sensing path: a robot that pages a tile out does not wait for the disk.

A store's writes queue behind one thread. What waits is still found: `load` lays it over what the store holds.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterable

import numpy as np

from terrafuse.exchange.delta import Delta, TileCells
from terrafuse.store.base import PathPoint, Store, newest, sparse
from terrafuse.types import Stamp, TileKey

MAX_WAITING = 16
"""Deltas in the queue. Beyond this the robot waits: memory stays bounded where a disk can't keep up."""


class WriteBehind:
    """The part of a store that a mapper uses, with writes in the background. `close` waits for them.

    An error of the store's is raised to the next caller, and again at `close`.
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._queue: queue.Queue[tuple[Delta, tuple[PathPoint, ...]] | None] = queue.Queue(MAX_WAITING)
        self._waiting: list[Delta] = []
        self._lock = threading.Lock()
        self._fault: BaseException | None = None
        self._thread = threading.Thread(target=self._write, name="terrafuse-writer", daemon=True)
        self._thread.start()

    def accept(self, delta: Delta, path: Iterable[PathPoint] = ()) -> bool:
        self._raise_fault()
        with self._lock:
            self._waiting.append(delta)
        self._queue.put((delta, tuple(path)))
        return True

    def load(self, robot: str, key: TileKey) -> TileCells | None:
        self._raise_fault()
        waiting = [tile for delta in self._waiting_of(robot) for tile in delta.tiles if tile.key == key]
        held = self._store.load(robot, key)
        if not waiting:
            return held
        dense = np.zeros(self._store.map.lattice.tile_cells**2, self._store.model.cell)
        for part in [*([held] if held else []), *waiting]:
            newest(dense, part.at, part.cells)
        return TileCells(key, *sparse(dense))

    def revision(self, robot: str) -> int:
        waiting = [delta.revision for delta in self._waiting_of(robot)]
        return max(self._store.revision(robot), *waiting, 0)

    def stamp(self, robot: str) -> Stamp:
        waiting = [delta.stamp_ns for delta in self._waiting_of(robot)]
        return max(self._store.stamp(robot), *waiting, 0)

    def revisions(self, robot: str) -> dict[TileKey, int]:
        waiting = self._waiting_of(robot)
        out = self._store.revisions(robot)
        for tile in (tile for delta in waiting for tile in delta.tiles):
            out[tile.key] = max(out.get(tile.key, 0), int(tile.cells["revision"].max()))
        return out

    def _waiting_of(self, robot: str) -> list[Delta]:
        with self._lock:
            return [delta for delta in self._waiting if delta.robot == robot]

    def close(self) -> None:
        self._queue.put(None)
        self._thread.join()
        self._raise_fault()

    def _raise_fault(self) -> None:
        if self._fault is not None:
            raise self._fault

    def _write(self) -> None:
        while (item := self._queue.get()) is not None:
            delta, path = item
            if self._fault is None:
                try:
                    self._store.accept(delta, path)
                except BaseException as error:
                    self._fault = error
            with self._lock:
                self._waiting.remove(delta)
