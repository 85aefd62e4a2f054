"""python -m bench.wire [--json FILE] [--seconds N] [--kitti FOLDER]

What maps cost on the wire: bytes a changed cell and bytes a robot-second by each profile, beside the same scans as raw
point clouds (float32 x y z), the same cells as raw float32 (position, height, confidence) and these in zstd. Then, how
long messages of 2,000 cells take.

KITTI 00: six scans at 10 Hz, of which each is reported. Village: the simulator's, one robot, a report every two seconds
as the scenario has it, of twenty scans. Fine maps of 0.1 to 0.5 m, and the global map's 5 m of 0.5 m cells. Messages
are cut as couriers cut them.
"""

from __future__ import annotations

import os
import platform
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import zstandard

from bench.report import parser, tell
from terrafuse.exchange.coarse import CoarseContribution
from terrafuse.exchange.codec import decode, encode
from terrafuse.exchange.delta import Delta, TileCells
from terrafuse.exchange.guard import Guard, Quotas
from terrafuse.exchange.profiles import report
from terrafuse.lattice import Lattice
from terrafuse.logs.base import parse_source
from terrafuse.logs.kitti import open_kitti
from terrafuse.mapper import Mapper
from terrafuse.models import make_model
from terrafuse.models.base import Reading
from terrafuse.simulate.mission.engine import Mission
from terrafuse.simulate.scenario import load_scenario
from terrafuse.simulate.scenario.read import changed
from terrafuse.types import Scan

PROFILES = ("lean", "full", "exact")
CERTAINTY = {"terrain": "confidence", "elevation": "n"}
FINE_M = (0.1, 0.2, 0.5)
GLOBAL = (0.5, 10)
"""Cells of the robots' maps, and how many of them the global map's take a side: 5 m."""
MESSAGE_CELLS = 2048
"""As in CourierSettings."""
MANY = 2000
ROUNDS = 300


@dataclass(frozen=True)
class Drive:
    """One robot's scans, and how many of them a report takes."""

    scans: Sequence[Scan]
    every: int
    rate_hz: float

    @property
    def seconds(self) -> float:
        return len(self.scans) / self.rate_hz

    @property
    def cloud_bytes(self) -> int:
        return sum(12 * len(scan.points) for scan in self.scans)


def kitti(folder: Path) -> Drive:
    source = parse_source(f"{folder}?poses=poses_velo_first6.txt&calib=identity")
    return Drive([scan for scan in open_kitti(source).scans() if isinstance(scan, Scan)], 1, 10.0)


def village(seconds: float) -> Drive:
    scans: list[Scan] = []
    loaded = changed(load_scenario("village"), duration_s=seconds)
    with tempfile.TemporaryDirectory() as folder:
        mission = Mission(loaded, folder=Path(folder))
        mission.vehicles[0].on_scan.append(scans.append)
        mission.run()
    return Drive(scans, round(10 * loaded.scenario.radio.report_s), 10.0)


def reports(drive: Drive, model: str, resolution_m: float, factor: int = 1) -> Iterator[Delta]:
    """What the robot reports, cell by cell, in messages."""
    mapper = Mapper("r1", Lattice(resolution_m), make_model(model))
    coarse = CoarseContribution(mapper, factor) if factor > 1 else None
    since = 0
    for number, scan in enumerate(drive.scans, start=1):
        mapper.integrate(scan)
        if number % drive.every == 0 or number == len(drive.scans):
            if coarse is not None:
                coarse.update()
            delta = (coarse or mapper).delta(since)
            since = delta.revision
            yield from messages(delta)


def messages(delta: Delta, most: int = MESSAGE_CELLS) -> Iterator[Delta]:
    """The delta cut into parts of at most so many cells."""
    part: list[TileCells] = []
    room = most
    for tile in delta.tiles:
        at = 0
        while at < len(tile.at):
            end = min(at + room, len(tile.at))
            part.append(TileCells(tile.key, tile.at[at:end], tile.cells[at:end]))
            room -= end - at
            at = end
            if room == 0:
                yield replace(delta, tiles=tuple(part))
                part, room = [], most
    if part:
        yield replace(delta, tiles=tuple(part))


