"""Three robots' deltas over a radio that does all wrong: the replica ends with the map of the undisturbed run."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field

import pytest

from terrafuse.exchange.codec import decode, encode
from terrafuse.exchange.links import Faults, Link
from terrafuse.lattice import Lattice
from terrafuse.models import make_model
from terrafuse.replica import Replica
from terrafuse.simulate.radio import Radio, RadioCut, RadioSettings
from terrafuse.testing.deltas import deltas_of, random_scans

TICK_NS = 50_000_000
HEAD = struct.Struct("<IHHH")
"""Of a part: CRC-32 of what follows, number of the message, number of the part, parts of the message."""


def parts_of(number: int, message: bytes, most: int) -> dict[tuple[int, int], bytes]:
    room = most - HEAD.size
    cuts = [message[at : at + room] for at in range(0, len(message), room)]
    bodies = [HEAD.pack(0, number, k, len(cuts))[4:] + cut for k, cut in enumerate(cuts)]
    return {(number, k): struct.pack("<I", zlib.crc32(body)) + body for k, body in enumerate(bodies)}


def opened(part: bytes) -> tuple[int, int, int, bytes] | None:
    """(message, part, parts, bytes), or None if it was damaged."""
    if len(part) < HEAD.size or zlib.crc32(part[4:]) != HEAD.unpack_from(part)[0]:
        return None
    _, number, k, of = HEAD.unpack_from(part)
    return number, k, of, part[HEAD.size :]


@dataclass
class Robot:
    """Sends every part again and again until it is acknowledged: the simplest thing that can work."""

    link: Link
    unacknowledged: dict[tuple[int, int], bytes]

    def tick(self, now_ns: int) -> None:
        for frame in self.link.receive(now_ns):
            if (opened_ := opened(frame.payload)) is not None:
                self.unacknowledged.pop(opened_[:2], None)
        if now_ns % (10 * TICK_NS) == 0:
            for part in self.unacknowledged.values():
                self.link.send(f"delta/{self.link.node}", part, now_ns)


@dataclass
class Station:
    link: Link
    replica: Replica
    parts: dict[tuple[str, int], dict[int, bytes]] = field(default_factory=dict)
    refused: int = 0

    def tick(self, now_ns: int) -> None:
        for frame in self.link.receive(now_ns):
            robot = frame.topic.removeprefix("delta/")
            if (part := opened(frame.payload)) is None:
                self.refused += 1
                continue
            number, k, of, content = part
            held = self.parts.setdefault((robot, number), {})
            held[k] = content
            if len(held) == of:
                # Again for every repetition, too: that must make no difference.
                message = b"".join(held[at] for at in range(of))
                self.replica.apply(decode(message, self.replica.model.cell))
            body = HEAD.pack(0, number, k, of)[4:]
            self.link.send(f"reply/{robot}", struct.pack("<I", zlib.crc32(body)) + body, now_ns)


FAULTS = Faults(
    loss=0.2, duplication=0.2, corruption=0.15, reordering=0.2, held_s=0.7,
    delay_s=0.01, jitter_s=0.05, bytes_per_s=60_000.0, overhead_bytes=12, queue_bytes=30_000.0,
)  # fmt: skip


@pytest.mark.parametrize("model_name", ["elevation", "occupancy"])
def test_three_robots_over_a_bad_radio_make_the_map_of_a_good_one(model_name: str) -> None:
    lattice, model = Lattice(0.5, 10.0), make_model(model_name)
    deltas = {f"r{n}": deltas_of(f"r{n}", random_scans(n, 24), lattice, model, every=2) for n in (1, 2, 3)}
    undisturbed = Replica(lattice, model)
    for delta in (one for several in deltas.values() for one in several):
        undisturbed.apply(delta)

    cuts = (RadioCut(1.0, 6.0, "r2"), RadioCut(3.0, 4.0))
    radio = Radio(RadioSettings(range_m=100.0, faults=FAULTS, cuts=cuts), seed=5)
    station = Station(radio.link("station", (0.0, 0.0, 0.0)), Replica(lattice, model))
    station.link.listen("delta")
    robots = []
    for name, several in deltas.items():
        link = radio.link(name, (60.0, 0.0, 0.0))
        link.listen(f"reply/{name}")
        parts: dict[tuple[int, int], bytes] = {}
        for number, delta in enumerate(several):
            parts |= parts_of(number, encode(delta), link.max_frame_bytes)
        robots.append(Robot(link, parts))

    def run(from_s: float, to_s: float) -> None:
        for now_ns in range(int(from_s * 1e9), int(to_s * 1e9), TICK_NS):
            # r3 is out of reach for a while.
            radio.move("r3", (60.0 if now_ns > 8e9 else 150.0, 0.0, 0.0), now_ns)
            for node in (*robots, station):
                node.tick(now_ns)

    run(0.0, 3.0)
    assert any(robot.unacknowledged for robot in robots)
    assert station.replica.digest() != undisturbed.digest()
    run(3.0, 60.0)
    assert not any(robot.unacknowledged for robot in robots)
    assert station.replica.digest() == undisturbed.digest()
    happened = sum(radio.counts.values(), start=type(radio.counts["r1"])())
    for fault in ("lost", "duplicated", "corrupted", "reordered", "cut", "out_of_reach"):
        assert happened[fault] > 0, fault
    assert station.refused > 0
