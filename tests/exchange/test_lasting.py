"""What a node says that it holds, or passes on, is on disk by then: whatever kills it, nobody was told too much."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from terrafuse.exchange.codec import decode, encode
from terrafuse.exchange.courier import Channel, Courier
from terrafuse.exchange.framing import HEADER_BYTES
from terrafuse.exchange.links import Frame, MemoryHub
from terrafuse.exchange.links.memory import MemoryLink
from terrafuse.exchange.piece import decode_piece
from terrafuse.exchange.summary import unpack
from terrafuse.mapper import Mapper
from terrafuse.replica import Replica
from terrafuse.store.memory import MemoryStore
from terrafuse.store.sqlite import SqliteStore
from terrafuse.testing.deltas import SECOND_NS, random_scans
from terrafuse.testing.stores import LATTICE, MODEL

TICK_NS = SECOND_NS // 10


class Witness:
    """A link that looks, for each frame that leaves, at what another program finds in the file."""

    def __init__(self, link: MemoryLink, file: Path) -> None:
        self._link, self._file = link, file
        self.node, self.max_frame_bytes = link.node, link.max_frame_bytes
        self.told: dict[str, int] = {}

    def listen(self, topic: str) -> None:
        self._link.listen(topic)

    def receive(self, now_ns: int) -> list[Frame]:
        return self._link.receive(now_ns)

    def close(self) -> None:
        self._link.close()

    def send(self, topic: str, payload: bytes, now_ns: int) -> None:
        with SqliteStore.open(self._file) as found:
            for robot, revision in claimed(topic, payload[HEADER_BYTES:]).items():
                assert found.revision(robot) >= revision, f"{topic} tells of what is not on disk"
                self.told[topic.split("/")[0]] = max(self.told.get(topic.split("/")[0], 0), revision)
        self._link.send(topic, payload, now_ns)


def claimed(topic: str, message: bytes) -> dict[str, int]:
    """By robot, up to which revision somebody who hears this may think that the sender has it."""
    if topic.startswith("summary/"):
        summary = unpack(message)
        held = dict(summary.held.get("fine", {}))
        for robot, numbers in summary.ahead.get("fine", {}).items():
            held[robot] = held[robot] + max(numbers[2::3], default=0)
        return held
    if topic.startswith("delta/"):
        delta = decode(decode_piece(message).delta, MODEL.cell)
        return {delta.robot: max((tile.newest[0] for tile in delta.tiles), default=0)}
    return {}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "station.db"


def test_a_station_tells_nothing_that_a_crash_takes_back(file: Path) -> None:
    hub = MemoryHub()
    mappers = [Mapper(f"r{k}", LATTICE, MODEL) for k in range(3)]
    robots = [Courier(hub.link(m.robot), [Channel("fine", own=m)], peers=["station"]) for m in mappers]
    reader = MemoryStore(LATTICE, MODEL)
    with SqliteStore.create(file, LATTICE, MODEL) as store:
        witness = Witness(hub.link("station"), file)
        station = Courier(witness, [Channel("fine", store, relay=True)])
        for tick in range(80):
            for k, mapper in enumerate(mappers):
                if tick % 5 == 0 and tick < 40:
                    mapper.integrate(random_scans(10 * k + tick, 1)[0])
            if tick == 20:  # of what was before, it hears by the station alone
                robots.append(Courier(hub.link("reader"), [Channel("fine", reader)], peers=["station"]))
            for node in (*robots, station):
                node.tick(tick * TICK_NS)
        assert witness.told["summary"] == 8
        assert witness.told["delta"] >= 4
        assert Replica(store=reader).digest() == Replica(store=store).digest()


def test_a_station_keeps_messages_as_they_came(file: Path) -> None:
    """And what it makes of them after a restart is what it made of them before."""
    hub, mapper = MemoryHub(), Mapper("r1", LATTICE, MODEL)
    robot = Courier(hub.link("r1"), [Channel("fine", own=mapper)], peers=["station"])
    with SqliteStore.create(file, LATTICE, MODEL) as store:
        station = Courier(hub.link("station"), [Channel("fine", store)])
        mapper.integrate(random_scans(1, 1, 3.0)[0])
        for tick in range(30):
            for node in (robot, station):
                node.tick(tick * TICK_NS)
        digest = Replica(store=store).digest()
        ((message,),) = store._connection.execute("SELECT message FROM messages").fetchall()
        assert message == encode(replace(mapper.delta(0), since=1))
    with SqliteStore.open(file) as store:
        assert Replica(store=store).digest() == digest != Replica(LATTICE, MODEL).digest()
