"""python -m bench [--json FILE] [--scans N] [--order ring|firing]"""

from __future__ import annotations

import platform
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from bench.bound import Bound
from bench.report import parser, tell
from bench.rivals import RIVALS
from bench.stream import stream
from terrafuse.lattice import Lattice
from terrafuse.mapper import Mapper
from terrafuse.types import Scan

ROUNDS = 5
LATTICE = Lattice(0.1)


def best(work: Callable[[], object], rounds: int = ROUNDS) -> float:
    """The least of several times, in seconds: noise only ever adds."""
    times = []
    for _ in range(rounds):
        started = time.perf_counter()
        work()
        times.append(time.perf_counter() - started)
    return min(times)


def map_all(scans: list[Scan], robot: str = "r1") -> Mapper:
    """The real thing: patch, states, ground, list of changed cells. Asking for a delta is timed apart, in `stages`."""
    mapper = Mapper(robot, LATTICE)
    warm_map(mapper, scans)
    return mapper


def warm_map(mapper: Mapper, scans: list[Scan]) -> None:
    for scan in scans:
        mapper.integrate(scan)


Work = Callable[[int, Scan], object]


def seconds_of_all(works: dict[str, Work], scans: list[Scan]) -> dict[str, float]:
    """The least time of each scan over the rounds, added up: a burst of noise is shorter than a round of all scans.

    Everybody goes through all scans before the next round, so that a slow spell of the machine hits all alike.
    """
    least = {name: np.full(len(scans), np.inf) for name in works}
    for _ in range(ROUNDS):
        for name, work in works.items():
            for k, scan in enumerate(scans):
                started = time.perf_counter()
                work(k, scan)
                least[name][k] = min(least[name][k], time.perf_counter() - started)
    return {name: float(times.sum()) for name, times in least.items()}


def kernels(scans: list[Scan]) -> dict[str, float]:
    """Million points a second of everybody, one thread."""
    points = sum(len(scan.points) for scan in scans)
    bound, mapper = Bound(scans), map_all(scans)
    rivals = {name: make() for name, make in RIVALS.items()}
    works: dict[str, Work] = {
        "terrafuse": lambda _, scan: mapper.integrate(scan),
        "bound: locate": lambda _, scan: bound.locate(scan),
        "bound: scatter": bound.scatter,
        **{name: (lambda _, scan, rival=rival: rival.take(scan)) for name, rival in rivals.items()},
    }
    rates = {name: points / s / 1e6 for name, s in seconds_of_all(works, scans).items()}
    rates["bound: both in series"] = 1 / (1 / rates["bound: locate"] + 1 / rates["bound: scatter"])
    return rates


def two_robots(scans: list[Scan]) -> dict[str, float]:
    """Million points a second of two robots, one after the other and on a thread each."""
    mappers = [map_all(scans, name) for name in ("r1", "r2")]

    def one_after_the_other() -> None:
        for mapper in mappers:
            warm_map(mapper, scans)

    def both() -> None:
        with ThreadPoolExecutor(2) as pool:
            list(pool.map(warm_map, mappers, (scans, scans)))

    jobs = {"two robots, one thread": one_after_the_other, "two robots, two threads": both}
    seconds = dict.fromkeys(jobs, float("inf"))
    for _ in range(ROUNDS):
        for name, job in jobs.items():
            seconds[name] = min(seconds[name], best(job, 1))
    points = 2 * sum(len(scan.points) for scan in scans)
    return {name: points / s / 1e6 for name, s in seconds.items()}


def stages(scans: list[Scan]) -> dict[str, float]:
    """Milliseconds a scan of each stage of the mapper, and of asking for what changed."""
    mapper = map_all(scans)
    before = dict(mapper.seconds)
    asked = 0.0
    for k, scan in enumerate(scans, start=1):
        mapper.integrate(scan)
        if k % 10 == 0:
            started = time.perf_counter()
            mapper.delta(mapper.revision - 10)
            asked += time.perf_counter() - started
    out = {stage: (seconds - before[stage]) / len(scans) * 1e3 for stage, seconds in mapper.seconds.items()}
    return out | {"delta (every 10th)": asked / len(scans) * 1e3}


FIRST_SCAN = """
import time; started = time.perf_counter()
import numpy as np
from terrafuse import Lattice, Mapper, Pose, Scan
mapper = Mapper("r1", Lattice(0.1))
points = np.random.default_rng(0).normal(0, 20, (100_000, 3)).astype(np.float32)
mapper.integrate(Scan(0, points, Pose.identity()))
print(time.perf_counter() - started)
"""


def start_up() -> dict[str, float]:
    """Seconds of fresh processes: to the first integrated scan with a warm kernel cache, and of --help."""

    def fresh(*arguments: str) -> float:
        return best(lambda: subprocess.run([sys.executable, *arguments], check=True, capture_output=True), 5)

    fresh("-c", FIRST_SCAN)
    return {
        "first scan, whole process": fresh("-c", FIRST_SCAN),
        "terrafuse --help": fresh("-m", "terrafuse", "--help"),
    }


def measure(count: int, order: str) -> dict[str, Any]:
    scans = stream(count, order)
    rates = kernels(scans) | two_robots(scans)
    return {
        "machine": f"{platform.machine()}, Python {platform.python_version()}, NumPy {np.__version__}",
        "stream": {"scans": len(scans), "points": sum(len(s.points) for s in scans), "order": order},
        "million_points_per_second": rates,
        "ratios": {
            "terrafuse / numpy.add.at": rates["terrafuse"] / rates["numpy.add.at"],
            "terrafuse / bound": rates["terrafuse"] / rates["bound: both in series"],
            "two threads / one thread": rates["two robots, two threads"] / rates["two robots, one thread"],
        },
        "milliseconds_per_scan": stages(scans),
        "start_up_seconds": start_up(),
    }


def main() -> None:
    arguments_of = parser(__doc__)
    arguments_of.add_argument("--scans", type=int, default=100)
    arguments_of.add_argument("--order", choices=("ring", "firing"), default="ring")
    arguments = arguments_of.parse_args()
    figures = measure(arguments.scans, arguments.order)
    tell(figures, arguments.json)


if __name__ == "__main__":
    main()
