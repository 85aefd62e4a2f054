"""A drone: it leans where it shall speed up to, and its rotors push along its own upward axis. No drag, no wind."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from typing import Any

import numpy as np

from terrafuse.simulate.motion import Body, Command, Rotors
from terrafuse.simulate.movers import Part
from terrafuse.simulate.physics.machine import Heights, Moving, Places
from terrafuse.simulate.physics.scene import hull, solid
from terrafuse.types import Floats

GRAVITY_MPS2, UP = 9.81, np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Flyer:
    """Its origin is its middle."""

    hull: Part
    mass_kg: float
    inertia_kgm2: tuple[float, float, float]
    speed_hz: float = 3.0
    """It speeds up by this many times the missing speed a second."""
    lean_hz: float = 10.0
    """How quickly it leans, critically damped."""
    spare: float = 1.5
    """It may speed up this many times as fast as it is commanded to, to catch up."""
    motors: int = 0
    flies: bool = True
    steering_track_m: float = 0.0

    @property
    def feet_m(self) -> Floats:
        rim = np.linspace(0, 2 * pi, 8, endpoint=False)
        r = self.hull.length_m / 2
        return np.column_stack([r * np.cos(rim), r * np.sin(rim), np.full(8, self.hull.bottom_m)])

    def build(self, spec: Any, body: Any) -> None:
        body.explicitinertial = True
        body.mass, body.inertia, body.ipos = self.mass_kg, list(self.inertia_kgm2), [0, 0, 0]
        body.add_geom(**solid(self.hull), **hull(), mass=0)

    def set_wheels(self, data: Any, places: Places, speed_mps: Floats, yaw_rate_radps: Floats) -> None:
        """It has no wheels."""

    def drive(self, data: Any, places: Places, moving: Moving, command: Command, limits: Body, below: Heights) -> None:
        push = self.mass_kg * (self._wanted_mps2(moving, command, limits, below) + GRAVITY_MPS2 * UP)
        up = moving.turn[:, :, 2]
        lift = np.maximum(np.einsum("ni,ni->n", push, up), 0)
        data.xfrc_applied[places.bodies, :3] = lift[:, None] * up
        data.xfrc_applied[places.bodies, 3:] = np.einsum(
            "nij,nj->ni", moving.turn, self._torque_nm(moving, command, push)
        )

    def _wanted_mps2(self, moving: Moving, command: Command, limits: Body, below: Heights) -> Floats:
        yaw, most = moving.yaw_rad, self.spare * limits.max_mps2
        wanted = command.speed_mps[:, None] * np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros(len(yaw))])
        wanted[:, 2] = self._climb_mps(moving, command, limits, below)
        gain = self.speed_hz * (wanted - moving.velocity_mps)
        gain[:, :2] *= np.minimum(1, most / np.maximum(np.hypot(gain[:, 0], gain[:, 1]), 1e-9))[:, None]
        gain[:, 2] = np.clip(gain[:, 2], -most, most)
        return np.asarray(gain)

    def _climb_mps(self, moving: Moving, command: Command, limits: Body, below: Heights) -> Floats:
        rotors = limits.carriage
        assert isinstance(rotors, Rotors)
        below_m = below(moving.position_m[:, 0], moving.position_m[:, 1])
        missing_m = below_m + command.altitude_m - moving.position_m[:, 2]
        return np.asarray(np.clip(rotors.gain_hz * missing_m, -rotors.max_climb_mps, rotors.max_climb_mps))

    def _torque_nm(self, moving: Moving, command: Command, push: Floats) -> Floats:
        """About its own axes: towards the push for x and y, to the yaw rate for z."""
        towards = np.einsum("nij,ni->nj", moving.turn, push / np.linalg.norm(push, axis=1, keepdims=True))
        # z × towards, in its own frame: the turn that is missing.
        lean = np.column_stack([-towards[:, 1], towards[:, 0], np.zeros(len(push))])
        spin = moving.spin_radps.copy()
        spin[:, 2] -= command.yaw_rate_radps
        angular = self.lean_hz**2 * lean - 2 * self.lean_hz * spin
        return np.asarray(self.inertia_kgm2) * angular
