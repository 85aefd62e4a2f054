"""Prints the golden bytes of the delta format, a comment a line: python -m tests.exchange.make_golden"""

from __future__ import annotations

import math

from terrafuse.exchange.codec import START, encode
from terrafuse.exchange.delta import Delta
from terrafuse.exchange.profiles import report
from terrafuse.lattice import Lattice
from terrafuse.mapper import Mapper
from terrafuse.models import make_model
from terrafuse.testing.deltas import scan_of
from terrafuse.types import Beam, Pose, Scan

MODELS = {
    "elevation": make_model("elevation"),
    "grey": make_model("grey", {"opening_angle_rad": math.radians(22.5)}),
    "occupancy": make_model("occupancy", {"min_z_m": -10, "max_z_m": 10}),
    "terrain": make_model("terrain"),
}
NAMES = [f"{model} {form}" for model in MODELS for form in ("exact", "full", "lean")]


def golden_delta(name: str = "elevation exact") -> Delta:
    """Two scans of robot r1 on 1 m cells in 4 m tiles, by this model and profile."""
    model, form = name.split()
    mapper = Mapper("r1", Lattice(1.0, 4.0), MODELS[model])
    for scan in _scans(model):
        mapper.integrate(scan)
    return report(mapper.delta(since=0), form, MODELS[model])


def _scans(model: str) -> list[Scan]:
    first = [(0.503, 0.5, 1.0), (0.52, 0.6, 1.03), (2.5, 1.5, 2.0), (-0.5, 0.5, -1.0), (-0.5, 0.7, -1.4)]
    second = [(0.5, 0.5, 5.0), (0.6, 0.5, 5.2)]
    if model != "grey":
        return [scan_of(first, 1_000_000_000), scan_of(second, 2_000_000_000)]
    beam = Beam(half_angle_rad=math.radians(11.25), range_error_m=0.1, max_range_m=3.0)
    pose = Pose.identity().shifted(0.2, 0.3)
    return [
        Scan(stamp_ns, scan_of([end]).points, pose, beam=beam)
        for stamp_ns, end in ((1_000_000_000, (1.5, 0.3, 0.0)), (2_000_000_000, (0.2, 1.4, 0.0)))
    ]


def parts(message: bytes) -> list[tuple[str, bytes]]:
    """The message cut as the format describes it."""
    length, end = START.unpack_from(message)[-1], START.size
    return [
        ("magic", message[:3]),
        ("format version", message[3:4]),
        ("form", message[4:5]),
        ("header length", message[5:end]),
        ("header, msgpack", message[end : end + length]),
        ("body", message[end + length : -4]),
        ("CRC-32 of all before", message[-4:]),
    ]


if __name__ == "__main__":
    for name in NAMES:
        print(f'    "{name}": bytes.fromhex(')
        for part, content in parts(encode(golden_delta(name))):
            print(f"        # {part}")
            for k in range(0, len(content), 46):
                print(f'        "{content[k : k + 46].hex()}"')
        print("    ),")
