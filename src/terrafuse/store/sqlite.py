"""The embedded store: one SQLite file.

History is the journal: accepting a delta appends its cells, a transaction a delta, or one for all that are accepted
`together`. A delta that came as a message is kept as that. A contribution is a base state and the history after it;
when the tail outweighs the base it is folded in, so that writing costs O(log) a cell however often it changes: at once,
or, of what was accepted together, by a thread of the store's own. A crash leaves whole deltas and nothing else.
"""

from __future__ import annotations

import json
import os
import sqlite3
import threading
import time
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from terrafuse.errors import OutputError, StoreError, StoreMismatch
from terrafuse.exchange.codec import decode, pack_cells, unpack_cells
from terrafuse.exchange.delta import Delta, MapId, TileCells, map_id
from terrafuse.lattice import Lattice
from terrafuse.models import make_model
from terrafuse.models.base import Model
from terrafuse.store.base import HistoryEntry, PathPoint, check_delta, identity_of, newest, sparse
from terrafuse.store.folding import Folding
from terrafuse.types import Array, Pose, Stamp, TileKey

SCHEMA = 3
APPLICATION_ID = 0x54465553  # "TFUS"
MIN_TAIL_CELLS = 1 << 16
"""A tail that is not longer is left: reading it takes 10 ms at most, and folding it takes as long."""
MOST_TILES_A_MESSAGE = 4
"""Each of a message's tiles is read by unpacking all of it: with more, each is packed by itself."""

TABLES = """
CREATE TABLE meta (name TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE deltas (
    sequence INTEGER PRIMARY KEY, robot TEXT NOT NULL, since INTEGER NOT NULL, revision INTEGER NOT NULL,
    tiles TEXT NOT NULL, stamp_ns INTEGER NOT NULL, arrival_ns INTEGER NOT NULL, cells INTEGER NOT NULL,
    nbytes INTEGER NOT NULL, UNIQUE (robot, since, revision, tiles));
CREATE TABLE messages (sequence INTEGER PRIMARY KEY, message BLOB NOT NULL);
CREATE TABLE history (
    sequence INTEGER NOT NULL, robot TEXT NOT NULL, level INTEGER NOT NULL, x INTEGER NOT NULL, y INTEGER NOT NULL,
    count INTEGER NOT NULL, cells BLOB, PRIMARY KEY (robot, level, x, y, sequence)) WITHOUT ROWID;
CREATE TABLE contributions (
    robot TEXT NOT NULL, level INTEGER NOT NULL, x INTEGER NOT NULL, y INTEGER NOT NULL,
    revision INTEGER NOT NULL, stamp_ns INTEGER NOT NULL, base_cells INTEGER NOT NULL, tail_cells INTEGER NOT NULL,
    PRIMARY KEY (robot, level, x, y)) WITHOUT ROWID;
CREATE TABLE bases (
    robot TEXT NOT NULL, level INTEGER NOT NULL, x INTEGER NOT NULL, y INTEGER NOT NULL,
    through INTEGER NOT NULL, count INTEGER NOT NULL, cells BLOB NOT NULL, PRIMARY KEY (robot, level, x, y));
CREATE TABLE poses (
    robot TEXT NOT NULL, stamp_ns INTEGER NOT NULL, pose BLOB NOT NULL, covariance BLOB,
    PRIMARY KEY (robot, stamp_ns)) WITHOUT ROWID;
"""
"""`bases.cells` is the state up to history sequence `through`; a contribution's `revision` and `stamp_ns` are of all of
it. `history.cells` is null where they are in the message of that sequence."""

Where = tuple[str, int, int, int]
"""Robot, level, x, y."""
PLACE = "robot = ? AND level = ? AND x = ? AND y = ?"
ROBOTS = """
WITH RECURSIVE names(name) AS (
    SELECT min(robot) FROM deltas UNION ALL
    SELECT (SELECT min(robot) FROM deltas WHERE robot > name) FROM names WHERE name IS NOT NULL)
SELECT name FROM names WHERE name IS NOT NULL
"""
"""From one to the next by the index: DISTINCT would look at each delta."""
TOP = """
SELECT coalesce(max(revision), 0), coalesce(max(CASE WHEN since < revision THEN revision END), 0),
       coalesce(max(stamp_ns), 0) FROM deltas WHERE robot = ?
"""


