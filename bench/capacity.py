"""python -m bench.capacity [--robots N] [--seconds S] [--cells K] [--profile lean] [--speed M] [--json FILE]

How many robots one station takes: `terrafuse station --insecure` as a process of its own, and processes beside it that
speak for N robots. Each robot sends, once a second, a delta of about K cells, a summary and its services' states, as
`terrafuse robot --share none` does; the robots spread over the second, in steps of 10 ms. What they send is made
beforehand.

Nothing is measured inside the station: its store keeps when each delta came in, and the generators when they published
it, by the same clock. `fused` is from publishing until the station's store has it, where a query reads it; `said` until
a generator heard the station say so, which is after it is on disk. Waiting are deltas that are published and not fused,
wherever they are.
"""

from __future__ import annotations

import multiprocessing
import os
import platform
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from argparse import Namespace
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np

from bench.report import parser, tell
from terrafuse.exchange.codec import encode
from terrafuse.exchange.delta import Delta
from terrafuse.exchange.framing import HEADER_BYTES, frames_of
from terrafuse.exchange.links import Frame
from terrafuse.exchange.links.transport import Transport
from terrafuse.exchange.links.zenoh import ZenohLink
from terrafuse.exchange.piece import Piece, encode_piece
from terrafuse.exchange.posts import Post, encode_post
from terrafuse.exchange.profiles import report
from terrafuse.exchange.summary import VERSION, State, Summary, pack, unpack
from terrafuse.lattice import Lattice
from terrafuse.mapper import Mapper
from terrafuse.models import make_model
from terrafuse.models.base import Model
from terrafuse.services.directory import CONTRACT, DIRECTORY, Report
from terrafuse.services.directory import pack as packed_report
from terrafuse.services.service import RUNNING, Status
from terrafuse.store.memory import MemoryStore
from terrafuse.store.sqlite import SqliteStore
from terrafuse.types import Pose, Scan

LOOPBACK, STATION, CHANNEL = "127.0.0.1", "station", "fine"
RESOLUTION_M = 0.2
SPEED_MPS = 1.0
POINTS_A_CELL = 6
SECOND_NS = 1_000_000_000
NAME = "r{:05d}"
NOBODY, EARLY = NAME.format(99_999), 99_998
SETTLE_S = 5.0
"""After the last delta, for what still waits."""
QUIET_S, QUIET_SHARE = 4.0, 0.93
"""Nothing else runs where processors have nothing to do for so long, for such a share of it."""
SLOT_S = 0.01
"""Robots whose turn is within so long send at once: a generator that wakes up for each takes what the station needs."""
RETRY, MOST_AGAIN = 4, 3
"""What was sent so many seconds ago and is not said to be held is sent again, so many at a time, and as seldom."""
BESIDES = 2
"""Frames of a robot's second after those of its delta."""
CHECKED = 3
CLOCK_TICKS, PAGE_BYTES = os.sysconf("SC_CLK_TCK"), os.sysconf("SC_PAGE_SIZE")


# --- what robots say --------------------------------------------------------------------------------------------------


def height_m(east: Any, north: Any) -> Any:
    return 1.5 * np.sin(east / 9) * np.cos(north / 7) + 0.2 * np.sin(east * 1.3 + north)


def drive(area: int, seconds: int, cells: int, begin_ns: int, speed_mps: float = SPEED_MPS) -> Iterator[Delta]:
    """A robot that maps a square of so many cells around it each second and drives on, over hills."""
    rng = np.random.default_rng(area)
    mapper = Mapper(NOBODY, Lattice(RESOLUTION_M), make_model("elevation"))
    half_m, heading = np.sqrt(cells) * RESOLUTION_M / 2, rng.uniform(0, 2 * np.pi)
    start, count = rng.uniform(0, 40, 2) + 200.0 * np.array(divmod(area, 32)), POINTS_A_CELL * cells
    for second in range(seconds):
        place = start + speed_mps * second * np.array([np.cos(heading), np.sin(heading)])
        around = rng.uniform(-half_m, half_m, (count, 2))
        heights = height_m(*(place + around).T) + rng.normal(0, 0.01, count)
        points = np.column_stack([around, heights])
        mapper.integrate(Scan(begin_ns + second * SECOND_NS, points, Pose.identity().shifted(place[0], place[1])))
        yield mapper.delta(second)


