"""Nothing lost: SIGKILL while mapping, then the same command again."""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import time
from contextlib import closing
from pathlib import Path

import pytest

from terrafuse.replica import Replica
from terrafuse.store.sqlite import SqliteStore
from tests.program import PROGRAM, record, terrafuse


@pytest.fixture(scope="module")
def long_logs(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    folder = tmp_path_factory.mktemp("long")
    return [f"r{k}={record(folder / f'r{k}.mcap', k, 240, points=4000, shift_m=20.0 * k)}" for k in (1, 2)]


def committed(store: Path) -> int:
    """Deltas that are in the store, as another process sees them."""
    if not store.exists():
        return 0
    try:
        with closing(sqlite3.connect(f"file:{store}?mode=ro", uri=True)) as connection:
            return int(connection.execute("SELECT count(*) FROM deltas").fetchone()[0])
    except sqlite3.OperationalError:
        return 0


def killed_after(deltas: int, arguments: list[str], partial: Path) -> int:
    """Run the program, kill it once this many deltas are committed; returns how many there were just before."""
    process = subprocess.Popen([*PROGRAM, *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 120
    while (seen := committed(partial)) < deltas:
        assert process.poll() is None, "it ended before it could be killed"
        assert time.monotonic() < deadline
        time.sleep(0.002)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    return seen


def test_killed_runs_go_on_to_the_same_bytes(long_logs: list[str], tmp_path: Path) -> None:
    options = ["--resolution", "0.2", "--tile", "8"]  # small tiles: pages come and go
    undisturbed = terrafuse("map", *long_logs, *options, "--out", tmp_path / "whole", "--json")
    assert undisturbed.code == 0, undisturbed.err
    assert undisturbed.json["robots"]["r1"]["evictions"] > 0
    out, partial = tmp_path / "killed", tmp_path / "killed/map.partial.db"
    arguments = ["map", *long_logs, *options, "--out", str(out)]
    last = 0
    for deltas in (1, 6, 12):
        seen = killed_after(deltas, arguments, partial)
        assert seen >= last
        assert not (out / "map.db").exists()
        with SqliteStore.open(partial) as store:
            assert len(store.history()) >= seen  # every delta that was committed is there, and opens
            Replica(store=store).digest()
            last = len(store.history())
    finished = terrafuse(*arguments, "--json")
    assert finished.code == 0, finished.err
    assert finished.json["robots"]["r1"]["resumed_scans"] > 0
    assert finished.json["map"]["digest"] == undisturbed.json["map"]["digest"]
    assert not partial.exists()
    with SqliteStore.open(out / "map.db") as one, SqliteStore.open(tmp_path / "whole/map.db") as other:
        for robot in one.robots():
            for key in one.keys():
                a, b = one.load(robot, key), other.load(robot, key)
                assert (a is None) == (b is None)
                if a is not None and b is not None:
                    assert a.at.tobytes() == b.at.tobytes()
                    assert a.cells.tobytes() == b.cells.tobytes()
            assert len(one.poses(robot)) == len(other.poses(robot)) == 240


def test_an_unfinished_run_is_not_taken_for_another(long_logs: list[str], tmp_path: Path) -> None:
    out = tmp_path / "out"
    killed_after(1, ["map", *long_logs, "--out", str(out)], out / "map.partial.db")
    other = terrafuse("map", *long_logs, "--resolution", "0.5", "--out", out)
    assert other.code == 2
    assert "of a run with other logs or settings" in other.err
    assert (out / "map.partial.db").exists()