class SqliteStore:
    """Open with `SqliteStore.create(...)` or `SqliteStore.open(...)`. May be used from several threads."""

    def __init__(self, path: Path, connection: sqlite3.Connection, map_: MapId, model: Model) -> None:
        self.file = path
        self._connection = connection
        self._map = map_
        self._model = model
        self._lock = threading.RLock()
        self._together = False
        self._tops: dict[str, _Top] = {}
        self._others = -1
        """SQLite's count of what other programs wrote, when `_tops` was found."""
        self._folding: Folding[Where] = Folding(self._fold, f"folding {path.name}")
        self._folds: dict[Where, _Fold] = {}
        """That the thread made, to be written with what is accepted next: it never has writers wait for the disk."""

    @classmethod
    def create(cls, path: Path, lattice: Lattice, model: Model, notes: Mapping[str, Any] | None = None) -> SqliteStore:
        """A new, empty store; raises StoreError if the file exists, OutputError if it can't be written.

        It is made under another name and gets its own when it is whole: a crash leaves no store that is none.
        """
        if path.exists():
            raise StoreError(f"{path}: exists already; open it, or choose another name")
        fresh = path.with_name(f".{path.name}.new")
        remove_store(fresh)
        try:
            with _faults(path), closing(_connect(fresh)) as connection:
                _lay_out(connection, map_id(model.name, lattice), model, notes or {})
            os.replace(fresh, path)
        finally:
            remove_store(fresh)
        store = cls.open(path)
        _write_ahead(store._connection)
        return store

    @classmethod
    def open(cls, path: Path) -> SqliteStore:
        """An existing store; raises StoreMismatch for what is no store, or one of a newer schema."""
        if not path.is_file():
            raise StoreMismatch(f"{path}: no such store; make one with 'terrafuse map … --out DIR'")
        with _faults(path):
            connection = _connect(path)
            _check_schema(path, connection)
            meta = dict(connection.execute("SELECT name, value FROM meta"))
        try:
            map_ = MapId(**json.loads(meta["map"]))
            model = make_model(map_.model, json.loads(meta["model"]))
        except (KeyError, TypeError, ValueError) as error:
            raise StoreMismatch(
                f"{path}: damaged (its description can't be read); restore a copy, or map again"
            ) from error
        return cls(path, connection, map_, model)

    @property
    def map(self) -> MapId:
        return self._map

    @property
    def model(self) -> Model:
        return self._model

    def close(self) -> None:
        try:
            self._end_folding()
        finally:
            with self._lock:
                self._connection.close()

    def finish(self) -> None:
        """Fold the write-ahead log in for good and close: the file is whole by itself, can be moved, and can be read
        from a folder that can't be written. Raises StoreError while another program has it open."""
        self._end_folding()
        with self._lock, _faults(self.file):
            ((mode,),) = self._connection.execute("PRAGMA journal_mode = DELETE").fetchall()
            if mode != "delete":
                raise StoreError(f"{self.file}: another program has it open; close that, and run again to finish")
            self._connection.close()

    def __enter__(self) -> SqliteStore:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def accept(self, delta: Delta, path: Iterable[PathPoint] = (), message: bytes | None = None) -> bool:
        self._folding.raise_fault()
        check_delta(delta, self._map, self._model, message)
        if len(delta.tiles) > MOST_TILES_A_MESSAGE:
            message = None
        frames = [None if message else pack_cells(tile.at, tile.cells) for tile in delta.tiles]
        nbytes = len(message) if message else sum(len(frame or b"") for frame in frames)
        with self._transaction() as connection:
            sequence = self._register(delta, message, nbytes)
            if sequence is None:
                return False
            if points := [(delta.robot, p.stamp_ns, p.T_world_sensor.matrix[:3].astype("<f8").tobytes()) for p in path]:
                connection.executemany("INSERT OR IGNORE INTO poses VALUES (?, ?, ?, NULL)", points)
            if message and delta.tiles:
                connection.execute("INSERT INTO messages VALUES (?, ?)", (sequence, message))
            for tile, frame in zip(delta.tiles, frames, strict=True):
                self._append(delta.robot, sequence, tile, frame)
            if delta.robot in self._tops:
                self._tops[delta.robot] = self._tops[delta.robot].with_(delta)
        return True

    @contextmanager
    def together(self) -> Iterator[None]:
        """Other threads wait: they never read what a crash may take back."""
        with self._lock:
            self._together = True
            try:
                yield
            finally:
                self._together = False
                self._commit()

    def _commit(self) -> None:
        with _faults(self.file):
            try:
                if self._connection.in_transaction:
                    self._connection.execute("COMMIT")
                    self._folds.clear()
            except sqlite3.DatabaseError:
                if self._connection.in_transaction:
                    self._connection.execute("ROLLBACK")
                self._tops.clear()
                raise

    def _register(self, delta: Delta, message: bytes | None, nbytes: int) -> int | None:
        """The delta's place in history; None if it is there already."""
        cursor = self._connection.execute(
            "INSERT OR IGNORE INTO deltas VALUES (NULL, ?, ?, ?, ?, ?, ?, ?, ?)",
            (*identity_of(delta, message), delta.stamp_ns, time.time_ns(), delta.cell_count, nbytes),
        )
        return cursor.lastrowid if cursor.rowcount else None

    def _append(self, robot: str, sequence: int, tile: TileCells, frame: bytes | None) -> None:
        where = (robot, tile.key.level, tile.key.x, tile.key.y)
        self._connection.execute(
            "INSERT INTO history VALUES (?, ?, ?, ?, ?, ?, ?)", (sequence, *where, len(tile.at), frame)
        )
        ((base, tail),) = self._connection.execute(
            "INSERT INTO contributions VALUES (?, ?, ?, ?, ?, ?, 0, ?) "
            "ON CONFLICT (robot, level, x, y) DO UPDATE SET revision = max(revision, excluded.revision), "
            "stamp_ns = max(stamp_ns, excluded.stamp_ns), tail_cells = tail_cells + excluded.tail_cells "
            "RETURNING base_cells, tail_cells",
            (*where, *tile.newest, len(tile.at)),
        ).fetchall()
        if _is_long(base, tail):
            if self._together:
                self._folding.put(where)
            else:
                self._rebase(self._folded(where, self._frames(where), tail))

    def _fold(self, where: Where) -> None:
        """Fold a contribution's tail into its base, while others write."""
        query = f"SELECT base_cells, tail_cells FROM contributions WHERE {PLACE}"
        with self._lock, _faults(self.file):
            sizes = self._connection.execute(query, where).fetchone()  # None: it was taken back
            if sizes is None or where in self._folds or not _is_long(*sizes):
                return
            frames = self._frames(where)
        fold = self._folded(where, frames, sizes[1])
        with self._lock:
            self._folds[where] = fold

    def _end_folding(self) -> None:
        self._folding.close()
        if self._folds:
            with self._transaction():
                pass

    def _folded(self, where: Where, frames: Sequence[_Frame], tail: int) -> _Fold:
        at, cells = sparse(self._dense(where, frames))
        return _Fold(where, frames[-1].sequence, len(at), pack_cells(at, cells), tail)

    def _begin(self) -> None:
        """What the thread folded comes first: what is then accepted counts on from there."""
        self._connection.execute("BEGIN IMMEDIATE")
        for fold in self._folds.values():
            self._rebase(fold)

    def _rebase(self, fold: _Fold) -> None:
        self._connection.execute(
            "INSERT OR REPLACE INTO bases VALUES (?, ?, ?, ?, ?, ?, ?)",
            (*fold.where, fold.through, fold.size, fold.packed),
        )
        self._connection.execute(
            f"UPDATE contributions SET base_cells = ?, tail_cells = tail_cells - ? WHERE {PLACE}",
            (fold.size, fold.tail, *fold.where),
        )

    def _dense(self, where: Where, frames: Sequence[_Frame]) -> Array:
        """A contribution as (T²,) cells. The newest frames first: of the older ones most cells need no copy then."""
        side = self._map.lattice.tile_cells
        dense = np.zeros(side * side, self._model.cell)
        for frame in reversed(frames):
            newest(dense, *self._unpacked(where, frame))
        return dense

    def _unpacked(self, where: Where, frame: _Frame) -> tuple[Array, Array]:
        if frame.packed is not None:
            return unpack_cells(frame.packed, frame.size, self._model.cell, self._map.lattice.tile_cells)
        _, level, x, y = where
        key = TileKey(x, y, level)
        (tile,) = (tile for tile in decode(frame.message, self._model.cell).tiles if tile.key == key)
        return tile.at, tile.cells

    def _frames(self, where: Where) -> list[_Frame]:
        """Base and tail."""
        base = self._connection.execute(
            f"SELECT through, count, cells, NULL FROM bases WHERE {PLACE}", where
        ).fetchall()
        tail = self._connection.execute(
            "SELECT h.sequence, h.count, h.cells, m.message FROM history AS h "
            f"LEFT JOIN messages AS m ON m.sequence = h.sequence AND h.cells IS NULL WHERE {PLACE} AND h.sequence > ? "
            "ORDER BY h.sequence",
            (*where, base[0][0] if base else 0),
        ).fetchall()
        return [_Frame(*row) for row in (*base, *tail)]

    def robots(self) -> list[str]:
        return [name for (name,) in self._read(ROBOTS)]

    def version(self) -> Hashable:
        """Changes with every delta that is accepted, here or by another program."""
        with self._lock, _faults(self.file):
            (others,) = self._connection.execute("PRAGMA data_version").fetchone()
            return others, self._connection.total_changes

    def keys(self) -> list[TileKey]:
        return sorted(TileKey(*row) for row in self._read("SELECT DISTINCT x, y, level FROM contributions"))

    def revision(self, robot: str) -> int:
        return self._top(robot).revision

    def level(self, robot: str) -> int:
        return self._top(robot).level

    def stamp(self, robot: str) -> Stamp:
        return self._top(robot).stamp_ns

    def _top(self, robot: str) -> _Top:
        """Found once: a robot may have sent a delta a second for days."""
        with self._lock, _faults(self.file):
            (others,) = self._connection.execute("PRAGMA data_version").fetchone()
            if others != self._others:
                self._tops.clear()
                self._others = others
            if robot not in self._tops:
                self._tops[robot] = _Top(*self._connection.execute(TOP, (robot,)).fetchone())
            return self._tops[robot]

    def revisions(self, robot: str) -> dict[TileKey, int]:
        rows = self._read("SELECT x, y, level, revision FROM contributions WHERE robot = ?", (robot,))
        return {TileKey(x, y, level): revision for x, y, level, revision in rows}

    def load(self, robot: str, key: TileKey) -> TileCells | None:
        where = (robot, key.level, key.x, key.y)
        with self._lock, _faults(self.file):
            frames = self._frames(where)
        at, cells = sparse(self._dense(where, frames))
        return TileCells(key, at, cells) if len(at) else None

    def poses(self, robot: str) -> list[PathPoint]:
        rows = self._read("SELECT stamp_ns, pose FROM poses WHERE robot = ? ORDER BY stamp_ns", (robot,))
        return [PathPoint(stamp, _pose(blob)) for stamp, blob in rows]

    def history(self) -> list[HistoryEntry]:
        rows = self._read(
            "SELECT sequence, robot, since, revision, stamp_ns, arrival_ns, cells, nbytes FROM deltas ORDER BY sequence"
        )
        return [HistoryEntry(*row) for row in rows]

    def notes(self) -> Mapping[str, Any]:
        """What `create` was given to remember, by name."""
        rows = self._read("SELECT name, value FROM meta WHERE name LIKE 'note:%' ORDER BY name")
        return {name.removeprefix("note:"): json.loads(value) for name, value in rows}

    @contextmanager
    def unchanged(self) -> Iterator[None]:
        """While the block runs, no other thread writes by this object: several reads tell of one state."""
        with self._lock:
            yield

    def _read(self, query: str, values: tuple[Any, ...] = ()) -> list[Any]:
        with self._lock, _faults(self.file):
            return self._connection.execute(query, values).fetchall()

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        """All of it or nothing; within `together` a part of what is made to last at its end."""
        with self._lock, _faults(self.file):
            try:
                with self._part() if self._together else self._whole():
                    yield self._connection
            except BaseException:
                self._tops.clear()
                raise

    @contextmanager
    def _whole(self) -> Iterator[None]:
        with self._connection:
            self._begin()
            yield
        self._folds.clear()

    @contextmanager
    def _part(self) -> Iterator[None]:
        if not self._connection.in_transaction:
            self._begin()
        self._connection.execute("SAVEPOINT one")
        try:
            yield
        except BaseException:
            if self._connection.in_transaction:  # a full disk may have ended it
                self._connection.execute("ROLLBACK TO one")
            raise
        finally:
            if self._connection.in_transaction:
                self._connection.execute("RELEASE one")


