"""python -m bench.transport [--json FILE] [--seconds S]: what the link over Zenoh costs, two processes on loopback."""

from __future__ import annotations

import multiprocessing
import os
import platform
import socket
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median, quantiles
from typing import Any

from bench.report import parser, tell
from terrafuse.exchange.links.transport import Transport
from terrafuse.exchange.links.zenoh import ZenohLink
from terrafuse.keys.fleet import Fleet
from terrafuse.testing.relay import Mishaps, Relay

LOOPBACK = "127.0.0.1"
ROUND_TRIPS = 2000
SIZES = {"1 kB": 1000, "60 kB": 60_000}
IDLE_S = 0.00005


def echo(settings: dict[str, Any], ready: Any) -> None:
    """A station that sends back what comes on `post/station/…`, and counts what comes on `pose/…`; says how much."""
    link = ZenohLink("station", Transport(**settings))
    link.listen("post/station")
    link.listen("pose")
    ready.send(None)
    counted = 0
    while True:
        frames = link.receive(0)
        for frame in frames:
            if frame.topic.startswith("post/"):
                sender = frame.topic.rsplit("/", 1)[1]
                payload = counted.to_bytes(8, "little") if frame.payload == b"count" else frame.payload
                link.send(f"post/{sender}/station", payload, 0)
            else:
                counted += 1
        if not frames:
            time.sleep(IDLE_S)


@contextmanager
def station(**settings: Any) -> Iterator[None]:
    here, there = multiprocessing.Pipe()
    process = multiprocessing.get_context("spawn").Process(target=echo, args=(settings, there), daemon=True)
    process.start()
    here.recv()
    try:
        yield
    finally:
        process.kill()
        process.join()


def joined(name: str, transport: Transport) -> ZenohLink:
    link = ZenohLink(name, transport)
    link.listen(f"post/{name}")
    while not link.nodes():
        time.sleep(0.01)
    return link


def asked(link: ZenohLink, payload: bytes) -> tuple[float, bytes]:
    """Seconds until the echo came, and what it was."""
    started = time.perf_counter()
    link.send(f"post/station/{link.node}", payload, 0)
    while not (frames := link.receive(0)):
        time.sleep(IDLE_S)
    return time.perf_counter() - started, frames[0].payload


def round_trips(link: ZenohLink, size: int) -> dict[str, float]:
    """Milliseconds."""
    payload = os.urandom(size)
    times = [1e3 * asked(link, payload)[0] for _ in range(ROUND_TRIPS)]
    return {"median": median(times), "p99": quantiles(times, n=100)[98]}


def throughput(link: ZenohLink, size: int, seconds: float) -> dict[str, float]:
    """As fast as the queue takes frames: those that arrive."""
    payload, before = os.urandom(size), int.from_bytes(asked(link, b"count")[1], "little")
    room, started = link.transport.queue_bytes // (2 * size), time.perf_counter()
    first = link.counts["frames_sent"]
    sent = 0
    while time.perf_counter() - started < seconds:
        if first + sent - link.counts["frames_sent"] < room:
            link.send(f"pose/{link.node}", payload, 0)
            sent += 1
        else:
            time.sleep(IDLE_S)
    while link.counts["frames_sent"] < first + sent:
        time.sleep(IDLE_S)
    arrived = int.from_bytes(asked(link, b"count")[1], "little") - before
    took = time.perf_counter() - started
    return {"frames_per_s": arrived / took, "MB_per_s": arrived * size / took / 1e6, "lost": 1 - arrived / sent}


def beside_a_stalled_robot(seconds: float) -> dict[str, float]:
    """A station sends 60 kB a hundred times a second to all; one robot's connection takes nothing any more."""
    port = free_port()
    hub = ZenohLink("station", Transport(listen=f"{LOOPBACK}:{port}", insecure=True))
    with Relay(f"{LOOPBACK}:{port}", Mishaps(stall=1.0, within_s=0.0)) as relay:
        good = joined("r1", Transport(connect=f"{LOOPBACK}:{port}", insecure=True))
        relay.mishaps = Mishaps(stall=1.0, within_s=1.0)
        bad = ZenohLink("r2", Transport(connect=relay.address, insecure=True))
        for link in (good, bad):
            link.listen("pose")
        calls, late = [], []
        reading = threading.Event()

        def read() -> None:
            while not reading.is_set():
                late.extend(time.perf_counter() - float(frame.payload[:24]) for frame in good.receive(0))
                time.sleep(IDLE_S)

        reader = threading.Thread(target=read)
        reader.start()
        end = time.perf_counter() + seconds
        while time.perf_counter() < end:
            started = time.perf_counter()
            hub.send("pose/station", f"{started:<24}".encode() + bytes(60_000 - 24), 0)
            calls.append(time.perf_counter() - started)
            time.sleep(0.01)
        time.sleep(0.5)
        reading.set()
        reader.join()
        for link in (good, bad, hub):
            link.close()
    return {
        "send_longest_ms": 1e3 * max(calls),
        "good_robot_median_ms": 1e3 * median(late),
        "good_robot_longest_ms": 1e3 * max(late),
        "good_robot_got": len(late) / len(calls),
    }


def free_port() -> int:
    with socket.socket() as free:
        free.bind((LOOPBACK, 0))
        return int(free.getsockname()[1])


def measure(seconds: float) -> dict[str, Any]:
    out: dict[str, Any] = {
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    }
    with tempfile.TemporaryDirectory() as folder:
        fleet = Fleet.new(Path(folder) / "fleet")
        keys: dict[str, Callable[[str], dict[str, Any]]] = {
            "tcp": lambda node: {"insecure": True},
            "tls": lambda node: {"keys": str(fleet.node_folder(node))},
        }
        fleet.add("station", station=True)
        fleet.add("r1")
        for name, settings in keys.items():
            address = f"{LOOPBACK}:{free_port()}"
            with station(listen=address, **settings("station")):
                link = joined("r1", Transport(connect=address, **settings("r1")))
                asked(link, b"warm")
                out[name] = {
                    size: {"round_trip_ms": round_trips(link, count), "one_way": throughput(link, count, seconds)}
                    for size, count in SIZES.items()
                }
                link.close()
    return out | {"beside a stalled robot": beside_a_stalled_robot(seconds)}


def main() -> None:
    arguments_of = parser(__doc__)
    arguments_of.add_argument("--seconds", type=float, default=5.0, help="of each throughput")
    arguments = arguments_of.parse_args()
    figures = measure(arguments.seconds)
    tell(figures, arguments.json)


if __name__ == "__main__":
    main()
