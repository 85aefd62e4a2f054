"""Three robots' maps over a radio that does all wrong: every replica ends with the map of the undisturbed run."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from terrafuse.exchange.coarse import CoarseContribution
from terrafuse.exchange.courier import Channel, Courier, CourierSettings
from terrafuse.exchange.links import Faults
from terrafuse.lattice import Lattice
from terrafuse.mapper import Mapper
from terrafuse.models import Model, make_model
from terrafuse.replica import Replica
from terrafuse.simulate.radio import Radio, RadioCut, RadioLink, RadioSettings
from terrafuse.testing.deltas import SECOND_NS, random_scans

TICK_NS = 50_000_000
LATTICE, FACTOR = Lattice(0.5, 10.0), 2
SETTINGS = CourierSettings(bytes_per_s=50_000.0)
FAULTS = Faults(
    loss=0.2, duplication=0.2, corruption=0.15, reordering=0.2, held_s=0.7,
    delay_s=0.01, jitter_s=0.05, bytes_per_s=60_000.0, overhead_bytes=12, queue_bytes=30_000.0,
)  # fmt: skip


@dataclass
class Node:
    """A robot scans twice a second; the station has no mapper."""

    replica: Replica
    courier: Courier
    mapper: Mapper | None = None
    own: CoarseContribution | None = None

    def tick(self, now_ns: int, number: int) -> None:
        if self.mapper is not None and self.own is not None and now_ns % (SECOND_NS // 2) == 0:
            if now_ns < 12 * SECOND_NS:
                self.mapper.integrate(random_scans(number, 24)[now_ns * 2 // SECOND_NS])
            self.own.update()
        self.courier.tick(now_ns)


def robot(link: RadioLink, model: Model) -> Node:
    mapper, replica = Mapper(link.node, LATTICE, model), Replica(LATTICE.coarser(FACTOR), model)
    own = CoarseContribution(mapper, FACTOR)
    return Node(
        replica,
        Courier(link, [Channel("coarse", replica.store, own)], peers=["station"], settings=SETTINGS),
        mapper,
        own,
    )


def station(link: RadioLink, model: Model) -> Node:
    replica = Replica(LATTICE.coarser(FACTOR), model)
    return Node(replica, Courier(link, [Channel("coarse", replica.store, relay=True)], settings=SETTINGS))


@pytest.mark.parametrize("model_name", ["elevation", "occupancy"])
def test_three_robots_over_a_bad_radio_make_the_map_of_a_good_one(model_name: str) -> None:
    model = make_model(model_name)
    cuts = (RadioCut(1.0, 6.0, "r2"), RadioCut(3.0, 4.0))
    radio = Radio(RadioSettings(range_m=100.0, faults=FAULTS, cuts=cuts), seed=5)
    nodes = [station(radio.link("station", (0.0, 0.0, 0.0)), model)]
    nodes += [robot(radio.link(f"r{n}", (60.0, 0.0, 0.0)), model) for n in (1, 2, 3)]

    def run(from_s: float, to_s: float) -> None:
        for now_ns in range(int(from_s * 1e9), int(to_s * 1e9), TICK_NS):
            # r3 is out of everybody's reach for a while.
            radio.move("r3", (60.0 if now_ns > 8e9 else 300.0, 0.0, 0.0), now_ns)
            for number, node in enumerate(nodes):
                node.tick(now_ns, number)

    run(0.0, 12.0)
    undisturbed = Replica(LATTICE, model)
    for node in nodes:
        if node.mapper is not None:
            undisturbed.apply(node.mapper.delta())
    expected = Replica(store=undisturbed.store, factor=FACTOR).digest()
    assert nodes[0].replica.digest() != expected
    run(12.0, 60.0)
    assert [node.replica.digest() for node in nodes] == [expected] * 4
    happened = sum(radio.counts.values(), start=type(radio.counts["r1"])())
    for fault in ("lost", "duplicated", "corrupted", "reordered", "cut", "out_of_reach"):
        assert happened[fault] > 0, fault
    assert nodes[0].courier.counts["refused.checksum"] > 0
