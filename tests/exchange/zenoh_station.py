"""A station in a process of its own: python -m tests.exchange.zenoh_station NAME TRANSPORT_AS_JSON

It holds what robots report, passes it on, and keeps a list of every other frame's topic. Asked by lines on its standard
input: `nodes`, `topics` (those since it was asked last), `digest`, `level ROBOT`, `refused`; it answers with a line
of JSON.
"""

from __future__ import annotations

import json
import queue
import sys
import threading
import time
from contextlib import suppress
from typing import Any

from terrafuse.exchange.courier import Channel, Courier
from terrafuse.exchange.links import Frame
from terrafuse.exchange.links.transport import Transport
from terrafuse.exchange.links.zenoh import ZenohLink
from terrafuse.replica import Replica
from tests.exchange.fleet import LATTICE, MODEL
from tests.exchange.zenoh_nodes import SWIFT, TICK_S


class Listed:
    """A link that keeps a list of the topics on which something came."""

    def __init__(self, link: ZenohLink) -> None:
        self._link, self.topics = link, list[str]()
        self.node, self.max_frame_bytes = link.node, link.max_frame_bytes
        self.listen, self.send, self.close = link.listen, link.send, link.close

    def receive(self, now_ns: int) -> list[Frame]:
        frames = self._link.receive(now_ns)
        self.topics += [frame.topic for frame in frames]
        return frames


def main(name: str, transport: str) -> None:
    link = ZenohLink(name, Transport(**json.loads(transport)))
    listed, replica = Listed(link), Replica(LATTICE, MODEL)
    for kind in ("delta", "summary", "post", "pose", "mark"):
        link.listen(kind)
    courier = Courier(listed, [Channel("fine", replica.store, relay=True)], settings=SWIFT)
    asked: queue.SimpleQueue[str] = queue.SimpleQueue()
    threading.Thread(target=lambda: [asked.put(line) for line in sys.stdin], daemon=True).start()
    say("ready")
    while True:
        courier.tick(time.monotonic_ns())
        with suppress(queue.Empty):
            say(json.dumps(answer(asked.get(timeout=TICK_S), link, listed, replica, courier)))


def say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def answer(line: str, link: ZenohLink, listed: Listed, replica: Replica, courier: Courier) -> Any:
    match line.split():
        case ["nodes"]:
            return link.nodes()
        case ["topics"]:
            topics, listed.topics = listed.topics, []
            return topics
        case ["digest"]:
            return replica.digest()
        case ["level", robot]:
            return replica.store.level(robot)
        case ["refused"]:
            return {kind: count for kind, count in courier.counts.items() if kind.startswith("refused")}
    raise ValueError(line)


if __name__ == "__main__":
    main(*sys.argv[1:])
