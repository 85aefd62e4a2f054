"""Schedules at random: whatever goes wrong, replicas that can reach each other end with the same bytes."""

from __future__ import annotations

from pathlib import Path

import pytest

from terrafuse.exchange.links import Faults, MemoryHub, MisbehavingLink
from terrafuse.simulate.radio import Place, Radio, RadioCut, RadioSettings, Surroundings
from terrafuse.testing.deltas import random_scans
from tests.exchange.fleet import agreed, run, star
from tests.exchange.schedules import DISTURBED_NS, Run, converges, schedule_of

MANY = 1000
AT_ONCE = 50


@pytest.mark.parametrize("first", range(0, MANY, AT_ONCE))
def test_over_links_that_misbehave(first: int) -> None:
    """`make soak` has 20,000 of them."""
    assert [seed for seed in range(first, first + AT_ONCE) if not converges(seed)] == []


FOUND = [3669, 13610, 18100]
"""By `make soak`: a robot that lost its memory passed on what another brought of its former life, as its own."""


@pytest.mark.parametrize("seed", FOUND)
def test_where_it_once_failed(seed: int) -> None:
    assert converges(seed)


LASTING = [seed for seed in range(400) if any(each.keeps == "everything" for each in schedule_of(seed).restarts)][:24]


@pytest.mark.parametrize("seed", LASTING)
def test_from_files_of_nodes_that_were_killed(seed: int, tmp_path: Path) -> None:
    assert converges(seed, folder=tmp_path)


@pytest.mark.parametrize("seed", range(10))
def test_over_radios_with_walls_and_places(seed: int) -> None:
    """A wall from south to north leaves 35 m of range; in the end it falls, and all come near."""
    schedule = schedule_of(seed)
    standing = [True]

    def sees(one: Place, two: Place) -> bool:
        return not standing[0] or (one[0] < 0) == (two[0] < 0)

    cuts = tuple(RadioCut(cut.from_s, cut.to_s, name) for name, some in schedule.cuts.items() for cut in some)
    faults = Faults(loss=0.3, duplication=0.3, jitter_s=0.3, bytes_per_s=50_000.0, overhead_bytes=12,
                    queue_bytes=30_000.0)  # fmt: skip
    settings = RadioSettings(100.0, 0.35, frame_bytes=schedule.frame_bytes, faults=faults, cuts=cuts)
    radio = Radio(settings, Surroundings(sees), seed)
    going = Run(schedule, lambda name: radio.link(name, (20.0 * (-1) ** int(name[1:]), 5.0, 0.0)))
    going.disturb()
    standing[0] = False
    for name in going.nodes:
        radio.move(name, (0.0, 0.0, 0.0), DISTURBED_NS)
    assert going.settle()


def test_nothing_of_it_is_random() -> None:
    """The same schedule gives the same bytes on the air."""

    def sent() -> list[dict[str, int]]:
        hub = MemoryHub(300)
        faults = Faults(loss=0.3, duplication=0.2, corruption=0.1, reordering=0.2)
        seeds = iter(range(10))
        scans = [random_scans(k, 10, 8.0, 12) for k in range(3)]
        nodes = star(scans, lambda name: MisbehavingLink(hub.link(name), faults, next(seeds)))
        run(nodes, 0, 10)
        assert agreed(nodes)
        return [dict(node.courier.counts) for node in nodes.values()]

    assert sent() == sent()
