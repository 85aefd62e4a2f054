"""Robots that round what they report: all replicas hold the rounded cells, and the same ones."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from terrafuse.errors import InputError
from terrafuse.exchange.parts import delta_since
from terrafuse.exchange.profiles import report
from terrafuse.lattice import Lattice
from terrafuse.models import make_model
from terrafuse.replica import Replica
from terrafuse.services.node import Node, make_node
from terrafuse.services.settings import FleetSettings
from terrafuse.store.sqlite import SqliteStore
from tests.services.test_one_process import digest, mapped_at_once, nodes_of, settings_of


def with_precision(settings: FleetSettings, precision: str) -> FleetSettings:
    robots = {name: part.model_copy(update={"precision": precision}) for name, part in settings.robots.items()}
    return settings.model_copy(update={"robots": robots})


def held(node: Node) -> object:
    manager = "map-manager" if node.name == "station" else "exchange"
    return node.statuses[manager].state.get("channels", {}).get("fine")


def level(nodes: list[Node]) -> None:
    """Run until all have the same of each robot."""
    deadline = time.monotonic() + 90
    for node in nodes:
        node.supervisor.start(node.name)
    try:
        while not (all(node.done for node in nodes[1:]) and all(held(node) == held(nodes[0]) for node in nodes)):
            assert time.monotonic() < deadline, [held(node) for node in nodes]
            time.sleep(0.1)
    finally:
        for node in nodes:
            node.supervisor.stop(5)
            node.close()


@pytest.mark.parametrize("precision", ["full", "lean"])
def test_all_replicas_hold_what_was_rounded(logs: dict[str, Path], tmp_path: Path, precision: str) -> None:
    settings = with_precision(settings_of(logs, tmp_path), precision)
    level(nodes_of(settings))
    rounded = Replica(Lattice(0.2, 40.0), model := make_model("elevation"))
    for name in logs:
        with SqliteStore.open(tmp_path / f"{name}.db") as own:
            rounded.apply(report(delta_since(own, name), precision, model))
    expected = rounded.digest()
    assert expected != mapped_at_once(settings, tmp_path)
    assert [digest(tmp_path / f"{name}.db") for name in ("station", "r1.replica", "r2.replica")] == [expected] * 3


def test_a_robot_keeps_to_its_precision(logs: dict[str, Path], tmp_path: Path) -> None:
    settings = settings_of({"r1": logs["r1"]}, tmp_path)
    level(nodes_of(with_precision(settings, "full")))
    for node in nodes_of(with_precision(settings, "full")):
        node.close()
    with pytest.raises(InputError, match=r"precision exact: what .*r1\.db holds was reported with full"):
        make_node(settings, "r1", lambda node: pytest.fail)