def renamed(message: bytes, robot: str) -> bytes:
    """A delta's message as that of another robot with an equally long name."""
    body = message[:-4].replace(NOBODY.encode(), robot.encode(), 1)
    return body + crc32(body).to_bytes(4, "little")


def frame_of(robot: str, delta: Delta, message: bytes, most_bytes: int) -> list[Frame]:
    """As a robot's courier brings it to a station that holds all before: the revisions after the last report."""
    since, until = delta.revision - 1, delta.revision
    piece = Piece(until, [since], (since, until, []), False, renamed(message, robot))
    return frames_of(f"delta/{CHANNEL}/{robot}/{robot}", encode_piece(piece), most_bytes)


def first_frames(model: Model, profile: str) -> list[Frame]:
    """Of a robot that was there before the others: the station has then loaded what it takes deltas in with."""
    (delta,) = (report(delta, profile, model) for delta in drive(0, 1, 100, time.time_ns()))
    return frame_of(NAME.format(EARLY), delta, encode(delta), 60_000)


def states() -> bytes:
    """What a robot's directory reports, about."""
    names = ("source", "mapping", "exchange", "directory", "orchestration")
    counts = {
        f"{kind}.{of}": 1000 for kind in ("messages_sent", "frames_sent", "bytes_sent") for of in ("delta", "post")
    }
    status = [Status(name, f"terrafuse/{name}/1", RUNNING, 0, names, counts=counts) for name in names]
    return packed_report(Report(1.0, status))


@dataclass(frozen=True)
class Load:
    """What a generator is to do."""

    address: str
    robots: Sequence[int]
    areas: int
    seconds: int
    cells: int
    profile: str
    sessions: int
    of: int
    """Robots in all, over which the second is spread."""
    speed_mps: float
    made_ns: int
    """When the first scan is said to have been."""

    def deltas(self, area: int) -> list[Delta]:
        """As robots report them that drive here."""
        model = make_model("elevation")
        whole = drive(area, self.seconds, self.cells, self.made_ns, self.speed_mps)
        return [report(delta, self.profile, model) for delta in whole]


def generate(load: Load, pipe: Any) -> None:
    """Make what robots say, tell `pipe`, wait for when to begin, say it, tell what was said and heard when."""
    links = [
        ZenohLink(f"load{load.robots[0]}-{k}", Transport(connect=load.address, insecure=True, queue_bytes=64 << 20))
        for k in range(load.sessions)
    ]
    while not all(link.connected for link in links):
        time.sleep(0.1)
    model = make_model("elevation")
    places = {robot: robot % load.areas for robot in load.robots}
    deltas = {area: load.deltas(area) for area in sorted(set(places.values()))}
    messages = {area: [encode(delta) for delta in some] for area, some in deltas.items()}
    room, states_bytes = links[0].max_frame_bytes, states()
    first = {
        (robot, second): frame_of(NAME.format(robot), deltas[area][second], messages[area][second], room)
        for robot, area in places.items()
        for second in range(load.seconds)
    }
    frames = {
        at: [*own, *_besides(NAME.format(at[0]), load.made_ns, at[1], states_bytes, room)] for at, own in first.items()
    }
    sizes = [len(frame.payload) for some in first.values() for frame in some]
    counts = [delta.cell_count for some in deltas.values() for delta in some]
    links[0].listen(f"summary/{STATION}")
    for frame in first_frames(model, load.profile):
        links[0].send(*frame, 0)
    pipe.send({"bytes": sum(sizes) / len(frames), "cells": sum(counts) / len(counts)})
    begin_ns = pipe.recv()
    pipe.send(_say(load, links, frames, begin_ns))
    for link in links:
        link.close()


