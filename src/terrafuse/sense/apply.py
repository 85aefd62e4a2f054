"""Readings → scans, as a sensor's description says. What is left out is counted by its reason, in `Scan.dropped`."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from terrafuse.errors import InputError
from terrafuse.kernels.aim import ends
from terrafuse.sense.sensor import CLEAR, IGNORE, Beams, Ring, Sensor, axes
from terrafuse.types import Array, Floats, NoReturns, Pose, Readings, Scan, Stamp

SENTINEL_TOLERANCE_M = 5e-4
"""Logs print 8.183 also as 8.183001, and float32 has no 81.83; sensors count in millimetres or coarser."""

AIM_TOLERANCE_RAD = 0.01
"""How far a log's own angles may be from a description's: printed digits and float32 steps come to less, a beam of
another sensor to more."""

NOT_FINITE = "not finite"
TOO_NEAR = "nearer than the sensor's min_range_m"
NO_RETURN = "no return"


class Sorted(NamedTuple):
    """What each of (N,) readings says, as booleans: at most one of the two is true."""

    returned: Array
    clear: Array
    dropped: Counter[str]


class Shots(NamedTuple):
    """Beams of one scan: where each starts (K, 3), a vector of any length along it (K, 3), and its reading (K,)."""

    starts: Floats
    directions: Floats
    readings_m: Floats


def sort_readings(sensor: Sensor, readings_m: Floats) -> Sorted:
    """Codes come first, then the limits: the nearer one belongs to the range, the further one does not."""
    number = ~np.isnan(readings_m)
    clear, ignored = (_is_code(sensor, readings_m, says) for says in (CLEAR, IGNORE))
    plain = number & ~clear & ~ignored
    far = plain & (readings_m >= sensor.max_range_m)
    near = plain & ((readings_m < sensor.min_range_m) | (readings_m <= 0))
    if sensor.no_return == CLEAR:
        clear = clear | far
    else:
        ignored = ignored | far
    dropped = _counted({NOT_FINITE: ~number, TOO_NEAR: near, NO_RETURN: ignored})
    return Sorted(plain & ~far & ~near, clear, dropped)


def _is_code(sensor: Sensor, readings_m: Floats, says: str) -> Array:
    found = np.zeros(len(readings_m), bool)
    for code, meaning in sensor.sentinels_m:
        if meaning == says:
            found |= np.abs(readings_m - code) <= SENTINEL_TOLERANCE_M
    return found


def _counted(masks: Mapping[str, Array]) -> Counter[str]:
    return Counter({why: int(mask.sum()) for why, mask in masks.items() if mask.any()})


def scan_of(sensor: Sensor, ranges_m: Any, stamp_ns: Stamp, T_world_base: Pose) -> Scan:
    """The scan of one reading a beam, in the order of the sensor's beams.

    All beams count as of `stamp_ns`. Raises InputError for another number of readings than the sensor has beams.
    """
    readings = np.asarray(ranges_m, np.float64)
    directions, _ = axes(_described_beams(sensor))
    if readings.shape != (len(directions),):
        raise InputError(
            f"sensor {sensor.name}: readings of shape {readings.shape} for {len(directions)} beams; "
            f"give {len(directions)} numbers, one a beam, in their order"
        )
    return _aimed(sensor, Readings(readings, np.ones(len(readings), bool)), stamp_ns, T_world_base)


def _aimed(sensor: Sensor, readings: Readings, stamp_ns: Stamp, T_world_base: Pose) -> Scan:
    """The scan of readings along the sensor's own beams, of which there are as many.

    A reading that the log calls no return stays none: the log was read with a limit of its own, beyond which nothing
    counts.
    """
    directions, outward = axes(_described_beams(sensor))
    ranges_m, said = readings.ranges_m, sort_readings(sensor, readings.ranges_m)
    returned, cut = said.returned & readings.returned, said.returned & ~readings.returned
    hits, through = np.flatnonzero(returned), np.flatnonzero(said.clear)
    silent_m = min(readings.clear_m, sensor.max_range_m)
    reach_m = np.where(np.isposinf(ranges_m[through]), silent_m, sensor.max_range_m)
    origin_m, radius_m = np.asarray(sensor.origin_m, np.float64), float(sensor.radius_m)
    points = ends(origin_m, radius_m, outward, directions, hits, ranges_m.take(hits))
    misses = ends(origin_m, radius_m, outward, directions, through, reach_m)
    beams = np.concatenate([hits, through])
    origins = origin_m + radius_m * outward.take(beams, axis=0) if sensor.has_origins else None
    T_world_sensor = T_world_base @ sensor.mounting.T_base_sensor
    dropped = said.dropped + _counted({NO_RETURN: cut})
    return Scan(stamp_ns, points, T_world_sensor, misses, origins, sensor.beam, dropped=dropped)


def _described_beams(sensor: Sensor) -> Ring | Beams:
    if sensor.beams is None:
        raise InputError(f"sensor {sensor.name} describes no beams; give it a 'ring' or 'beams' with their angles")
    return sensor.beams


def check_aim(sensor: Sensor, readings: Readings) -> None:
    """Raise InputError where these can't be readings of the sensor's beams: another number of them, or the log states
    other angles."""
    directions, _ = axes(_described_beams(sensor))
    count = len(readings.ranges_m)
    own = "" if readings.directions is None else "; without 'ring' and 'beams' a description leaves the log its angles"
    if count != len(directions):
        raise InputError(
            f"the log has {count} beams, the sensor {sensor.name} has {len(directions)}: "
            f"describe the sensor that the log is of{own}"
        )
    if readings.directions is None:
        return
    apart = np.arccos(np.clip(np.einsum("ij,ij->i", directions, readings.directions), -1.0, 1.0))
    others = np.flatnonzero(~(apart <= AIM_TOLERANCE_RAD))
    if len(others):
        in_log, described = (_angles_text(vectors[others[0]]) for vectors in (readings.directions, directions))
        raise InputError(
            f"beam {others[0]} looks to {in_log} in the log, to {described} by the sensor {sensor.name}: "
            f"describe the sensor that the log is of{own}"
        )


def _angles_text(direction: Floats) -> str:
    azimuth_deg = math.degrees(math.atan2(direction[1], direction[0]))
    elevation_deg = math.degrees(math.asin(max(-1.0, min(1.0, direction[2]))))
    return f"{azimuth_deg:.2f}°" + (f" and {elevation_deg:.2f}° up" if abs(elevation_deg) > 0.005 else "")


def applied(sensor: Sensor, scan: Scan) -> Scan:
    """A scan that a reader made, as the sensor's description has it.

    Where both the description has beams and the log a reading for each, these are the scan, as in `scan_of`. Raises
    InputError where their numbers differ, or the angles that a log states itself.

    The reader's pose counts as the base's: the mounting is applied to it. Points at or beyond max_range_m become misses
    that end there, or are dropped, as `no_return` says; misses of the log's own, likewise. Beams that the log calls no
    return become misses where the sensor says `clear`. The points that stay are the same in every bit.
    """
    if scan.readings is not None and sensor.beams is not None:
        check_aim(sensor, scan.readings)
        aimed = _aimed(sensor, scan.readings, scan.stamp_ns, scan.T_world_sensor)
        return replace(aimed, dropped=Counter(scan.dropped) + Counter(aimed.dropped))
    points = _point_shots(sensor, scan)
    said = sort_readings(sensor, points.readings_m)
    dropped = Counter(scan.dropped) + said.dropped
    silent = [_cleared(points.starts[said.clear], points.directions[said.clear], sensor)]
    for found, lost in (_log_misses(sensor, scan), _heard_nothing(sensor, scan.no_returns)):
        silent.append(found)
        dropped += lost
    misses = np.concatenate([_ends(beams, sensor.max_range_m) for beams in silent])
    has_origins = sensor.has_origins or scan.origins is not None
    kept = slice(None) if said.returned.all() else said.returned
    return Scan(
        scan.stamp_ns,
        scan.points[kept],
        scan.T_world_sensor @ sensor.mounting.T_base_sensor,
        misses,
        np.concatenate([points.starts[kept], *(beams.starts for beams in silent)]) if has_origins else None,
        sensor.beam,
        dropped=dropped,
    )


def undescribed(scan: Scan) -> Scan:
    """The scan of a sensor that nobody described: what the log calls no return says nothing, and is counted."""
    if scan.no_returns is None:
        return scan
    lost = Counter({NO_RETURN: len(scan.no_returns.readings_m)})
    return replace(scan, no_returns=None, dropped=Counter(scan.dropped) + lost)


def _point_shots(sensor: Sensor, scan: Scan) -> Shots:
    """The beams of the points; readings are NaN where a point is not finite, and below 0 within the sensor's ring."""
    ends = scan.points[:, :3]
    if scan.origins is not None:
        return _shots(scan.origins[: len(ends)], ends)
    shots = _shots(_starts(sensor, ends), ends)
    if sensor.radius_m:
        behind = np.hypot(ends[:, 0] - sensor.origin_m[0], ends[:, 1] - sensor.origin_m[1]) < sensor.radius_m
        shots.readings_m[behind] *= -1
    return shots


