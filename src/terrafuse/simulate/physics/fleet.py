"""Some robots of one body in MuJoCo: built, placed, driven, read."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from terrafuse.errors import InputError
from terrafuse.navigate.pose_filter import rotation
from terrafuse.simulate.motion import BODIES, Command, State, within_limits
from terrafuse.simulate.physics.library import mujoco
from terrafuse.simulate.physics.machine import Heights, Moving, Places
from terrafuse.simulate.physics.machines import MACHINES
from terrafuse.simulate.terrain import Terrain
from terrafuse.types import Array, Floats

LAG_S = 0.4
"""A robot that touches something is told no speed that it could not reach within this time: it soon turns back."""


class Fleet:
    """Its robots are numbered as in their State. First `build`, then, in the compiled model, `put`."""

    def __init__(self, name: str, body: str, count: int, ground: Terrain, below: Heights, origin_m: Floats) -> None:
        if body not in MACHINES:
            raise InputError(f"robots {name}: there is no body '{body}'; take one of {', '.join(MACHINES)}")
        self._machine = MACHINES[body]
        self._limits = replace(BODIES[body], axle_m=self._machine.steering_track_m)
        self._names = [f"{name} {number}" for number in range(count)]
        self._ground, self._below, self._origin_m = ground, below, origin_m

    def build(self, spec: Any) -> None:
        for name in self._names:
            body = spec.worldbody.add_body(name=name)
            body.add_freejoint(name=name)
            self._machine.build(spec, body)

    def put(self, model: Any, data: Any, state: State) -> None:
        """Where and how they move now; those whose feet would be in the ground are lifted out of it."""
        places = self._places = _places(model, self._names, self._machine.motors)
        turn = np.array(
            [rotation(*angles) for angles in zip(state.roll_rad, state.pitch_rad, state.yaw_rad, strict=True)]
        )
        data.qpos[places.qpos[:, :3]] = state.position_m + self._lift_m(state.position_m, turn) - self._origin_m
        data.qpos[places.qpos[:, 3:]] = _quaternions(turn)
        data.qvel[places.dofs[:, :3]] = state.speed_mps[:, None] * turn[:, :, 0] + np.outer(state.climb_mps, [0, 0, 1])
        data.qvel[places.dofs[:, 3:]] = state.yaw_rate_radps[:, None] * turn[:, 2]
        self._speed_mps, self._yaw_rate_radps = state.speed_mps, state.yaw_rate_radps
        self._machine.set_wheels(data, places, self._speed_mps, self._yaw_rate_radps)

    def _lift_m(self, position_m: Floats, turn: Floats) -> Floats:
        feet = position_m[:, None] + np.einsum("nij,kj->nki", turn, self._machine.feet_m)
        sunk = self._ground.height(feet[..., 0], feet[..., 1]) - feet[..., 2]
        return np.outer(np.fmax.reduce(sunk, axis=1).clip(0), [0, 0, 1])

    def drive(self, data: Any, command: Command, dt_s: float, touched: Array) -> None:
        """Tell them what to do for the next moment: what is commanded, as fast as they speed up."""
        moving, limits = self.moving(data), self._limits
        slack_s = np.where(np.isin(self._places.bodies, touched), LAG_S, np.inf)
        speed = _near(self._speed_mps, moving.speed_mps, limits.max_mps2 * slack_s)
        yaw_rate = _near(self._yaw_rate_radps, moving.yaw_rate_radps, limits.max_yaw_radps2 * slack_s)
        self._speed_mps, self._yaw_rate_radps = within_limits(speed, yaw_rate, command, dt_s, limits)
        now = Command(self._speed_mps, self._yaw_rate_radps, command.altitude_m)
        self._machine.drive(data, self._places, moving, now, limits, self._below)

    def moving(self, data: Any) -> Moving:
        qpos, qvel = data.qpos[self._places.qpos], data.qvel[self._places.dofs]
        return Moving(qpos[:, :3] + self._origin_m, _turns(qpos[:, 3:]), qvel[:, :3], qvel[:, 3:])

    def state(self, data: Any, touched: Array) -> State:
        """`touched`: the bodies that met something."""
        moving = self.moving(data)
        turn, still = moving.turn, np.zeros(len(self._names))
        return State(
            moving.position_m,
            moving.yaw_rad,
            np.arctan2(turn[:, 2, 1], turn[:, 2, 2]),
            -np.arcsin(np.clip(turn[:, 2, 0], -1, 1)),
            moving.speed_mps,
            moving.yaw_rate_radps,
            moving.velocity_mps[:, 2].copy() if self._machine.flies else still,
            np.isin(self._places.bodies, touched),
        )


def _places(model: Any, names: list[str], motors: int) -> Places:
    joints, bodies = [model.joint(name) for name in names], [model.body(name) for name in names]
    dofs = np.array([joint.dofadr[0] for joint in joints])[:, None]
    qpos = np.array([joint.qposadr[0] for joint in joints])[:, None]
    first = np.array([model.actuator(f"{name} wheel 0").id if motors else 0 for name in names])[:, None]
    wheels = np.arange(motors)
    return Places(
        qpos + np.arange(7), dofs + np.arange(6), dofs + 6 + wheels, first + wheels, np.array([b.id for b in bodies])
    )


def _near(value: Floats, middle: Floats, most: Floats) -> Floats:
    return np.clip(value, middle - most, middle + most)


def _turns(wxyz: Floats) -> Floats:
    """(N, 3, 3) of unit quaternions (N, 4)."""
    w, x, y, z = wxyz.T
    out = np.empty((len(wxyz), 3, 3))
    out[:, 0, 0], out[:, 0, 1], out[:, 0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    out[:, 1, 0], out[:, 1, 1], out[:, 1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    out[:, 2, 0], out[:, 2, 1], out[:, 2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    return out


def _quaternions(turns: Floats) -> Floats:
    """(N, 4) w x y z of rotations (N, 3, 3)."""
    out = np.empty((len(turns), 4))
    for row, turn in zip(out, turns, strict=True):
        mujoco().mju_mat2Quat(row, turn.ravel())
    return out
