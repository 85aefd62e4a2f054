"""python -m bench.exchange [--json FILE] [--seconds N] [--robots N]

How complete the station's map is, against time, where each robot may send 1, 2, 5, 20 or 100 kB/s: the simulator's
village, robots on patrol for so many seconds, which then stand still; in simulated time. A robot reports its coarse map
(cells of 5 m) and its fine one (0.5 m), as the lean profile has them, coarse before fine. Complete is the share of the
cells that robots know by then of which the station knows something. Frames are counted with 40 bytes of the carrier's.

Then, ten minutes without contact at 20 kB/s: how much had to be told afterwards, and how long it took.
"""

from __future__ import annotations

import tempfile
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.report import parser, tell
from terrafuse.exchange.coarse import CoarseContribution
from terrafuse.exchange.codec import encode
from terrafuse.exchange.courier import Channel, Courier, CourierSettings
from terrafuse.exchange.delta import Delta
from terrafuse.exchange.links import Cut, Faults, MemoryHub, MisbehavingLink
from terrafuse.exchange.profiles import report
from terrafuse.mapper import Mapper
from terrafuse.simulate.mission.engine import START_NS, Mission
from terrafuse.simulate.scenario import load_scenario, with_robots
from terrafuse.simulate.scenario.read import changed
from terrafuse.store.base import Store
from terrafuse.store.memory import MemoryStore
from terrafuse.types import Scan

BUDGETS = (1_000.0, 2_000.0, 5_000.0, 20_000.0, 100_000.0)
MARKS_S = (10, 30, 60, 120, 180, 300, 600)
TICK_NS, SECOND_NS = 100_000_000, 1_000_000_000
FRAME_BYTES, OVERHEAD_BYTES = 1400, 40
FACTOR = 10
CUT_S = 600.0


@dataclass
class Drive:
    """What the robots of a mission scanned."""

    mission: Mission
    scans: Mapping[str, Sequence[Scan]]


def drive(seconds: float, robots: int) -> Drive:
    loaded = changed(with_robots(load_scenario("village"), robots), duration_s=seconds)
    with tempfile.TemporaryDirectory() as folder:
        mission = Mission(loaded, folder=Path(folder))
        scans: dict[str, list[Scan]] = {vehicle.name: [] for vehicle in mission.vehicles}
        for vehicle in mission.vehicles:
            vehicle.on_scan.append(scans[vehicle.name].append)
        mission.run(threads=2)
    return Drive(mission, scans)


class Robot:
    """Maps its scans as their time comes, and reports."""

    def __init__(self, name: str, drive: Drive, hub: MemoryHub, bytes_per_s: float, faults: Faults) -> None:
        self.mapper = Mapper(name, drive.mission.lattice, drive.mission.model)
        self.coarse = CoarseContribution(self.mapper, FACTOR)
        self._scans, self._next = drive.scans[name], 0
        link = MisbehavingLink(hub.link(name), faults)
        channels = [
            Channel("coarse", own=self.coarse, project=self.lean),
            Channel("fine", own=self.mapper, project=self.lean),
        ]
        settings = CourierSettings(bytes_per_s=bytes_per_s, overhead_bytes=OVERHEAD_BYTES)
        self.courier = Courier(link, channels, peers=["station"], settings=settings)

    def tick(self, now_ns: int) -> None:
        while self._next < len(self._scans) and self._scans[self._next].stamp_ns <= START_NS + now_ns:
            self.mapper.integrate(self._scans[self._next])
            self._next += 1
        if now_ns % SECOND_NS == 0:
            self.coarse.update()
        self.courier.tick(now_ns)

    def lean(self, delta: Delta) -> Delta:
        return report(delta, "lean", self.mapper.model)