def _say(
    load: Load, links: list[ZenohLink], frames: dict[tuple[int, int], list[Frame]], begin_ns: int
) -> dict[str, Any]:
    published: dict[tuple[int, int], int] = {}
    said: dict[tuple[int, int], int] = {}
    levels, again = dict.fromkeys(load.robots, 0), 0
    slots: dict[int, list[tuple[int, int]]] = {}
    for robot, second in frames:
        slots.setdefault(int((second + robot / load.of) / SLOT_S), []).append((robot, second))
    for slot in range(round(load.seconds / SLOT_S)):
        time.sleep(max(begin_ns / SECOND_NS + slot * SLOT_S - time.time(), 0))
        for robot, second in slots.get(slot, ()):
            link, now_ns = links[robot % len(links)], time.time_ns()
            due = second % RETRY == 0
            for lacking in range(levels[robot], min(second - RETRY, levels[robot] + MOST_AGAIN) if due else 0):
                again += 1
                for frame in frames[robot, lacking][:-BESIDES]:
                    link.send(*frame, now_ns)
            published[robot, second + 1] = now_ns
            for frame in frames[robot, second]:
                link.send(*frame, now_ns)
        _hear(links[0], levels, said)
    end_ns = time.time_ns() + round(SETTLE_S * SECOND_NS)
    while time.time_ns() < end_ns and len(said) < len(published):
        _hear(links[0], levels, said)
        time.sleep(SLOT_S)
    dropped = sum(count for link in links for name, count in link.counts.items() if name.startswith("dropped"))
    return {"published": published, "said": said, "dropped": dropped, "again": again}


def _besides(robot: str, born_ns: int, second: int, report_bytes: bytes, room: int) -> list[Frame]:
    """A robot's summary, and its report of states."""
    (summary,) = pack(Summary(VERSION, born_ns, born_ns + second * SECOND_NS, {}), State(), 1000 - HEADER_BYTES)
    kind = f"{DIRECTORY} {CONTRACT.id} states "
    post = encode_post(Post(born_ns, second + 1, kind, report_bytes))
    return [
        *frames_of(f"summary/{robot}", summary, room),
        *frames_of(f"post/{STATION}/{robot}", post, room),
    ]


def _hear(link: ZenohLink, levels: dict[int, int], said: dict[tuple[int, int], int]) -> None:
    """What the station says that it holds without a gap."""
    for frame in link.receive(0):
        now_ns, summary = time.time_ns(), unpack(frame.payload[HEADER_BYTES:])
        for name, revision in summary.held.get(CHANNEL, {}).items():
            robot = int(name[1:])
            for between in range(levels.get(robot, revision) + 1, revision + 1):
                said[robot, between] = now_ns
            if robot in levels:
                levels[robot] = max(levels[robot], revision)


# --- the station ------------------------------------------------------------------------------------------------------


class Second(NamedTuple):
    """Processor seconds are counted from when each began."""

    at_ns: int
    station_s: float
    generators_s: float
    idle_s: float
    stolen_s: float
    resident_bytes: int


def cpu_s(process: int) -> float:
    times = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(times[11]) + int(times[12])) / CLOCK_TICKS


def machine_s() -> tuple[float, float]:
    """In which processors had nothing to do, and were taken away by the host of a virtual machine."""
    times = [int(word) / CLOCK_TICKS for word in Path("/proc/stat").read_text().splitlines()[0].split()[1:]]
    return times[3] + times[4], times[7]


def wait_for_quiet(patience_s: float) -> None:
    """Until nothing else runs."""
    deadline = time.monotonic() + patience_s
    while time.monotonic() < deadline:
        before, _ = machine_s()
        time.sleep(QUIET_S)
        if machine_s()[0] - before > (os.cpu_count() or 1) * QUIET_S * QUIET_SHARE:
            return
    print(f"something else still runs after {patience_s:g} s", file=sys.stderr)


