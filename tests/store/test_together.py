"""What is accepted together: on disk at the end and not before, whatever happens; long tails are folded meanwhile."""

from __future__ import annotations

import signal
import sqlite3
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from terrafuse.errors import OutputError
from terrafuse.exchange.codec import encode
from terrafuse.exchange.delta import Delta
from terrafuse.replica import Replica
from terrafuse.store.folding import Folding
from terrafuse.store.sqlite import SqliteStore
from terrafuse.testing.deltas import deltas_of, random_scans
from terrafuse.testing.stores import LATTICE, MODEL

KILLED = """
import os, signal, sys
from pathlib import Path
from terrafuse.exchange.codec import encode
from terrafuse.store.sqlite import SqliteStore
from terrafuse.testing.deltas import deltas_of, random_scans
from terrafuse.testing.stores import LATTICE, MODEL

deltas = deltas_of("r1", random_scans(1, 8), LATTICE, MODEL)
store = SqliteStore.create(Path(sys.argv[1]), LATTICE, MODEL)
with store.together():
    for delta in deltas[:3]:
        store.accept(delta, message=encode(delta))
with store.together():
    for delta in deltas[3:]:
        assert store.accept(delta, message=encode(delta))
    os.kill(os.getpid(), signal.SIGKILL)
"""


def deltas() -> list[Delta]:
    return deltas_of("r1", random_scans(1, 8), LATTICE, MODEL)


def test_kill_9_takes_back_what_was_not_made_to_last_and_nothing_else(tmp_path: Path) -> None:
    path, expected = tmp_path / "map.db", Replica(LATTICE, MODEL)
    died = subprocess.run([sys.executable, "-c", KILLED, str(path)], timeout=120)
    assert died.returncode == -signal.SIGKILL
    for delta in deltas()[:3]:
        expected.apply(delta)
    with SqliteStore.open(path) as store:
        assert (store.revision("r1"), len(store.history())) == (3, 3)
        assert Replica(store=store).digest() == expected.digest()
        for delta in deltas()[3:]:
            assert store.accept(delta)
            expected.apply(delta)
        assert Replica(store=store).digest() == expected.digest()


def test_others_see_nothing_of_it_before_its_end(tmp_path: Path) -> None:
    with SqliteStore.create(tmp_path / "map.db", LATTICE, MODEL) as store:
        with store.together():
            for delta in deltas():
                store.accept(delta)
            with SqliteStore.open(tmp_path / "map.db") as other:
                assert other.history() == []
            seen: list[int] = []
            reader = threading.Thread(target=lambda: seen.append(store.revision("r1")))
            reader.start()
            assert store.revision("r1") == 8
            assert seen == []
        reader.join()
        assert seen == [8]
        with SqliteStore.open(tmp_path / "map.db") as other:
            assert len(other.history()) == 8


def test_a_fault_in_the_middle_of_a_delta_takes_back_that_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first, bad, last, *_ = deltas()
    with SqliteStore.create(tmp_path / "map.db", LATTICE, MODEL) as store:
        append = store._append

        def failing(robot: str, sequence: int, tile: object, *rest: object) -> None:
            append(robot, sequence, tile, *rest)
            if tile is bad.tiles[1]:
                raise sqlite3.OperationalError("disk I/O error")

        monkeypatch.setattr(store, "_append", failing)
        with store.together():
            store.accept(first)
            with pytest.raises(OutputError):
                store.accept(bad)
            store.accept(last)
        assert [entry.revision for entry in store.history()] == [1, 3]
        expected = Replica(LATTICE, MODEL)
        for delta in (first, last):
            expected.apply(delta)
        assert Replica(store=store).digest() == expected.digest()


def test_long_tails_are_folded_by_a_thread_while_more_comes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("terrafuse.store.sqlite.MIN_TAIL_CELLS", 0)
    expected = Replica(LATTICE, MODEL)
    path = tmp_path / "map.db"
    with SqliteStore.create(path, LATTICE, MODEL) as store:
        for seed in range(3):
            for delta in deltas_of(f"r{seed}", random_scans(seed, 8), LATTICE, MODEL):
                with store.together():
                    store.accept(delta, message=encode(delta))
                expected.apply(delta)
        store._folding.wait()
        assert Replica(store=store).digest() == expected.digest()
    with sqlite3.connect(path) as connection:
        unfolded = connection.execute(
            "SELECT count(*) FROM contributions WHERE tail_cells > 2 * base_cells"
        ).fetchone()[0]
        assert unfolded == 0
        assert connection.execute("SELECT count(*) FROM bases").fetchone()[0] > 3
    with SqliteStore.open(path) as store:
        assert Replica(store=store).digest() == expected.digest()


def test_what_folding_raises_is_raised_to_the_next_caller() -> None:
    def work(item: int) -> None:
        done.append(item)
        if item == 2:
            raise OutputError("the disk is full")

    done: list[int] = []
    folding = Folding(work, "folding")
    for item in (1, 2, 3):
        folding.put(item)
    folding.wait()
    folding.put(4)
    assert done == [1, 2]
    with pytest.raises(OutputError, match="full"):
        folding.raise_fault()
    folding.close()


def test_each_that_waits_is_folded_once() -> None:
    begun, go = threading.Event(), threading.Event()
    done: list[int] = []

    def work(item: int) -> None:
        begun.set()
        go.wait()
        done.append(item)

    folding = Folding(work, "folding")
    folding.put(1)
    begun.wait()
    for item in (2, 3, 2, 3, 1):
        folding.put(item)
    go.set()
    folding.wait()
    assert done == [1, 2, 3, 1]
    folding.put(5)
    folding.wait()
    assert done[-1] == 5
    folding.close()
