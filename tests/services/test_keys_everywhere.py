"""With keys: stations above stations, robots alone, and who may correct whose poses."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("zenoh")
pytest.importorskip("cryptography")

from tests.program import terrafuse
from tests.services.drives import drive
from tests.services.processes import Processes, answers, digest, free_port
from tests.services.test_robots_alone import mapped

OPTIONS = ["--resolution", "0.2"]


def keys_of(folder: Path, *members: list[str]) -> Path:
    """The folder of all nodes' keys."""
    assert terrafuse("keys", "new-fleet", "--out", folder).code == 0
    for words in members:
        ran = terrafuse("keys", "add", *words, "--fleet", folder)
        assert ran.code == 0, ran.err
    return folder / "nodes"


def listens(name: str) -> list[str]:
    return [name, "--station", "--host", "127.0.0.1"]


def test_a_station_above_a_station_and_who_may_correct(tmp_path: Path) -> None:
    """The lower one's robot is corrected by the lower station's keys, by nobody else's robot and by no operator."""
    log = drive(tmp_path / "log")
    expected = mapped({"r1": log}, OPTIONS, tmp_path / "map")
    keys = keys_of(tmp_path / "fleet", listens("city"), listens("yard"), ["r1"], ["r2"], ["ops"])
    city, yard = (f"tls/127.0.0.1:{free_port()}" for _ in range(2))
    with Processes(tmp_path) as fleet:

        def station(name: str, where: str, *more: str) -> None:
            fleet.start(
                name, "station", "--name", name, "--store", f"{name}.db", "--listen", where, "--keys", keys / name,
                *OPTIONS, *more,
            )  # fmt: skip
            fleet.until(lambda: answers(int(where.rpartition(":")[2])), f"that {name} listens")

        def correct(who: str) -> tuple[int, str]:
            ran = terrafuse(
                "correct", "r1", "--connect", yard, "--station", "yard", "--keys", keys / who,
                "--shift-east", "10", "--id", "east",
            )  # fmt: skip
            return ran.code, ran.err

        station("city", city)
        station("yard", yard, "--upstream", city, "--upstream-station", "city")
        robot = ["robot", "r1", "--connect", yard, "--station", "yard", "--source", log, "--keys", str(keys / "r1")]
        fleet.start("r1", *robot, *OPTIONS)
        fleet.until(lambda: fleet.code("r1") is not None, "that r1 ends")
        assert fleet.code("r1") == 0
        fleet.until(lambda: digest(tmp_path / "city.db") == expected, "that the upper one holds r1's")

        for who in ("r2", "ops"):
            assert correct(who) == (2, f"error: 'yard' says: '{who}' may not correct the poses of 'r1' here\n")
        assert not (tmp_path / "yard.corrections").exists()
        assert correct("r1")[0] == 0
        fleet.again("r1")
        fleet.until(lambda: fleet.code("r1") is not None, "that r1 ends once more")
        fleet.until(
            lambda: digest(tmp_path / "city.db") == digest(tmp_path / "r1.db"), "that all hold the corrected map"
        )
        assert digest(tmp_path / "city.db") == digest(tmp_path / "yard.db") != expected
        assert [fleet.stop(name)[0] for name in ("yard", "city")] == [0, 0]


def test_robots_alone(tmp_path: Path) -> None:
    """Each may pass on the other's report; one without a certificate of theirs is not let in."""
    logs = {f"r{k}": drive(tmp_path / f"log{k}", k) for k in (1, 2)}
    expected = mapped(logs, OPTIONS, tmp_path / "map")
    first = ["r1", "--host", "127.0.0.1", "--relay-for", "r2"]
    keys = keys_of(tmp_path / "fleet", first, ["r2", "--relay-for", "r1"])
    others = keys_of(tmp_path / "others", ["r2"])
    where = f"tls/127.0.0.1:{free_port()}"
    with Processes(tmp_path) as fleet:

        def robot(name: str, folder: Path, *words: str) -> None:
            fleet.start(name, "robot", name, *words, "--source", logs[name], "--keys", folder / name, *OPTIONS)

        robot("r1", keys, "--listen", where, "--peer", "r2")
        fleet.until(lambda: answers(int(where.rpartition(":")[2])), "that r1 listens")
        robot("r2", others, "--connect", where, "--peer", "r1")
        fleet.until(lambda: "is not of this fleet" in fleet.text("r2"), "that a stranger is told why")
        fleet.stop("r2")
        robot("r2", keys, "--connect", where, "--peer", "r1")
        fleet.until(lambda: None not in map(fleet.code, logs), "that both end")
        assert [fleet.code(name) for name in logs] == [0, 0]
    assert [digest(tmp_path / f"{name}.replica.db") for name in logs] == [expected] * 2