class Station:
    """The process, and what it costs from second to second."""

    def __init__(self, store: Path, port: int, sample: Path | None) -> None:
        program = ["-m", "terrafuse"] if sample is None else ["-m", "bench.sampled", str(sample)]
        command = [sys.executable, *program, "station", "--insecure", "--resolution", str(RESOLUTION_M)]
        command += ["--store", str(store), "--listen", f"tcp/{LOOPBACK}:{port}", "--name", STATION]
        self.process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        self.seconds: list[Second] = []

    def look(self, generators: Sequence[int]) -> None:
        pages = int(Path(f"/proc/{self.process.pid}/statm").read_text().split()[1])
        beside_s = sum(map(cpu_s, generators))
        station_s = cpu_s(self.process.pid)
        self.seconds.append(Second(time.time_ns(), station_s, beside_s, *machine_s(), pages * PAGE_BYTES))

    def leave(self) -> None:
        self.process.terminate()
        try:
            self.process.wait(30)
        except subprocess.TimeoutExpired:
            self.process.kill()


def free_port() -> int:
    with socket.socket() as free:
        free.bind((LOOPBACK, 0))
        return int(free.getsockname()[1])


def run(asked: Namespace, folder: Path) -> dict[str, Any]:
    port, store = free_port(), folder / "station.db"
    station = Station(store, port, asked.sample)
    context = multiprocessing.get_context("spawn")
    generators, made_ns = [], time.time_ns()
    try:
        for first in range(asked.generators):
            here, there = context.Pipe()
            robots = range(first, asked.robots, asked.generators)
            load = Load(
                f"{LOOPBACK}:{port}", robots, asked.areas, asked.seconds, asked.cells, asked.profile, asked.sessions,
                asked.robots, asked.speed, made_ns,
            )  # fmt: skip
            process = context.Process(target=generate, args=(load, there), daemon=True)
            process.start()
            generators.append((process, here))
        made = [pipe.recv() for _, pipe in generators]
        wait_for_quiet(asked.patience)
        begin_ns = time.time_ns() + SECOND_NS
        for _, pipe in generators:
            pipe.send(begin_ns)
        while not all(pipe.poll() for _, pipe in generators):
            station.look([process.pid or 0 for process, _ in generators])
            time.sleep(1 - time.time() % 1)
        heard = [pipe.recv() for _, pipe in generators]
        station.look([])
    finally:
        station.leave()
        for process, _ in generators:
            process.join(10)
            process.kill()
    with SqliteStore.open(store) as held:
        fused = {(int(e.robot[1:]), e.revision): e.arrival_ns for e in reversed(held.history()) if e.since < e.revision}
        right = [holds(held, load, robot) for robot in list(load.robots)[:CHECKED]]
    figures = {"bytes a delta": round(made[0]["bytes"]), "cells a delta": round(made[0]["cells"])}
    figures |= {"robots checked": len(right), "of which every cell is right": sum(right)}
    return figures | evaluate(heard, fused, station.seconds, begin_ns, asked.seconds) | {"store MB": size_mb(folder)}


def holds(store: SqliteStore, load: Load, robot: int) -> bool:
    """Whether the store has of a robot what it reported, byte for byte."""
    reported = MemoryStore(store.map.lattice, store.model)
    for delta in load.deltas(robot % load.areas):
        reported.accept(delta)
    name = NAME.format(robot)
    pairs = [(reported.load(NOBODY, key), store.load(name, key)) for key in reported.keys()]
    return store.revisions(name).keys() == reported.revisions(NOBODY).keys() and all(
        one is not None and two is not None and np.array_equal(one.at, two.at) and (one.cells == two.cells).all()
        for one, two in pairs
    )


def size_mb(folder: Path) -> float:
    return round(sum(file.stat().st_size for file in folder.iterdir()) / 1e6, 1)


# --- what came of it --------------------------------------------------------------------------------------------------