def raw(delta: Delta) -> bytes:
    """Position, height and confidence of each cell as three float32, or int32 for the first."""
    model = make_model(delta.map.model)
    out = []
    for tile in delta.tiles:
        reading = Reading(delta.map.lattice, delta.stamp_ns)
        values = [
            model.layers[name].compute(tile.cells[None], reading)[0] for name in ("height", CERTAINTY[model.name])
        ]
        out.append(np.stack([tile.at.view(np.float32), *(value.astype(np.float32) for value in values)], axis=1))
    return np.concatenate(out).tobytes()


def cost(drive: Drive, model: str, resolution_m: float, factor: int = 1) -> dict[str, Any]:
    """Bytes a changed cell, a robot-second, and how many times fewer than the clouds, by profile."""
    deltas = list(reports(drive, model, resolution_m, factor))
    cells = sum(delta.cell_count for delta in deltas)
    plain = [raw(delta) for delta in deltas]
    sizes = {"float32": sum(map(len, plain)), "float32, zstd": sum(len(zstandard.compress(one, 19)) for one in plain)}
    for profile in PROFILES:
        sizes[profile] = sum(len(encode(report(delta, profile, make_model(model)))) for delta in deltas)
    return {"cells a second": round(cells / drive.seconds)} | {
        name: {
            "bytes a cell": round(size / cells, 2),
            "kB a second": round(size / drive.seconds / 1000, 2),
            "clouds / this": round(drive.cloud_bytes / size, 1),
        }
        for name, size in sizes.items()
    }


def costs(drive: Drive) -> dict[str, Any]:
    out: dict[str, Any] = {"clouds, kB a second": round(drive.cloud_bytes / drive.seconds / 1000)}
    for model in CERTAINTY:
        for resolution_m in FINE_M:
            out[f"{model} {resolution_m} m"] = cost(drive, model, resolution_m)
        out[f"{model} {GLOBAL[0] * GLOBAL[1]} m"] = cost(drive, model, *GLOBAL)
    return out


def least_us(work: Callable[..., Any], *arguments: Any) -> float:
    spent = []
    for _ in range(ROUNDS):
        started = time.perf_counter_ns()
        work(*arguments)
        spent.append(time.perf_counter_ns() - started)
    return round(min(spent) / 1000, 1)


def times(drive: Drive, model_name: str) -> dict[str, Any]:
    """Microseconds of a message of 2,000 cells of 0.5 m, one thread: to round, to write, to read, and to check."""
    model = make_model(model_name)
    delta = next(one for one in reports(drive, model_name, 0.5) if one.cell_count >= MANY)
    delta = next(messages(delta, MANY))
    guard = Guard(delta.map, Quotas(bytes_per_s=1e12, reach_m=1e6))
    guard.place("r1", 0.0, 0.0, delta.stamp_ns)
    out: dict[str, Any] = {}
    for profile in PROFILES:
        rounded = report(delta, profile, model)
        message = encode(rounded)
        out[profile] = {
            "bytes": len(message),
            "round": least_us(report, delta, profile, model),
            "write": least_us(encode, rounded),
            "read": least_us(decode, message, model.cell),
            "screen": least_us(guard.screen, "r1", message),
            "check": least_us(guard.check, "r1", rounded, delta.stamp_ns, len(message)),
        }
    return out


def main() -> None:
    asked = parser(__doc__)
    recordings = Path(os.environ.get("TERRAFUSE_RECORDINGS", "recordings"))
    asked.add_argument("--kitti", type=Path, default=recordings / "lidar3d/patchworkpp_kitti")
    asked.add_argument("--seconds", type=float, default=60.0, help="of the village")
    given = asked.parse_args()
    drives = {"village": village(given.seconds)}
    if given.kitti.is_dir():
        drives["KITTI 00"] = kitti(given.kitti)
    figures: dict[str, Any] = {
        "machine": f"{platform.processor() or platform.machine()}, Python {platform.python_version()}"
    }
    figures |= {name: costs(drive) for name, drive in drives.items()}
    figures["µs of 2,000 cells"] = {model: times(drives["village"], model) for model in CERTAINTY}
    tell(figures, given.json)


if __name__ == "__main__":
    main()
