"""Both stores keep the laws; the SQLite one survives."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from terrafuse.errors import OutputError, StoreError, StoreMismatch
from terrafuse.replica import Replica
from terrafuse.store.base import Store
from terrafuse.store.behind import WriteBehind
from terrafuse.store.memory import MemoryStore
from terrafuse.store.sqlite import SqliteStore
from terrafuse.testing.deltas import deltas_of, random_scans
from terrafuse.testing.stores import LATTICE, MODEL, StoreTests


class TestMemoryStore(StoreTests):
    @pytest.fixture
    def store(self) -> Store:
        return MemoryStore(LATTICE, MODEL)


class TestSqliteStore(StoreTests):
    @pytest.fixture
    def store(self, tmp_path: Path) -> Iterator[Store]:
        with SqliteStore.create(tmp_path / "map.db", LATTICE, MODEL) as store:
            yield store


class TestSqliteStoreWithShortTails(StoreTests):
    """Every delta is folded into the base at once, where usually it waits in the tail."""

    @pytest.fixture
    def store(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Store]:
        monkeypatch.setattr("terrafuse.store.sqlite.MIN_TAIL_CELLS", 0)
        with SqliteStore.create(tmp_path / "map.db", LATTICE, MODEL) as store:
            yield store


class TestSqliteStoreWithAMessageForAll(StoreTests):
    """However many tiles a message has, it is kept as it came; and tails are folded by the thread at once."""

    @pytest.fixture
    def store(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Store]:
        monkeypatch.setattr("terrafuse.store.sqlite.MIN_TAIL_CELLS", 0)
        monkeypatch.setattr("terrafuse.store.sqlite.MOST_TILES_A_MESSAGE", 1000)
        with SqliteStore.create(tmp_path / "map.db", LATTICE, MODEL) as store:
            yield store


def filled(path: Path) -> SqliteStore:
    store = SqliteStore.create(path, LATTICE, MODEL)
    for delta in deltas_of("r1", random_scans(1, 8), LATTICE, MODEL):
        store.accept(delta)
    return store


def test_a_store_opens_again_with_the_same_map(tmp_path: Path) -> None:
    with filled(tmp_path / "map.db") as store:
        digest = Replica(store=store).digest()
    assert [p.name for p in tmp_path.iterdir()] == ["map.db"]
    with SqliteStore.open(tmp_path / "map.db") as store:
        assert Replica(store=store).digest() == digest
        assert store.map == MemoryStore(LATTICE, MODEL).map


def test_a_copy_taken_in_the_middle_opens_with_whole_deltas(tmp_path: Path) -> None:
    """What a crash leaves: the file and its write-ahead log, as they are at some instant."""
    store = filled(tmp_path / "map.db")
    for name in ("map.db", "map.db-wal"):
        shutil.copy(tmp_path / name, tmp_path / f"crashed-{name}")
    (tmp_path / "crashed-map.db-wal").rename(tmp_path / "crashed.db-wal")
    (tmp_path / "crashed-map.db").rename(tmp_path / "crashed.db")
    with SqliteStore.open(tmp_path / "crashed.db") as crashed:
        assert Replica(store=crashed).digest() == Replica(store=store).digest()
    store.close()


def test_a_fault_in_the_middle_of_a_delta_leaves_none_of_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = filled(tmp_path / "map.db")
    before, history = Replica(store=store).digest(), store.history()
    (delta,) = deltas_of("r2", random_scans(9, 1), LATTICE, MODEL)
    assert len(delta.tiles) > 2
    append, calls = store._append, 0

    def failing(*arguments: object) -> None:
        nonlocal calls
        calls += 1
        if calls == 3:
            raise sqlite3.OperationalError("database or disk is full")
        append(*arguments)

    monkeypatch.setattr(store, "_append", failing)
    assert store.revision("r2") == 0
    with pytest.raises(OutputError, match=r"map\.db: can't be written .*free some space"):
        store.accept(delta)
    monkeypatch.undo()
    assert store.revision("r2") == 0
    assert Replica(store=store).digest() == before
    assert store.history() == history
    assert store.accept(delta)
    store.close()


def test_a_real_full_store_is_refused_and_loses_nothing(tmp_path: Path) -> None:
    store = filled(tmp_path / "map.db")
    before = Replica(store=store).digest()
    (pages,) = store._connection.execute("PRAGMA page_count").fetchone()
    store._connection.execute(f"PRAGMA max_page_count = {pages}")
    refused = 0
    for seed in range(20):
        for delta in deltas_of(f"r{seed}", random_scans(seed, 3), LATTICE, MODEL):
            try:
                store.accept(delta)
                before = Replica(store=store).digest()
            except OutputError as error:
                assert "full" in str(error)  # noqa: PT017, which delta is the first to be refused is SQLite's business
                refused += 1
    assert refused > 0
    assert Replica(store=store).digest() == before
    store.close()


def test_what_another_program_writes_is_seen(tmp_path: Path) -> None:
    first, second, *_ = deltas_of("r1", random_scans(1, 8), LATTICE, MODEL)
    with SqliteStore.create(tmp_path / "map.db", LATTICE, MODEL) as store:
        store.accept(first)
        assert (store.revision("r1"), store.level("r1"), store.stamp("r1")) == (1, 1, first.stamp_ns)
        with SqliteStore.open(tmp_path / "map.db") as other:
            other.accept(second)
        assert (store.revision("r1"), store.level("r1"), store.stamp("r1")) == (2, 2, second.stamp_ns)
        store.accept(deltas_of("r0", random_scans(1, 1), LATTICE, MODEL)[0])
        assert store.robots() == ["r0", "r1"]


def test_a_newer_schema_is_refused(tmp_path: Path) -> None:
    filled(tmp_path / "map.db").close()
    with sqlite3.connect(tmp_path / "map.db") as connection:
        connection.execute("PRAGMA user_version = 99")
    with pytest.raises(StoreMismatch, match=r"map\.db: store schema 99 is newer .*pip install -U terrafuse"):
        SqliteStore.open(tmp_path / "map.db")


def test_what_is_no_store_is_refused(tmp_path: Path) -> None:
    (tmp_path / "text.db").write_text("not a database, whatever its name says " * 50)
    with pytest.raises(StoreMismatch, match=r"text\.db: not a terrafuse store"):
        SqliteStore.open(tmp_path / "text.db")
    sqlite3.connect(tmp_path / "other.db").execute("CREATE TABLE t (x)").connection.commit()
    with pytest.raises(StoreMismatch, match=r"other\.db: an SQLite file, but not a terrafuse store"):
        SqliteStore.open(tmp_path / "other.db")
    with pytest.raises(StoreMismatch, match="no such store"):
        SqliteStore.open(tmp_path / "missing.db")
    with pytest.raises(StoreError, match="exists already"):
        SqliteStore.create(tmp_path / "text.db", LATTICE, MODEL)


def test_write_behind_finds_what_still_waits(tmp_path: Path) -> None:
    with SqliteStore.create(tmp_path / "map.db", LATTICE, MODEL) as store:
        archive = WriteBehind(store)
        with store._lock:  # the writer can't get on
            deltas = deltas_of("r1", random_scans(3, 5), LATTICE, MODEL)
            for delta in deltas:
                archive.accept(delta)
            key = deltas[-1].tiles[0].key
            held = archive.load("r1", key)
        archive.close()
        written = store.load("r1", key)
        assert held is not None
        assert written is not None
        np.testing.assert_array_equal(held.cells, written.cells)
        assert store.revision("r1") == 5


def test_write_behind_reports_the_writers_fault(tmp_path: Path) -> None:
    with SqliteStore.create(tmp_path / "map.db", LATTICE, MODEL) as store:
        archive = WriteBehind(store)
        store._connection.execute("PRAGMA max_page_count = 1")
        for delta in deltas_of("r1", random_scans(3, 1, points=5000), LATTICE, MODEL):
            archive.accept(delta)
        with pytest.raises(OutputError, match="free some space"):
            archive.close()
