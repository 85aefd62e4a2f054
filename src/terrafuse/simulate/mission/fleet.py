"""Where robots truly are, and how they move on: robots of one body together, none through anything."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from terrafuse.simulate.mission.surface import Surface
from terrafuse.simulate.motion import BODIES, Body, Command, Ground, Rotors, State, placed, step
from terrafuse.simulate.movers import bodies, body
from terrafuse.types import Array, Floats, Pose


class Drive(NamedTuple):
    """What one robot shall do."""

    speed_mps: float = 0.0
    yaw_rate_radps: float = 0.0
    altitude_m: float = 0.0
    """Above ground, for what flies."""


class Start(NamedTuple):
    """Where a robot begins, and what it is."""

    body: str
    x_m: float
    y_m: float
    yaw_rad: float


@dataclass
class _Group:
    """The robots of one body, by their numbers in the fleet."""

    kind: Body
    numbers: list[int]
    state: State


class Fleet:
    """The truth. Robots are counted from 0, in the order of `starts`."""

    def __init__(self, starts: Sequence[Start], surface: Surface) -> None:
        self._surface = surface
        self._shapes = [start.body for start in starts]
        self._groups = [self._group(name, starts) for name in sorted({start.body for start in starts})]
        self._where = {number: (group, row) for group in self._groups for row, number in enumerate(group.numbers)}

    def __len__(self) -> int:
        return len(self._shapes)

    def pose(self, robot: int) -> Pose:
        """T_world_base."""
        group, row = self._where[robot]
        return group.state.pose(row)

    def position_m(self, robot: int) -> Floats:
        group, row = self._where[robot]
        return np.asarray(group.state.position_m[row])

    def angles_rad(self, robot: int) -> tuple[float, float, float]:
        """Roll, pitch, yaw."""
        group, row = self._where[robot]
        return tuple(float(angle[row]) for angle in (group.state.roll_rad, group.state.pitch_rad, group.state.yaw_rad))  # type: ignore[return-value]

    def speed_mps(self, robot: int) -> tuple[float, float]:
        """Along the ground, and the yaw rate (rad/s)."""
        group, row = self._where[robot]
        return float(group.state.speed_mps[row]), float(group.state.yaw_rate_radps[row])

    def stopped_by_something(self, robot: int) -> bool:
        """Whether its last step was cut short."""
        group, row = self._where[robot]
        return bool(group.state.blocked[row])

    def kind(self, robot: int) -> Body:
        return self._where[robot][0].kind

    def bodies(self) -> list[Array]:
        """Of each robot what others see of it and run into."""
        out = []
        for number, shape in enumerate(self._shapes):
            x, y, z = self.position_m(number).tolist()
            out.append(body(shape, x, y, z, self.angles_rad(number)[2]))
        return out

    def step(self, drives: Mapping[int, Drive], dt_s: float, moving: Array) -> None:
        """All move on by `dt_s`; `moving` (K,) BODY is what else moves. A robot without a drive brakes."""
        others = self.bodies()
        for group in self._groups:
            command = _command([drives.get(number, Drive()) for number in group.numbers])
            group.state = step(group.state, command, dt_s, self._ground(group, others, moving), group.kind)

    def _ground(self, group: _Group, robots: list[Array], moving: Array) -> Ground:
        if isinstance(group.kind.carriage, Rotors):
            return self._surface.for_wings()
        return self._surface.for_wheels([
            bodies([moving, *(one for other, one in enumerate(robots) if other != number)]) for number in group.numbers
        ])  # fmt: skip

    def _group(self, name: str, starts: Sequence[Start]) -> _Group:
        numbers = [number for number, start in enumerate(starts) if start.body == name]
        kind = BODIES[name]
        ground = (
            self._surface.for_wings()
            if isinstance(kind.carriage, Rotors)
            else self._surface.for_wheels([bodies([]) for _ in numbers])
        )
        xy = np.array([[starts[number].x_m, starts[number].y_m] for number in numbers])
        yaw = np.array([starts[number].yaw_rad for number in numbers])
        return _Group(kind, numbers, placed(ground, kind, xy, yaw))


def _command(drives: Sequence[Drive]) -> Command:
    speed, yaw_rate, altitude = np.array(drives, np.float64).T
    return Command(speed, yaw_rate, altitude)


def alone(state: State, robot: int) -> State:
    """One robot of several, as a state of its own."""
    return State(**{field.name: getattr(state, field.name)[robot : robot + 1] for field in fields(State)})