def _log_misses(sensor: Sensor, scan: Scan) -> tuple[Shots, Counter[str]]:
    """The misses that the reader made, where the sensor lets silence count."""
    ends = np.empty((0, 3)) if scan.misses is None else scan.misses
    if sensor.no_return == IGNORE:
        return _no_shots(), Counter({NO_RETURN: len(ends)} if len(ends) else {})
    if scan.origins is None:
        return _shots(_starts(sensor, ends), ends), Counter()
    return _shots(scan.origins[len(scan.points) :], ends), Counter()


def _heard_nothing(sensor: Sensor, no_returns: NoReturns | None) -> tuple[Shots, Counter[str]]:
    """The beams that the log calls no return, where the sensor says that their way was clear.

    A reading that would be a return stays none: the log was read with a limit of its own, beyond which nothing counts.
    """
    if no_returns is None:
        return _no_shots(), Counter()
    said = sort_readings(sensor, no_returns.readings_m)
    directions = no_returns.directions[said.clear]
    cut = _counted({NO_RETURN: said.returned})
    starts = _starts(sensor, np.asarray(sensor.origin_m) + directions)
    return _cleared(starts, directions, sensor), said.dropped + cut


def _starts(sensor: Sensor, ends: Array) -> Floats:
    """Where beams start that end at these (K, 3) points: each looks outward from the sensor's ring."""
    origin = np.asarray(sensor.origin_m)
    if not sensor.radius_m:
        return np.asarray(np.broadcast_to(origin, ends.shape))
    outward = ends - origin
    outward[:, 2] = 0.0
    lengths = np.maximum(_lengths(outward), np.finfo(float).tiny)
    return np.asarray(origin + sensor.radius_m * outward / lengths[:, None])


def _shots(starts: Floats, ends: Array) -> Shots:
    offsets = ends - starts
    readings = _lengths(offsets)
    readings[~np.isfinite(readings)] = np.nan
    return Shots(starts, offsets, readings)


def _cleared(starts: Floats, directions: Floats, sensor: Sensor) -> Shots:
    return Shots(starts, directions, np.full(len(directions), sensor.max_range_m))


def _ends(shots: Shots, max_range_m: float) -> Floats:
    """Where the beams end: at their reading, or at the maximum range where that is nearer."""
    reach = np.minimum(shots.readings_m, max_range_m) / np.maximum(_lengths(shots.directions), np.finfo(float).tiny)
    return np.asarray(shots.starts + shots.directions * reach[:, None])


def _no_shots() -> Shots:
    return Shots(np.empty((0, 3)), np.empty((0, 3)), np.empty(0))


def _lengths(vectors: Array) -> Floats:
    return np.asarray(np.sqrt(np.einsum("ij,ij->i", vectors, vectors)))
