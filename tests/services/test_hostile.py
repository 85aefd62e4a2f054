"""What other nodes say may be anything: it is counted, and no service is started again for it."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from math import nan
from pathlib import Path

import pytest
import zstandard

from terrafuse.cli.asking import entry_json, print_table
from terrafuse.cli.correcting import look_up
from terrafuse.errors import OutputError
from terrafuse.exchange.asking import ASK, Question, encode_message
from terrafuse.exchange.courier import Courier
from terrafuse.exchange.links import MemoryHub
from terrafuse.services.book import replace_file
from terrafuse.services.directory import Entry
from terrafuse.services.node import Node, make_node
from terrafuse.services.service import Status
from terrafuse.services.settings import FleetSettings

SURROGATE = json.dumps({"map": {"model": "\ud800"}, "settings": {}}).encode()
FAR = Question(what="picture", channel="fine", area=(-1e308, -1e308, 1e308, 1e308))
NESTED = b"\x91" * 50_000 + b"\xc0"


def posted(kind: str, payload: bytes, tmp_path: Path) -> Node:
    """A station to which somebody posted this, and which has acknowledged it."""
    settings = FleetSettings.model_validate({
        "map": {"resolution_m": 0.2}, "link": {"kind": "memory"}, "station": {"store": str(tmp_path / "s.db")},
    })  # fmt: skip
    hub = MemoryHub()
    node = make_node(settings, "station", lambda name: lambda: hub.link(name))
    mallory = Courier(hub.link("mallory"), peers=["station"])
    mallory.post("station", kind, payload)
    node.supervisor.start("station ")
    try:
        until(lambda: arrived(mallory))
        time.sleep(0.3)
    finally:
        node.supervisor.stop(5)
        node.close()
    return node


def arrived(mallory: Courier) -> bool:
    mallory.tick(time.time_ns())
    return bool(mallory.reached(time.time_ns())) and not mallory.waiting("station")


def until(what: Callable[[], bool], seconds: float = 20.0) -> None:
    deadline = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < deadline
        time.sleep(0.05)


@pytest.mark.parametrize(
    ("kind", "payload", "service", "count"),
    [
        ("map-manager terrafuse/map-manager/1 join ", SURROGATE, "map-manager", "refused.join"),
        ("map-manager terrafuse/map-manager/1 join ", b"[" * 60_000, "map-manager", "refused.join"),
        ("map-manager terrafuse/map-manager/1 join ", b"[1]", "map-manager", "refused.join"),
        ("map-manager terrafuse/map-manager/1 correct ", NESTED, "map-manager", "refused.correction"),
        (f"{ASK}3", encode_message(FAR), "map-manager", "questions.refused"),
        ("directory terrafuse/directory/1 states ", zstandard.compress(NESTED), "directory", "refused.states"),
        ("correction", NESTED, "map-manager", "refused.post"),
    ],
)
def test_nothing_that_somebody_posts_restarts_a_service(
    kind: str, payload: bytes, service: str, count: str, tmp_path: Path
) -> None:
    node = posted(kind, payload, tmp_path)
    assert {status.name: status.restarts for status in node.statuses.values()} == dict.fromkeys(node.statuses, 0)
    assert node.statuses[service].counts[count] == 1


def test_what_nodes_say_of_themselves_is_shown_whatever_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    strange = Status("mapping", "c", "[/x]\x1b[31m", 0, (), 0, "[/x] oh", {}, {"place_m": [], "scans": nan})
    entry = Entry("r1", 1, 1, 0.0, False, [strange])
    print_table([entry])
    shown = capsys.readouterr().out
    assert "[/x] oh" in shown
    assert "\x1b[31m" not in shown
    assert json.dumps(entry_json(entry), allow_nan=False)
    assert look_up([entry], "station", "r1").place_m is None


def test_a_file_for_which_there_is_no_room_is_said(tmp_path: Path) -> None:
    (tmp_path / "x").mkdir()
    with pytest.raises(OutputError, match="can't be written"):
        replace_file(tmp_path / "x", b"in place of a folder")
    assert [each.name for each in tmp_path.iterdir()] == ["x"]
