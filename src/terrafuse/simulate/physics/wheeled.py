"""Robots on wheels: a hull on driven wheels and, where these are two, on balls that slide."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from terrafuse.simulate.motion import Body, Command
from terrafuse.simulate.movers import Part
from terrafuse.simulate.physics.library import mujoco
from terrafuse.simulate.physics.machine import Heights, Moving, Places
from terrafuse.simulate.physics.scene import GROUND, hull, solid, wheel
from terrafuse.types import Floats

TYRE_IMPEDANCE, TYRE_S, TYRE_SLIP_S = 0.5, 0.0286, 0.4
"""Soft contacts. In MuJoCo's friction cone (Todorov 2014) what slides at v is pushed up as if it sank by b·μ·v, where
b = 2/(TYRE_IMPEDANCE·TYRE_SLIP_S) = 10/s: below gravity up to slips of 1 m/s. With its usual hard contacts, b = 200/s,
wheels that skid hop, and a robot turns at half of the yaw rate that friction allows."""


@dataclass(frozen=True)
class Wheel:
    """Where it touches level ground; `aside_m` counts to the left."""

    ahead_m: float
    aside_m: float


@dataclass(frozen=True)
class Caster:
    """A ball that slides, `up_m` above level ground, on a spring where its contact takes longer than a tyre's."""

    ahead_m: float
    radius_m: float
    up_m: float = 0.0
    give_s: float = TYRE_S


@dataclass(frozen=True)
class Wheeled:
    """Its origin is on the ground, between its wheels. All of its wheels are driven, those of a side alike."""

    hull: Part
    mass_kg: float
    """With wheels."""
    centre_ahead_m: float
    centre_up_m: float
    """Of the hull's mass."""
    wheels: tuple[Wheel, ...]
    radius_m: float
    wheel_width_m: float
    wheel_kg: float
    firmness_nms: float
    """Torque for each rad/s that a wheel is too slow. Only the wheels' grip limits it."""
    steering_track_m: float
    sag_m: float
    """How far its wheels sink in under its weight, so that it stands at 0."""
    casters: tuple[Caster, ...] = ()
    friction: float = 0.8
    """Of wheels: rubber on dry asphalt."""
    slide: float = 0.02
    """Friction of casters."""
    flies: bool = False

    @property
    def motors(self) -> int:
        return len(self.wheels)

    @property
    def feet_m(self) -> Floats:
        wheels = [(one.ahead_m, one.aside_m, 0.0) for one in self.wheels]
        return np.array([*wheels, *((one.ahead_m, 0.0, one.up_m) for one in self.casters)])

    def build(self, spec: Any, body: Any) -> None:
        hull_kg = self.mass_kg - self.wheel_kg * len(self.wheels)
        body.explicitinertial = True
        body.mass, body.ipos = hull_kg, [self.centre_ahead_m, 0.0, self.centre_up_m]
        body.inertia = _inertia(self.hull, hull_kg)
        body.add_geom(**solid(self.hull), **hull(), mass=0)
        for number, caster in enumerate(self.casters):
            self._add_caster(spec, body, caster, f"{body.name} caster {number}")
        for number, place in enumerate(self.wheels):
            self._add_wheel(spec, body, place, f"{body.name} wheel {number}")

    def _add_caster(self, spec: Any, body: Any, caster: Caster, name: str) -> None:
        place = [caster.ahead_m, 0.0, caster.radius_m + caster.up_m]
        body.add_geom(
            **wheel(), name=name, type=mujoco().mjtGeom.mjGEOM_SPHERE, size=[caster.radius_m, 0, 0], pos=place, mass=0
        )
        _add_contact(spec, name, self.slide, caster.give_s)

    def _add_wheel(self, spec: Any, body: Any, place: Wheel, name: str) -> None:
        """An ellipsoid: round as it rolls, and it touches in one place that stays where it is."""
        library = mujoco()
        part = body.add_body(name=name, pos=[place.ahead_m, place.aside_m, self.radius_m - self.sag_m])
        part.add_joint(name=name, type=library.mjtJoint.mjJNT_HINGE, axis=[0, 1, 0])
        size = [self.radius_m, self.wheel_width_m / 2, self.radius_m]
        part.add_geom(**wheel(), name=name, type=library.mjtGeom.mjGEOM_ELLIPSOID, size=size, mass=self.wheel_kg)
        _add_contact(spec, name, self.friction)
        motor = spec.add_actuator(name=name, target=name, trntype=library.mjtTrn.mjTRN_JOINT)
        motor.set_to_velocity(kv=self.firmness_nms)

    def set_wheels(self, data: Any, places: Places, speed_mps: Floats, yaw_rate_radps: Floats) -> None:
        data.qvel[places.wheels] = self._wheels_radps(speed_mps, yaw_rate_radps)

    def drive(self, data: Any, places: Places, moving: Moving, command: Command, limits: Body, below: Heights) -> None:
        data.ctrl[places.motors] = self._wheels_radps(command.speed_mps, command.yaw_rate_radps)

    def _wheels_radps(self, speed_mps: Floats, yaw_rate_radps: Floats) -> Floats:
        """(N, W). Wheel and ground touch where both give way by half."""
        side = np.sign([one.aside_m for one in self.wheels])
        rim_mps = speed_mps[:, None] - yaw_rate_radps[:, None] * side * self.steering_track_m / 2
        return np.asarray(rim_mps / (self.radius_m - self.sag_m / 2))


def _add_contact(spec: Any, name: str, friction: float, give_s: float = TYRE_S) -> None:
    spec.add_pair(
        name=name,
        geomname1=GROUND,
        geomname2=name,
        friction=[friction, friction, 0, 0, 0],
        solref=[give_s, 1.0],
        solimp=[TYRE_IMPEDANCE, TYRE_IMPEDANCE, 0.001, 0.5, 2],
        solreffriction=[TYRE_SLIP_S, 1.0],
    )


def _inertia(part: Part, mass_kg: float) -> list[float]:
    """Of a box of even density around its middle, or of a cylinder."""
    # r²/4 of a cylinder is 3/4 of the a²/12 of a square of side 2r.
    share = 0.75 if part.round else 1.0
    x, y, z = part.length_m**2 * share, part.width_m**2 * share, (part.top_m - part.bottom_m) ** 2
    return [mass_kg * (y + z) / 12, mass_kg * (x + z) / 12, mass_kg * (x + y) / 12]