def evaluate(
    heard: list[dict[str, Any]], fused: dict[tuple[int, int], int], seconds: list[Second], begin_ns: int, count: int,
) -> dict[str, Any]:  # fmt: skip
    published = {at: ns for each in heard for at, ns in each["published"].items()}
    said = {at: ns for each in heard for at, ns in each["said"].items()}
    keys = sorted(published)
    left, came = (np.array([times.get(key, 0) for key in keys], np.int64) for times in (published, fused))
    there = came > 0
    took_ms, said_ms = (came - left)[there] / 1e6, np.array([said[k] - published[k] for k in keys if k in said]) / 1e6
    edges = begin_ns + SECOND_NS * np.arange(1, count + 1)
    table = []
    for edge in edges.tolist():
        within = there & (left >= edge - SECOND_NS) & (left < edge)
        waiting = int(((left < edge) & (~there | (came > edge))).sum())
        row = {"second": (edge - begin_ns) // SECOND_NS, "fused p99 ms": _percentile((came - left)[within] / 1e6, 99)}
        table.append(row | {"longest ms": _percentile((came - left)[within] / 1e6, 100), "waiting": waiting})
    begun = [each for each in seconds if begin_ns <= each.at_ns <= edges[-1]]
    for row, after, before in zip(table[1:], begun[1:], begun, strict=False):
        row |= cores(before, after) | {"RSS MB": round(after.resident_bytes / 1e6)}
    resident = [round(each.resident_bytes / 1e6) for each in begun]
    return {
        "deltas published": len(keys), "fused": int(there.sum()), "said to be held": len(said),
        "frames dropped by generators": sum(each["dropped"] for each in heard),
        "sent again": sum(each["again"] for each in heard),
        "fused ms": _distribution(took_ms), "said ms": _distribution(said_ms),
        "waiting at most": max(row["waiting"] for row in table),
        "waiting in the last second": table[-1]["waiting"],
        "cores": cores(begun[0], begun[-1]),
        "station's ms a delta": round(1e3 * (seconds[-1].station_s - begun[0].station_s) / max(int(there.sum()), 1), 3),
        "RSS MB": {"first": resident[0], "middle": resident[len(resident) // 2], "last": resident[-1]},
        "worst second": max(table, key=lambda row: row["fused p99 ms"]), "seconds": table,
    }  # fmt: skip


def cores(before: Second, after: Second) -> dict[str, float]:
    """On average, where they were."""
    took_s, names = (after.at_ns - before.at_ns) / SECOND_NS, ("station", "generators", "idle", "stolen")
    return {name: round((after[k] - before[k]) / took_s, 2) for k, name in enumerate(names, start=1)}


def _percentile(values: Any, share: float) -> float:
    return round(float(np.percentile(values, share)), 1) if len(values) else float("inf")


def _distribution(values: Any) -> dict[str, float]:
    return {name: _percentile(values, share) for name, share in (("median", 50), ("p99", 99), ("longest", 100))}


def table_of(rows: list[dict[str, Any]]) -> str:
    names = list(rows[-1])
    lines = ["  ".join(f"{row.get(name, ''):>{len(name)}}" for name in names) for row in rows]
    return "\n".join(["  ".join(names), *lines])


def main() -> None:
    arguments = parser(__doc__)
    arguments.add_argument("--robots", type=int, default=1000)
    arguments.add_argument("--seconds", type=int, default=60)
    arguments.add_argument("--cells", type=int, default=2000)
    arguments.add_argument("--speed", type=float, default=SPEED_MPS, help="of robots, m/s")
    arguments.add_argument("--profile", default="lean", help="how robots round their cells: lean, full or exact")
    arguments.add_argument("--generators", type=int, default=2, help="processes that speak for robots")
    arguments.add_argument("--sessions", type=int, default=4, help="connections of each of them")
    arguments.add_argument("--areas", type=int, default=100, help="different drives; several robots see the same")
    arguments.add_argument("--patience", type=float, default=60.0, help="seconds to wait until nothing else runs")
    arguments.add_argument("--folder", type=Path, help="where the station's store is to lie")
    arguments.add_argument("--sample", type=Path, help="write where the station's threads spend their time here")
    asked = arguments.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="capacity-", dir=asked.folder))
    try:
        figures = {
            "machine": f"{platform.machine()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f} before, "
            f"Python {platform.python_version()}",
            "robots": asked.robots, "profile": asked.profile,
        } | run(asked, folder)  # fmt: skip
    finally:
        shutil.rmtree(folder)
    print(table_of(figures.pop("seconds") if asked.json is None else figures["seconds"]))
    tell(figures, asked.json)


if __name__ == "__main__":
    main()