class _Top(NamedTuple):
    """The newest of a robot's deltas; 0 where there is none."""

    revision: int
    level: int
    stamp_ns: Stamp

    def with_(self, delta: Delta) -> _Top:
        level = delta.revision if delta.since < delta.revision else 0
        return _Top(max(self.revision, delta.revision), max(self.level, level), max(self.stamp_ns, delta.stamp_ns))


class _Frame(NamedTuple):
    """Cells of a tile as they lie there: packed by themselves, or in a message."""

    sequence: int
    size: int
    """Cells."""
    packed: bytes | None
    message: bytes


class _Fold(NamedTuple):
    """What a contribution's base is to become."""

    where: Where
    through: int
    """Which of its history it has in it."""
    size: int
    """Cells."""
    packed: bytes
    tail: int
    """Cells that were in its tail."""


def _is_long(base_cells: int, tail_cells: int) -> bool:
    return tail_cells > max(2 * base_cells, MIN_TAIL_CELLS)


def _connect(path: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(path, timeout=30, isolation_level=None, check_same_thread=False)
    # FULL: what was acknowledged survives a power cut too, not only a killed process.
    connection.executescript("PRAGMA synchronous = FULL; PRAGMA cache_size = -32768;")
    return connection


def _lay_out(connection: sqlite3.Connection, map_: MapId, model: Model, notes: Mapping[str, Any]) -> None:
    values = {"map": asdict(map_), "model": model.settings()} | {f"note:{name}": note for name, note in notes.items()}
    with connection:
        connection.execute("BEGIN IMMEDIATE")
        for statement in filter(str.strip, TABLES.split(";")):
            connection.execute(statement)
        connection.executemany("INSERT INTO meta VALUES (?, ?)", [(k, json.dumps(v)) for k, v in values.items()])
        connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
        connection.execute(f"PRAGMA user_version = {SCHEMA}")


def _write_ahead(connection: sqlite3.Connection) -> None:
    """So that readers never wait. Only for a store that grows: the mode is kept in the file, and reading a finished
    store must not change it."""
    connection.execute("PRAGMA journal_mode = WAL")


def remove_store(path: Path) -> None:
    """Delete a store's file and what SQLite keeps beside it."""
    for suffix in ("", "-wal", "-shm", "-journal"):
        Path(f"{path}{suffix}").unlink(missing_ok=True)


def removed_if_empty(store: SqliteStore) -> bool:
    """Close a store, and delete it if it holds no report: it may be made again by other settings."""
    empty = not store.robots()
    store.close()
    if empty:
        remove_store(store.file)
    return empty


def _check_schema(path: Path, connection: sqlite3.Connection) -> None:
    (application,) = connection.execute("PRAGMA application_id").fetchone()
    (schema,) = connection.execute("PRAGMA user_version").fetchone()
    if application != APPLICATION_ID:
        connection.close()
        raise StoreMismatch(f"{path}: an SQLite file, but not a terrafuse store")
    if schema > SCHEMA:
        connection.close()
        raise StoreMismatch(
            f"{path}: store schema {schema} is newer than {SCHEMA}, the newest known here: pip install -U terrafuse"
        )
    if schema < SCHEMA:
        connection.close()
        what = f"of schema {schema}, older than {SCHEMA}, which this terrafuse reads" if schema else "never finished"
        raise StoreMismatch(f"{path}: a store {what}; delete it and map again")


def _pose(blob: bytes) -> Pose:
    matrix = np.eye(4)
    matrix[:3] = np.frombuffer(blob, "<f8").reshape(3, 4)
    return Pose(matrix)


@contextmanager
def _faults(path: Path) -> Iterator[None]:
    """SQLite's faults as ours, with the file and the remedy."""
    try:
        yield
    except sqlite3.DatabaseError as error:
        text = str(error)
        if "full" in text or "disk I/O" in text:
            raise OutputError(f"{path}: can't be written ({text}); free some space and run again to go on") from error
        if "unable to open" in text or "readonly" in text:
            raise OutputError(
                f"{path}: can't be opened for writing ({text}); check the folder's permissions"
            ) from error
        if "locked" in text:
            raise StoreError(f"{path}: another program has it open; close that, and run again to finish") from error
        if "not a database" in text:
            raise StoreMismatch(f"{path}: not a terrafuse store") from error
        if "malformed" in text or "no such table" in text:
            raise StoreMismatch(f"{path}: damaged ({text}); restore a copy, or map the logs again") from error
        raise StoreError(f"{path}: {text}") from error
