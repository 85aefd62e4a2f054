"""One robot's pings in another's ears: the ways that sound takes between two rings of sonars."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from terrafuse.simulate.rays import RayCaster
from terrafuse.simulate.sensors.codes import SOUND_M_S, Arrivals, chips, let_through, range_of
from terrafuse.simulate.sensors.lidar import beams_in_world
from terrafuse.simulate.sensors.sonar import Sonar, cone, cone_hits
from terrafuse.types import Array, Floats, Pose

OFF_SURFACE_M = 1e-6


@dataclass(frozen=True, eq=False)
class Ping:
    """A ring, or one `fired` sonar of it, that sends at a time with a code, from where its robot stands.

    A ring whose sonars fire in turn begins its round at that time, and goes round and round.
    """

    sonar: Sonar
    T_world_base: Pose
    time_s: float
    code: Array


def sound_paths(caster: RayCaster, sender: Ping, receiver: Ping, bodies: Array) -> Floats:
    """(sending sonars, receiving sonars): metres of the shortest way from one to the other, straight or by one
    reflection; inf where no sound arrives within twice the sender's maximum range.

    Both cones must cover the way. At a surface, sound leaves around the mirrored direction, up to twice the specular
    limit off it, which is what makes a sonar's own echoes. `bodies`: all but the two robots' own.
    """
    return np.minimum(_straight(caster, sender, receiver, bodies), _reflected(caster, sender, receiver, bodies))


def false_echoes(
    caster: RayCaster,
    receiver: Ping,
    others: Sequence[Ping],
    bodies: Array,
    kind: str = "sliding",
    threshold: float = 0.5,
) -> Floats:
    """(receiving sonars,): the nearest range that each reads from others' pings which `codes.RECEIVERS[kind]` lets
    through; inf where there is none. What it would read is the lesser of this and its own reading."""
    out = np.full(len(_beams(receiver)[1]), np.inf)
    for other in others:
        paths = sound_paths(caster, other, receiver, bodies)
        delays = _later_s(other, receiver) + paths / SOUND_M_S
        ranges = np.where(delays >= 0, range_of(delays), np.inf)
        ranges[~(ranges < receiver.sonar.sensor.max_range_m)] = np.inf
        for sending, hearing in np.argwhere(np.isfinite(ranges)):
            heard = Arrivals(other.code[None, :], chips(delays[sending, hearing])[None], np.ones(1))
            if let_through(kind, receiver.code, heard, threshold)[0]:
                out[hearing] = min(out[hearing], ranges[sending, hearing])
    return out


def _later_s(sender: Ping, receiver: Ping) -> Floats:
    """(sending sonars, receiving sonars): from when one listens to when the other sends, of the rounds that are nearest
    to each other."""
    turns_s = sender.sonar.turns_s
    later = sender.time_s + turns_s[:, None] - receiver.time_s - receiver.sonar.turns_s
    round_s = sender.sonar.sensor.firing_period_s * len(turns_s)
    in_turn = round_s > 0 and later.size > 1
    return np.asarray(later - round_s * np.round(later / round_s) if in_turn else later)


def _beams(ping: Ping) -> tuple[Floats, Floats]:
    """Where each sonar is and looks, (N, 3) and (N, 3)."""
    starts, axes = beams_in_world(ping.sonar.sensor, ping.T_world_base)
    return np.broadcast_to(starts, axes.shape), axes


def _straight(caster: RayCaster, sender: Ping, receiver: Ping, bodies: Array) -> Floats:
    (a, looks_a), (b, looks_b) = _beams(sender), _beams(receiver)
    way = b[None, :] - a[:, None]
    length = np.linalg.norm(way, axis=2)
    heading = way / np.maximum(length, 1e-12)[..., None]
    sent = _within(np.einsum("ijk,ik->ij", heading, looks_a), sender.sonar.sensor.cone_half_angle_rad)
    heard = _within(-np.einsum("ijk,jk->ij", heading, looks_b), receiver.sonar.sensor.cone_half_angle_rad)
    near = length < 2 * sender.sonar.sensor.max_range_m
    free = _free(caster, sent & heard & near, np.broadcast_to(a[:, None], way.shape), heading, length, bodies)
    return np.where(free, length, np.inf)


def _reflected(caster: RayCaster, sender: Ping, receiver: Ping, bodies: Array) -> Floats:
    """By one reflection: each ray of the sender's cones, where it meets a surface, against each receiving sonar."""
    origins, rays, hits = cone_hits(sender.sonar, caster, sender.T_world_base, bodies)
    b, looks_b = _beams(receiver)
    met = np.isfinite(hits.ranges_m)
    first = np.where(met, hits.ranges_m, 0.0)
    at = origins + first[:, None] * rays + OFF_SURFACE_M * hits.normals
    mirrored = rays - 2 * np.einsum("ij,ij->i", rays, hits.normals)[:, None] * hits.normals
    way = b[None, :] - at[:, None]
    length = np.linalg.norm(way, axis=2)
    heading = way / np.maximum(length, 1e-12)[..., None]
    leaves = _within(np.einsum("ijk,ik->ij", heading, mirrored), 2 * sender.sonar.specular_limit_rad)
    heard = _within(-np.einsum("ijk,jk->ij", heading, looks_b), receiver.sonar.sensor.cone_half_angle_rad)
    whole = first[:, None] + length
    asked = met[:, None] & leaves & heard & (whole < 2 * sender.sonar.sensor.max_range_m)
    free = _free(caster, asked, np.broadcast_to(at[:, None], way.shape), heading, length, bodies)
    of_a_cone = len(cone(sender.sonar.sensor.cone_half_angle_rad, sender.sonar.circles))
    return np.asarray(np.where(free, whole, np.inf).reshape(-1, of_a_cone, len(b)).min(axis=1))


def _within(cosines: Floats, angle_rad: float) -> Array:
    return np.asarray(cosines >= np.cos(min(angle_rad, np.pi)) - 1e-12)


def _free(caster: RayCaster, asked: Array, starts: Floats, headings: Floats, length: Floats, bodies: Array) -> Array:
    """Which of the asked ways (I, J) meet nothing."""
    out = asked.copy()
    if asked.any():
        reach = float(length[asked].max())
        out[asked] = caster.cast(starts[asked], headings[asked], reach, bodies).ranges_m >= length[asked] - 1e-6
    return out
