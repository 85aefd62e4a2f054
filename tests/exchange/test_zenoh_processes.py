"""Stations in processes of their own: killed, behind bad connections, and joined by a hundred."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from itertools import islice

import numpy as np
import pytest

pytest.importorskip("zenoh")

from terrafuse.exchange.courier import Channel, Courier
from terrafuse.exchange.links import Frame
from terrafuse.exchange.links.transport import Transport
from terrafuse.exchange.links.zenoh import ZenohLink
from terrafuse.mapper import Mapper
from terrafuse.replica import Replica
from terrafuse.testing.deltas import random_scans
from terrafuse.testing.relay import Mishaps, Relay
from tests.exchange.fleet import LATTICE, MODEL
from tests.exchange.zenoh_nodes import LOOPBACK, PATIENCE_S, SWIFT, TICK_S, Process, free_port, station, until


def plain(**settings: object) -> Transport:
    return Transport(insecure=True, **settings)  # type: ignore[arg-type]


@pytest.fixture
def here() -> str:
    return f"{LOOPBACK}:{free_port()}"


class Robot:
    """One that maps as it is told, and reports to the station."""

    def __init__(self, name: str, connect: str, **settings: object) -> None:
        self.link = ZenohLink(name, plain(connect=connect, **settings))
        self.mapper = Mapper(name, LATTICE, MODEL)
        self.courier = Courier(self.link, [Channel("fine", own=self.mapper)], peers=["station"], settings=SWIFT)

    def digest(self) -> str:
        replica = Replica(LATTICE, MODEL)
        replica.apply(self.mapper.delta())
        return replica.digest()

    def is_level(self, process: Process) -> bool:
        return process.ask(f"level {self.link.node}") == self.mapper.revision

    def ticking(self, done: Callable[[], bool]) -> Callable[[], bool]:
        """The same question, after a tick and a while."""

        def ticked() -> bool:
            time.sleep(TICK_S)
            self.courier.tick(time.monotonic_ns())
            return done()

        return ticked


def test_a_robot_comes_back_to_a_station_that_was_killed(here: str) -> None:
    """Twice, and each time it has forgotten all. It gets what was mapped before and meanwhile."""
    scans = iter(random_scans(1, 30))
    robot = Robot("r1", here)

    def map_some() -> None:
        for _ in range(10):
            robot.mapper.integrate(next(scans))

    for _ in range(3):
        map_some()
        with station(listen=here, insecure=True) as process:
            until(robot.ticking(partial(robot.is_level, process)), "r1's map")
            assert process.ask("digest") == robot.digest()
    robot.link.close()


@pytest.mark.parametrize("kind", ["stall", "cut"])
def test_connections_that_fail_lose_nothing(here: str, kind: str) -> None:
    """Each of the first ones is stalled or cut within a second; a stall is noticed after two more."""
    mishaps = Mishaps(**{kind: 1.0}, within_s=1.0, delay_s=0.005, jitter_s=0.005)  # type: ignore[arg-type]
    counted = {"stall": "stalled", "cut": "cut"}[kind]
    with station(listen=here, insecure=True, hung_s=2.0) as process, Relay(here, mishaps, seed=4) as relay:
        robot, scans = Robot("r1", relay.address, hung_s=2.0), iter(random_scans(1, 1000))

        def failed() -> bool:
            robot.mapper.integrate(next(scans))
            return relay.counts[counted] >= 3

        until(robot.ticking(failed), "three failures")
        relay.mishaps = Mishaps()
        until(robot.ticking(partial(robot.is_level, process)), "r1's map")
        assert process.ask("digest") == robot.digest()
        robot.link.close()


def test_damaged_connections_lose_nothing(here: str) -> None:
    """One chunk of 20 has a flipped bit: Zenoh drops such connections, or takes what is no frame any more."""
    with station(listen=here, insecure=True) as process, Relay(here, Mishaps(corruption=0.05), seed=1) as relay:
        robot = Robot("r1", relay.address)
        for scan in random_scans(1, 100):
            robot.mapper.integrate(scan)
            robot.courier.tick(time.monotonic_ns())
            time.sleep(TICK_S)
        relay.mishaps = Mishaps()
        until(
            robot.ticking(partial(robot.is_level, process)), "r1's map", 3 * PATIENCE_S
        )  # broken ones are let go late
        assert process.ask("digest") == robot.digest()
        assert relay.counts["corrupted"] > 0
        robot.link.close()


JOINS, AT_ONCE = 100, 5
LOAD_PER_S, SCANS_PER_S = 500, 20


class Joiner:
    """Starts with nothing, and listens until it holds what the feeder had reported when it joined."""

    def __init__(self, number: int, connect: str, target: int) -> None:
        self.link = ZenohLink(f"j{number}", plain(connect=connect))
        self.replica = Replica(LATTICE, MODEL)
        self.courier = Courier(
            self.link, [Channel("fine", self.replica.store)], peers=["station"], settings=SWIFT
        )  # fmt: skip
        self.target = target

    @property
    def level(self) -> int:
        return self.replica.store.level("r0")

    def lacks(self, mapper: Mapper) -> int:
        """How many of the cells that it should hold are not there, or others."""
        lacking = 0
        for tile in mapper.delta().tiles:
            due = tile.cells["revision"] <= self.level
            held = self.replica.store.load("r0", tile.key)
            if held is None:
                lacking += int(due.sum())
                continue
            at, cells = tile.at[due], tile.cells[due]
            place = np.minimum(np.searchsorted(held.at, at), len(held.at) - 1)
            lacking += int(np.sum((held.at[place] != at) | (held.cells[place] != cells)))
        return lacking


class Repeating:
    """A link that remembers the last frame of cells that was sent."""

    def __init__(self, link: ZenohLink) -> None:
        self._link, self.newest = link, Frame("delta", b"")
        self.node, self.max_frame_bytes = link.node, link.max_frame_bytes
        self.listen, self.receive, self.close = link.listen, link.receive, link.close

    def send(self, topic: str, payload: bytes, now_ns: int) -> None:
        if topic.startswith("delta/"):
            self.newest = Frame(topic, payload)
        self._link.send(topic, payload, now_ns)


class Feeder:
    """Maps on and on, and repeats its newest report so often that every node hears 500 messages a second."""

    def __init__(self, connect: str) -> None:
        self.link = ZenohLink("r0", plain(connect=connect, max_frame_bytes=2000, queue_bytes=64 << 20))
        self.mapper, self._scans = Mapper("r0", LATTICE, MODEL), iter(random_scans(1, 60 * SCANS_PER_S))
        self._repeating = Repeating(self.link)
        self._courier = Courier(
            self._repeating, [Channel("fine", own=self.mapper)], peers=["station"], settings=SWIFT
        )  # fmt: skip
        self._started_s, self.loaded = time.monotonic(), 0

    def step(self) -> None:
        running_s = time.monotonic() - self._started_s
        while self.mapper.revision < SCANS_PER_S * running_s:
            self.mapper.integrate(next(self._scans))
        self._courier.tick(time.monotonic_ns())
        while self.loaded < LOAD_PER_S * running_s:
            self.link.send(*self._repeating.newest, 0)
            self.loaded += 1


@pytest.mark.long
def test_of_a_hundred_joins_under_load_each_gets_everything(here: str) -> None:
    """Who has come to a revision holds every cell of the feeder's that has not changed since, in every byte."""
    with station(listen=here, insecure=True) as process:
        feeder = Feeder(here)
        until(lambda: feeder.step() or process.ask("level r0") > 0, "a start")
        waiting, joined, done = iter(range(JOINS)), list[Joiner](), 0
        end_s = time.monotonic() + 60
        while done < JOINS:
            assert time.monotonic() < end_s, f"{done} joiners are level"
            for number in islice(waiting, AT_ONCE - len(joined)):
                joined.append(Joiner(number, here, feeder.mapper.revision))
            feeder.step()
            time.sleep(0.005)
            for joiner in joined.copy():
                joiner.courier.tick(time.monotonic_ns())
                if joiner.level >= joiner.target:
                    assert joiner.lacks(feeder.mapper) == 0
                    joiner.link.close()
                    joined.remove(joiner)
                    done += 1
        assert feeder.link.counts["dropped.queue"] == feeder.link.counts["dropped.unconnected"] == 0
        feeder.link.close()
