"""A store is one node's at a time; who only reads it need not wait."""

from __future__ import annotations

from pathlib import Path

import pytest

from terrafuse.errors import StoreMismatch
from terrafuse.exchange.links import MemoryHub
from terrafuse.services.lock import alone
from terrafuse.services.node import make_node
from tests.program import terrafuse
from tests.services.drives import drive
from tests.services.processes import Processes, answers, cells_in, free_port
from tests.services.test_one_process import hold_something, settings_of

TAKEN = r"station.db: another station or robot \(process \d+\) runs on this store; stop that, or give"


def test_one_at_a_time_and_nothing_is_left(tmp_path: Path) -> None:
    store = tmp_path / "station.db"
    with alone(store):
        with pytest.raises(StoreMismatch, match=TAKEN), alone(tmp_path / "." / "station.db"):
            pass
        with alone(tmp_path / "r1.db"):
            pass
    with alone(store):
        pass
    assert not list(tmp_path.iterdir())


def test_another_name_of_the_file_is_the_same_store(tmp_path: Path) -> None:
    (tmp_path / "station.db").touch()
    (tmp_path / "other.db").symlink_to("station.db")
    with alone(tmp_path / "other.db"), pytest.raises(StoreMismatch, match=TAKEN), alone(tmp_path / "station.db"):
        pass


def test_what_a_killed_process_left_is_nobodys(tmp_path: Path) -> None:
    (tmp_path / "station.db.lock").write_text("4711")
    with alone(tmp_path / "station.db"):
        pass


def test_nodes_hold_their_stores_until_they_are_closed(tmp_path: Path) -> None:
    settings = settings_of({"r1": Path(drive(tmp_path / "log"))}, tmp_path)
    for name in settings.nodes:
        carry = lambda name: lambda: MemoryHub().link(name)  # noqa: E731
        node = make_node(settings, name, carry)
        with pytest.raises(StoreMismatch, match="runs on this store"):
            make_node(settings, name, carry)
        node.close()
        make_node(settings, name, carry).close()
    hold_something(tmp_path / "station.db")
    coarser = settings.model_copy(update={"map": settings.map.model_copy(update={"resolution_m": 0.4})})
    with pytest.raises(StoreMismatch, match="ask for the same"):
        make_node(coarser, "station", carry)
    make_node(settings, "station", carry).close()  # what failed to begin has let go


def test_processes(tmp_path: Path) -> None:
    """A second of each ends at once, and changes nothing; reading goes on; a killed one's store is free."""
    pytest.importorskip("zenoh")
    port = free_port()
    options = ["--resolution", "0.2", "--insecure"]
    station = ["station", "--store", "s.db", "--listen", f"tcp/127.0.0.1:{port}", *options]
    log = drive(tmp_path / "log", scans=120)
    robot = ["robot", "r1", "--connect", f"tcp/127.0.0.1:{port}", *options, "--source", log]
    with Processes(tmp_path) as fleet:
        fleet.start("station", *station)
        fleet.until(lambda: answers(port), "that the station listens")
        fleet.start("r1", *robot, "--realtime")
        fleet.until(lambda: cells_in(tmp_path / "s.db") > 0, "that the station holds something")
        for words in (station, robot):
            ran = terrafuse(*words, cwd=tmp_path)
            assert ran.code == 2
            assert "runs on this store; stop that, or give this one another --store" in ran.err
        for store in ("s.db", "r1.db"):
            assert terrafuse("info", store, cwd=tmp_path).code == 0
            shown = terrafuse("export", store, "--layer", "height", "--out", f"{store}.png", cwd=tmp_path)
            assert shown.code == 0, shown.err
        fleet.kill("r1")
        fleet.start("r1", *robot)
        fleet.until(lambda: fleet.code("r1") is not None, "that it ends")
        assert fleet.code("r1") == 0
        assert fleet.stop("station")[0] == 0
    assert not list(tmp_path.glob("*.lock"))
