"""A listener that was written from docs/protocol.md alone comes to what a station holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from terrafuse.exchange.links import Frame, Link, MemoryHub, MisbehavingLink
from tests.exchange.independent_decoder import decode
from tests.exchange.independent_listener import Listener
from tests.exchange.schedules import Neighbours, Run, schedule_of


class Tapped:
    """A link of which all that leaves is written down."""

    def __init__(self, link: Link, frames: list[Frame]) -> None:
        self.node, self.max_frame_bytes = link.node, link.max_frame_bytes
        self.listen, self.receive, self.close = link.listen, link.receive, link.close
        self._link, self._frames = link, frames

    def send(self, topic: str, payload: bytes, now_ns: int) -> None:
        self._frames.append(Frame(topic, payload))
        self._link.send(topic, payload, now_ns)


@pytest.mark.parametrize("seed", [1, 4, 7, 12])
def test_recorded_traffic(seed: int) -> None:
    frames: list[Frame] = []
    schedule = replace(schedule_of(seed), restarts=())
    hub = MemoryHub(schedule.frame_bytes)

    def join(name: str) -> Link:
        link = MisbehavingLink(Neighbours(hub.link(name), schedule.ways[name]), schedule.faults, seed)
        return Tapped(link, frames)

    run = Run(schedule, join)
    for node in run.nodes.values():
        assert node.courier is not None
        node.courier.post(next(iter(schedule.ways[node.name])), "state", node.name.encode())
    run.disturb()
    assert run.settle()
    listener = Listener(decode)
    for frame in frames:
        listener.hear(*frame)
    listened = {topic.split("/")[0] for topic, _ in frames}
    assert {"summary", "delta", "post"} <= listened
    assert {post["payload"].decode() for post in listener.posts.values()} <= set(run.nodes)
    assert listener.summaries
    for node in run.nodes.values():
        for channel, store in node.stores.items():
            for robot in store.robots():
                held = listener.cells[channel, robot]
                # It hears every frame; a node may have lost the last claim.
                assert listener.base[channel, robot] >= store.level(robot)
                for key in store.revisions(robot):
                    tile = store.load(robot, key)
                    assert tile is not None
                    there = held[key.x, key.y]
                    assert sorted(there) == tile.at.tolist()
                    revisions = [there[position][0] for position in tile.at.tolist()]
                    np.testing.assert_array_equal(revisions, tile.cells["revision"])
