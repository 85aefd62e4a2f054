"""Nodes on Zenoh for tests: in this process, and in processes of their own."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import Any

from terrafuse.exchange.courier import CourierSettings
from terrafuse.exchange.links import Frame
from terrafuse.exchange.links.transport import Transport
from terrafuse.exchange.links.zenoh import ZenohLink

LOOPBACK = "127.0.0.1"
PATIENCE_S = 30.0
"""Bounds what fails. In a fresh clone kernels are compiled within it."""
TICK_S = 0.02
SWIFT = CourierSettings(period_s=0.2, answer_s=0.05, retry_s=0.4, longest_retry_s=1.0, message_cells=200)


def free_port() -> int:
    with socket.socket() as listening:
        listening.bind((LOOPBACK, 0))
        return int(listening.getsockname()[1])


def until(done: Callable[[], bool], what: str, patience_s: float = PATIENCE_S) -> None:
    """Wait for something; fails when it does not come."""
    end_s = time.monotonic() + patience_s
    while not done():
        assert time.monotonic() < end_s, f"{what}: not within {patience_s} s"
        time.sleep(0.01)


def collected(link: ZenohLink, enough: Callable[[list[Frame]], bool], patience_s: float = PATIENCE_S) -> list[Frame]:
    """Frames as they come, until there are enough."""
    frames: list[Frame] = []

    def looked() -> bool:
        frames.extend(link.receive(0))
        return enough(frames)

    until(looked, f"frames at {link.node}", patience_s)
    return frames


class Settled:
    """A link whose `listen` takes effect, and all that was sent arrives, before it is used again.

    Marks follow the frames: what a node sends keeps its order on its way through the hub.
    """

    def __init__(self, link: ZenohLink, hub: ZenohLink, others: list[Settled]) -> None:
        self._link, self._hub, self._others, self._marks = link, hub, others, count()
        self._open = True
        self._early: list[Frame] = []
        link.listen(f"mark/{link.node}")

    @property
    def node(self) -> str:
        return self._link.node

    @property
    def max_frame_bytes(self) -> int:
        return self._link.max_frame_bytes

    def listen(self, topic: str) -> None:
        self._link.listen(topic)
        self._pass(self._hub)

    def send(self, topic: str, payload: bytes, now_ns: int) -> None:
        self._link.send(topic, payload, now_ns)

    def receive(self, now_ns: int) -> list[Frame]:
        if self._open:
            for other in self._others:
                if other is not self and other._open:
                    self._pass(other._link)
        frames, self._early = self._early + self._link.receive(now_ns), []
        return [frame for frame in frames if not frame.topic.startswith("mark/")]

    def close(self) -> None:
        self._open, self._early = False, []
        self._link.close()

    def _pass(self, other: ZenohLink) -> None:
        """Wait for a mark that the other sends from now on."""
        topic, mark = f"mark/{self.node}", f"{other.node} {next(self._marks)}".encode()

        def arrived() -> bool:
            other.send(topic, mark, 0)
            self._early += self._link.receive(0)
            return Frame(topic, mark) in self._early

        until(arrived, f"a mark from {other.node} to {self.node}")


@contextmanager
def joining(listen: Transport, connect: Transport) -> Iterator[Callable[[str], Settled]]:
    """What makes nodes that meet at a hub."""
    nodes: list[Settled] = []
    hub = ZenohLink("hub", listen)

    def join(name: str) -> Settled:
        link = ZenohLink(name, connect)
        nodes.append(Settled(link, hub, nodes))
        return nodes[-1]

    try:
        yield join
    finally:
        for node in nodes:
            node.close()
        hub.close()


class Process:
    """A node in a process of its own, which says on a line of its own when it is ready."""

    def __init__(self, module: str, *arguments: str | Path) -> None:
        command = [sys.executable, "-m", module, *map(str, arguments)]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self.line() == "ready"

    def line(self) -> str:
        """Its next one."""
        assert self._process.stdout is not None
        return self._process.stdout.readline().rstrip("\n")

    def ask(self, text: str) -> Any:
        """Tell it a line; its answer, of JSON."""
        assert self._process.stdin is not None
        self._process.stdin.write(text + "\n")
        self._process.stdin.flush()
        return json.loads(self.line())

    def kill(self) -> None:
        """As the kernel does: without a word."""
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()


def heard(process: Process, topic: str) -> list[str]:
    """Topics that came to a station, up to and with this one."""
    topics: list[str] = []

    def came() -> bool:
        topics.extend(process.ask("topics"))
        return topic in topics

    until(came, topic)
    return topics


@contextmanager
def station(name: str = "station", **settings: Any) -> Iterator[Process]:
    """`zenoh_station` of this name and Transport, until the end."""
    process = Process("tests.exchange.zenoh_station", name, json.dumps(settings, default=str))
    try:
        yield process
    finally:
        process.kill()
