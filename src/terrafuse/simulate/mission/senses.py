"""A robot's sensors at work: when each is due, what it reads of the true world, and the scan that its robot maps.

A scan is as a log would hold it (points in float32, poses that went through a quaternion): a mission that is recorded
and mapped again gives the same map.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from terrafuse.logs.trajectory import quaternion_of
from terrafuse.sense import Mounting, Ring, Sensor, applied, scan_of
from terrafuse.sense.sensor import CLEAR
from terrafuse.simulate.rays import RayCaster
from terrafuse.simulate.scenario.model import SensorPart
from terrafuse.simulate.sensors import Lidar, Sonar, lidar_ranges, sonar_ranges
from terrafuse.simulate.sensors.codes import walsh_hadamard
from terrafuse.simulate.sensors.crosstalk import Ping, false_echoes
from terrafuse.types import Array, Floats, Pose, Scan, Stamp

RECEIVER = {"uncoded": "uncoded", "coded": "sliding"}
USABLE_CODES = (0, 1, 2, 4, 7, 3, 5, 6)
"""Rows of the Walsh–Hadamard matrix; the first five never mistake each other."""
AT_ONCE_S = 0.05
"""Rings that fire at once, each at a moment of its own, do so within this."""
FAR = 2.0
"""Times the maximum range: so far are points that stand for beams without an echo, beyond any doubt of rounding."""
FALSE_BY_M = 0.05
"""A reading that another robot's ping shortened by more is a false echo."""


@dataclass(frozen=True, eq=False)
class Around:
    """What a sensor meets besides the standing world at one instant."""

    caster: RayCaster
    stamp_ns: Stamp
    bodies: Array
    """All that moves, without the sensor's own robot."""
    pings: Sequence[Ping] = ()
    """Other robots' sonars that fire now."""


@dataclass
class Sense:
    """One sensor of one robot."""

    part: SensorPart
    sensor: Sensor
    number: int
    """The robot's in the fleet: its pings' code."""
    rng: np.random.Generator
    counts: dict[str, int] = field(default_factory=lambda: {"scans": 0, "beams": 0, "false_echoes": 0})
    next_ns: Stamp = 0

    @property
    def hears_others(self) -> bool:
        return self.part.kind == "sonar" and self.part.crosstalk != "off"

    def due(self, stamp_ns: Stamp) -> bool:
        """Whether it reads at this tick; then the next time is set."""
        if stamp_ns < self.next_ns:
            return False
        self.next_ns = (self.next_ns or stamp_ns) + self.period_ns
        return True

    @property
    def period_ns(self) -> int:
        return round(1e9 / self.part.rate_hz) if self.part.rate_hz else 0

    @cached_property
    def _mounting(self) -> Pose:
        return logged(self.sensor.mounting.T_base_sensor)

    def ping(self, T_world_base: Pose) -> Ping:
        """How others hear its round, or where all fire at once, its one ping."""
        round_s = len(self.sonar.turns_s) * self.sensor.firing_period_s or AT_ONCE_S
        delay_s = 0.0 if self.part.pulses == "aligned" else float(self.rng.uniform(0, round_s))
        code = walsh_hadamard()[USABLE_CODES[self.number % len(USABLE_CODES)]]
        return Ping(self.sonar, T_world_base, delay_s, code)

    @property
    def sonar(self) -> Sonar:
        return Sonar(self.sensor, specular_limit_rad=math.radians(self.part.specular_limit_deg))

    def ranges(self, T_world_base: Pose, around: Around, own: Ping | None = None) -> Floats:
        """One reading a beam, from where the robot truly is."""
        self.counts["scans"] += 1
        if self.part.kind == "lidar":
            lidar = Lidar(self.sensor, self.part.dropout)
            return lidar_ranges(lidar, around.caster, T_world_base, around.bodies, self.rng)
        heard = sonar_ranges(self.sonar, around.caster, T_world_base, around.bodies, self.rng)
        self.counts["beams"] += len(heard)
        if own is None or not around.pings:
            return heard
        receiver = RECEIVER[self.part.crosstalk]
        false = false_echoes(around.caster, own, around.pings, around.bodies, receiver)
        self.counts["false_echoes"] += int((false < heard - FALSE_BY_M).sum())
        return np.minimum(heard, false)

    def scan(self, ranges_m: Floats, stamp_ns: Stamp, T_world_base: Pose) -> Scan:
        """What the robot maps: the readings, at the pose that it believes."""
        scan = scan_of(self.sensor, ranges_m, stamp_ns, T_world_base)
        T_world_sensor = logged(T_world_base) @ self._mounting
        if self.part.kind == "lidar" and (self.sensor.no_return == CLEAR or self.sensor.has_origins):
            cloud = Scan(stamp_ns, _cloud(self.sensor, scan), T_world_sensor, dropped=scan.dropped)
            return applied(as_logged(self.sensor), cloud)
        return replace(scan, points=scan.points.astype(np.float32), T_world_sensor=T_world_sensor)

    def cloud(self, ranges_m: Floats) -> Array:
        """(N, 3) float32, in the sensor's frame: what a log keeps of a lidar's readings. Beams that met nothing and say
        that their way was clear are points beyond the maximum range."""
        return _cloud(self.sensor, scan_of(self.sensor, ranges_m, 0, Pose.identity()))


def _cloud(sensor: Sensor, scan: Scan) -> Array:
    misses = np.empty((0, 3)) if scan.misses is None else scan.misses
    start = np.asarray(sensor.origin_m) if scan.origins is None else scan.origins[len(scan.points) :]
    return np.concatenate([scan.points, start + FAR * (misses - start)]).astype(np.float32)


def as_logged(sensor: Sensor) -> Sensor:
    """What a reader of the log has to know of a sensor whose points are all returns, or beyond its range: it has no
    beams that would be readings, and no codes; where it sits, the log says."""
    ring = Ring(1, 0.0, math.tau, radius_m=sensor.radius_m) if sensor.radius_m else None
    return replace(sensor, min_range_m=0.0, sentinels_m=(), beams=ring, noise_sigma_m=0.0, mounting=Mounting())


def logged(pose: Pose) -> Pose:
    """The pose as a log keeps it: position and quaternion, whose length its reader sets to 1 in just this way."""
    turns = quaternion_of(pose)[None, :]
    return Pose.from_quaternion(pose.position, (turns / np.linalg.norm(turns, axis=1)[:, None])[0])
