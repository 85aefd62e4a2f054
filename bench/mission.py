"""python -m bench.mission [--json FILE] [--seconds S] [--rounds N]: how many times faster than real time a mission is.

The village: three robots with lidars of 16 × 900 beams at 10 Hz: rays, noise, localising, mapping, radio, fusing,
planning, driving; no pictures. By the clock on the wall, of several runs that take turns the best, on one thread and on
two; and the processor time of one thread, which others on the machine touch less. Setting up is not counted.
"""

from __future__ import annotations

import os
import platform
import tempfile
import time
from pathlib import Path
from typing import Any

from bench.report import parser, tell
from terrafuse.simulate.mission.engine import Mission
from terrafuse.simulate.scenario import Loaded, load_scenario
from terrafuse.simulate.scenario.read import changed


def times(loaded: Loaded, threads: int) -> tuple[float, float]:
    """Simulated seconds in one of the clock, and in one of the processor."""
    with tempfile.TemporaryDirectory() as folder:
        mission = Mission(loaded, folder=Path(folder))
        wall_s, processor_s = time.perf_counter(), time.process_time()
        mission.run(threads=threads)
        spent = time.perf_counter() - wall_s, time.process_time() - processor_s
    return mission.now_s / spent[0], mission.now_s / spent[1]


def measure(seconds: float, rounds: int) -> dict[str, Any]:
    times(changed(load_scenario("village"), duration_s=2.0), 1)  # loads the kernels
    loaded = changed(load_scenario("village"), duration_s=seconds)
    found = [(times(loaded, 1), times(loaded, 2)) for _ in range(rounds)]
    return {
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f} at the end",
        "simulated s": seconds,
        "times real time": {
            "one thread": round(max(one[0] for one, _ in found), 2),
            "two threads": round(max(two[0] for _, two in found), 2),
        },
        "simulated s a processor second, one thread": round(max(one[1] for one, _ in found), 2),
    }


def main() -> None:
    arguments = parser(__doc__)
    arguments.add_argument("--seconds", type=float, default=30.0)
    arguments.add_argument("--rounds", type=int, default=3)
    asked = arguments.parse_args()
    tell(measure(asked.seconds, asked.rounds), asked.json)


if __name__ == "__main__":
    main()
