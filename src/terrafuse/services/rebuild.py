"""A robot's map made anew from its own log, by corrected poses, and put in the place of the one before.

It is made beside, in a store of its own, while the robot's node goes on telling of the map before. Then, in one
transaction, cells that differ take the place of those before, by revisions beyond all that were told, and cells that
are no longer there are erased (`exchange.erased`). Revisions count scans; so that they do again, the map goes on at a
*base*, a multiple of LIFE, as if a robot had lost count. Which base goes with which corrections is on disk before the
transaction: whatever was killed when, the archive is by the newest base that its revision has reached.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from terrafuse.errors import StoreMismatch
from terrafuse.exchange.corrections import Corrections, fingerprint
from terrafuse.exchange.delta import Delta, TileCells
from terrafuse.exchange.erased import erased, erasing
from terrafuse.exchange.own import LIFE
from terrafuse.mapper import Integrated, Mapper
from terrafuse.mapping import Plan
from terrafuse.services.book import replace_file
from terrafuse.store.base import Store
from terrafuse.store.behind import WriteBehind
from terrafuse.store.sqlite import SqliteStore, remove_store
from terrafuse.tile import opaque
from terrafuse.types import Array, Scan, TileKey
from terrafuse.window import make_window


class Basis(NamedTuple):
    """What a map is made by."""

    base: int = 0
    """The revision that its first scan follows."""
    corrections: str = ""
    """Their fingerprint."""


class Bases:
    """The bases of a robot's map so far, in a file beside its store."""

    def __init__(self, file: Path) -> None:
        self._file = file

    def of(self, revision: int) -> Basis:
        """What a map of this revision is made by."""
        return max((basis for basis in self._read() if basis.base <= revision), default=Basis())

    def plan(self, revision: int, corrections: Corrections) -> Basis:
        """Before a map of this revision is replaced."""
        basis = Basis((revision // LIFE + 1) * LIFE, fingerprint(corrections))
        told = [one for one in self._read() if one.base <= revision]
        replace_file(self._file, json.dumps([*told, basis]).encode())
        return basis

    def _read(self) -> list[Basis]:
        with suppress(FileNotFoundError):
            try:
                return [Basis(int(base), str(by)) for base, by in json.loads(self._file.read_bytes())]
            except (OSError, ValueError, TypeError) as error:
                if not isinstance(error, FileNotFoundError):
                    raise StoreMismatch(
                        f"{self._file}: does not say by which corrections the map beside it is made ({error}); "
                        "restore a copy, or delete both, and the log is mapped anew"
                    ) from error
        return []


class Rebuild:
    """Of `robot`'s map, up to as many scans as it holds: `scans`. `file`: of the store that it is made in."""

    def __init__(self, run: Plan, robot: str, corrections: Corrections, scans: int, file: Path) -> None:
        self.corrections, self.scans = corrections, scans
        self._file = file
        remove_store(file)
        self._store = SqliteStore.create(file, run.lattice, run.model)
        self._behind = WriteBehind(self._store)
        self._mapper = Mapper(
            robot, run.lattice, run.model, make_window(run.settings.window, run.lattice), self._behind
        )
        self._commit_scans = run.settings.commit_scans

    @property
    def left(self) -> int:
        """Scans that are still to come."""
        return self.scans - self._mapper.revision

    def integrate(self, scan: Scan) -> Integrated:
        done = self._mapper.integrate(scan)
        if done.revision % self._commit_scans == 0:
            self._mapper.commit()
        return done

    def put_into(self, archive: Store, bases: Bases) -> Basis:
        """Replace the robot's map in `archive`, which nothing else writes to."""
        self._mapper.commit()
        self._behind.close()
        robot, before = self._mapper.robot, archive.revision(self._mapper.robot)
        basis = bases.plan(before, self.corrections)
        until = basis.base + self._mapper.revision
        whole = Delta(archive.map, robot, before, until, max(archive.stamp(robot), self._mapper.stamp_ns), ())
        with archive.together():
            for tile in self._changes(archive, basis.base, until):
                newest = tile.newest[0]
                archive.accept(replace(whole, since=newest, revision=newest, tiles=(tile,)))
            archive.accept(whole)
        self.close()
        return basis

    def close(self) -> None:
        with suppress(Exception):  # it is thrown away
            self._behind.close()
        self._store.close()
        remove_store(self._file)

    def _changes(self, archive: Store, base: int, until: int) -> Iterator[TileCells]:
        robot = self._mapper.robot
        for key in sorted({*archive.revisions(robot), *self._store.revisions(robot)}):
            tile = changes(key, archive.load(robot, key), self._store.load(robot, key), base, until)
            if tile is not None:
                yield tile


def changes(key: TileKey, before: TileCells | None, after: TileCells | None, base: int, until: int) -> TileCells | None:
    """What makes `before` the cells of `after`: those that differ in more than their revision, which is counted from
    `base` then, and those that are erased, by revision `until`. None: nothing does."""
    held, new = _dense(before, after), _dense(after, before)
    if held is None or new is None:
        return None
    gone = (held["revision"] > 0) & (new["revision"] == 0) & ~erased(held)
    raised = opaque(new).copy().view(new.dtype)
    raised["revision"] = held["revision"]
    differ = (new["revision"] > 0) & (opaque(raised) != opaque(held))
    new["revision"] += np.uint32(base)
    at = np.flatnonzero(differ | gone).astype(np.int32)
    opaque(new)[gone] = opaque(erasing(key, np.flatnonzero(gone), until, new.dtype).cells)
    return TileCells(key, at, opaque(new)[at].view(new.dtype)) if len(at) else None


def _dense(tile: TileCells | None, other: TileCells | None) -> Array | None:
    """As many cells as both need."""
    some = [one for one in (tile, other) if one is not None and len(one.at)]
    if not some:
        return None
    cells = np.zeros(max(int(one.at[-1]) for one in some) + 1, some[0].cells.dtype)
    if tile is not None:
        opaque(cells)[tile.at] = opaque(np.ascontiguousarray(tile.cells))
    return cells


def once_known(archive: Store, robot: str, factor: int) -> Mapping[TileKey, Array]:
    """Of tiles with erased cells, which coarse cells (flat positions) have fine cells that the robot ever reported."""
    side = archive.map.lattice.tile_cells
    found = {}
    for key in archive.revisions(robot):
        tile = archive.load(robot, key)
        if tile is not None and erased(tile.cells).any():
            j, i = np.divmod(tile.at, side)
            found[key] = np.unique((j // factor) * (side // factor) + i // factor)
    return found