class Run:
    """Robots and a station, at a budget."""

    def __init__(self, drive: Drive, bytes_per_s: float, faults: Faults | None = None) -> None:
        lattice, model = drive.mission.lattice, drive.mission.model
        hub = MemoryHub(FRAME_BYTES)
        self.stores = {"coarse": MemoryStore(lattice.coarser(FACTOR), model), "fine": MemoryStore(lattice, model)}
        self.station = Courier(hub.link("station"), [Channel(name, store) for name, store in self.stores.items()])
        self.robots = [Robot(name, drive, hub, bytes_per_s, faults or Faults()) for name in drive.scans]
        self.now_ns = 0

    def to(self, seconds: float) -> None:
        while self.now_ns < seconds * SECOND_NS:
            for robot in self.robots:
                robot.tick(self.now_ns)
            self.station.tick(self.now_ns)
            self.now_ns += TICK_NS

    def complete(self) -> dict[str, float]:
        """By channel, the share of what robots know of which the station knows something."""
        own = {
            "coarse": sum(_cells(robot.coarse.delta()) for robot in self.robots),
            "fine": sum(_cells(robot.mapper.delta()) for robot in self.robots),
        }
        return {name: round(_held(store) / max(own[name], 1), 3) for name, store in self.stores.items()}

    def backlog(self) -> int:
        """Bytes of what the station lacks by now, each robot's of a channel in one delta, worked out from both maps."""
        return sum(
            len(encode(robot.lean(source.delta(self.stores[name].revision(robot.mapper.robot)))))
            for robot in self.robots
            for name, source in (("coarse", robot.coarse), ("fine", robot.mapper))
        )

    def sent(self) -> int:
        counts = sum((robot.courier.counts for robot in self.robots), start=Counter[str]())
        return sum(number for name, number in counts.items() if name.startswith("bytes_sent"))


def _cells(delta: Delta) -> int:
    return delta.cell_count


def _held(store: Store) -> int:
    tiles = (store.load(robot, key) for robot in store.robots() for key in store.revisions(robot))
    return sum(len(tile.at) for tile in tiles if tile is not None)


def against_time(drive: Drive, bytes_per_s: float) -> dict[str, Any]:
    run, marks = Run(drive, bytes_per_s), {}
    for mark_s in MARKS_S:
        run.to(mark_s)
        marks[f"{mark_s} s"] = run.complete()
    return marks | {"kB a robot sent": round(run.sent() / len(run.robots) / 1000, 1)}


def apart(drive: Drive, bytes_per_s: float) -> dict[str, Any]:
    """Ten minutes without contact, and how long until the station lacks nothing."""
    run = Run(drive, bytes_per_s, Faults(cuts=(Cut(1.0, 1.0 + CUT_S),)))
    run.to(1.0 + CUT_S)
    before, backlog = run.sent(), run.backlog() / len(run.robots)
    while any(robot.courier.behind("station") for robot in run.robots):
        run.to(run.now_ns / SECOND_NS + 0.5)
    sent = (run.sent() - before) / len(run.robots)
    cells = sum(_cells(robot.mapper.delta()) for robot in run.robots) / len(run.robots)
    return {
        "cells a robot mapped": round(cells),
        "kB a robot had to tell, encoded at once": round(backlog / 1000, 1),
        "kB it sent": round(sent / 1000, 1),
        "seconds until level": round(run.now_ns / SECOND_NS - 1.0 - CUT_S, 1),
        "backlog / budget, s": round(backlog / bytes_per_s, 1),
    }


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--seconds", type=float, default=120.0)
    options.add_argument("--robots", type=int, default=3)
    asked = options.parse_args()
    started = time.perf_counter()
    driven = drive(asked.seconds, asked.robots)
    way_m = float(np.mean([vehicle.way_m for vehicle in driven.mission.vehicles]))
    figures = {
        "metres a robot drove": round(way_m),
        "complete": {f"{rate / 1000:g} kB/s": against_time(driven, rate) for rate in BUDGETS},
        "ten minutes apart, 20 kB/s": apart(driven, 20_000.0),
        "seconds of work": round(time.perf_counter() - started),
    }
    tell(figures, asked.json)


if __name__ == "__main__":
    main()
