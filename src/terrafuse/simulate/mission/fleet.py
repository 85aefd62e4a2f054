"""Where robots truly are, and how they move on: robots of one body together. On wheels, none goes through anything; to
robots with physics those without are as air, and what flies meets what stands, but not each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from terrafuse.simulate.mission.surface import Surface
from terrafuse.simulate.motion import BODIES, Body, Command, Ground, Rotors, State, in_the_way, placed, step
from terrafuse.simulate.movers import bodies, body
from terrafuse.simulate.world import World
from terrafuse.types import Array, Floats, Pose

if TYPE_CHECKING:
    from terrafuse.simulate.physics import Physics


KINEMATIC, PHYSICS = "kinematic", "physics"
"""How robots move: as told, within limits; or with mass, wheels and contact."""
EPSILON_M = 1e-9


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
    motion: str = KINEMATIC


@dataclass
class _Group:
    """The robots of one body that move alike, by their numbers in the fleet."""

    body: str
    motion: str
    numbers: list[int]
    state: State

    @property
    def kind(self) -> Body:
        return BODIES[self.body]


class Fleet:
    """The truth. Robots are counted from 0, in the order of `starts`."""

    def __init__(self, starts: Sequence[Start], surface: Surface, world: World) -> None:
        self._surface = surface
        self._shapes = [start.body for start in starts]
        self._groups = [self._group(*kind, starts) for kind in sorted({(start.body, start.motion) for start in starts})]
        self._physics = self._engine(world)
        self._time_s = 0.0
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
        others, before = self.bodies(), [group.state for group in self._groups]
        touching = {number: self._touching(number) for number in self._near_others()}
        commands = [_command([drives.get(number, Drive()) for number in group.numbers]) for group in self._groups]
        for group, command in zip(self._groups, commands, strict=True):
            if group.motion == KINEMATIC:
                group.state = step(group.state, command, dt_s, self._ground(group, others, moving), group.kind)
        self._keep_apart(before, touching)
        if self._physics is not None:
            told = {g.body: command for g, command in zip(self._groups, commands, strict=True) if g.motion == PHYSICS}
            states = self._physics.step(told, dt_s, self._time_s)
            for group in self._groups:
                group.state = states[group.body] if group.motion == PHYSICS else group.state
        self._time_s += dt_s

    def _keep_apart(self, before: Sequence[State], touching: Mapping[int, int]) -> None:
        """Each avoided where the others were before the step. Of two that are in each other now, more than they were,
        the first goes back to where it was itself: nobody came there; and so does whoever went on into another."""
        were_m = {number: self._place(number, before) for number in range(len(self))}
        for number in self._near_others():
            group, row = self._where[number]
            if group.motion != KINEMATIC:
                continue
            now = self._touching(number)
            if now > touching.get(number, 0) or (now and self._went_on(number, were_m)):
                group.state = _put_back(group.state, self._of(group, before), row)

    def _went_on(self, number: int, were_m: Mapping[int, Floats]) -> bool:
        """Whether its own step brought it nearer to where another stood that it may be in."""
        here, radius = self.position_m(number)[:2], self.kind(number).radius_m
        for other, stood in were_m.items():
            if other != number:
                near, was = (float(np.hypot(*(place - stood))) for place in (here, were_m[number]))
                if near < was - EPSILON_M and near < radius + self.kind(other).radius_m:
                    return True
        return False

    def _place(self, robot: int, states: Sequence[State]) -> Floats:
        group, row = self._where[robot]
        return np.asarray(self._of(group, states).position_m[row, :2])

    def _of(self, group: _Group, states: Sequence[State]) -> State:
        return next(state for one, state in zip(self._groups, states, strict=True) if one is group)

    def _near_others(self) -> list[int]:
        """Robots that may touch another, by their radii."""
        places = np.array([self.position_m(number)[:2] for number in range(len(self))])
        radii = np.array([self.kind(number).radius_m for number in range(len(self))])
        apart = np.hypot(*(places[:, None] - places).transpose(2, 0, 1)) - radii[:, None] - radii
        np.fill_diagonal(apart, np.inf)
        return [int(number) for number in np.flatnonzero(apart.min(axis=1) < 0)]

    def _touching(self, number: int) -> int:
        """How much of a robot on wheels is in others."""
        kind = self.kind(number)
        if isinstance(kind.carriage, Rotors):
            return 0
        others = [one for other, one in enumerate(self.bodies()) if other != number]
        ground = self._surface.for_wheels([bodies(others)])
        return int(in_the_way(ground, kind, self.position_m(number)[:2])[0])

    def _engine(self, world: World) -> Physics | None:
        """One for all robots with physics, which run into each other, too; to those without, they are as air."""
        groups = [group for group in self._groups if group.motion == PHYSICS]
        if not groups:
            return None
        from terrafuse.simulate.physics import Physics

        bodies_of = {group.body: group.body for group in groups}
        return Physics(world, bodies_of, {group.body: group.state for group in groups}, below=self._surface.top)

    def _ground(self, group: _Group, robots: list[Array], moving: Array) -> Ground:
        if isinstance(group.kind.carriage, Rotors):
            return self._surface.for_wings()
        return self._surface.for_wheels([
            bodies([moving, *(one for other, one in enumerate(robots) if other != number)]) for number in group.numbers
        ])  # fmt: skip

    def _group(self, name: str, motion: str, starts: Sequence[Start]) -> _Group:
        numbers = [n for n, start in enumerate(starts) if (start.body, start.motion) == (name, motion)]
        kind = BODIES[name]
        ground = (
            self._surface.for_wings()
            if isinstance(kind.carriage, Rotors)
            else self._surface.for_wheels([bodies([]) for _ in numbers])
        )
        xy = np.array([[starts[number].x_m, starts[number].y_m] for number in numbers])
        yaw = np.array([starts[number].yaw_rad for number in numbers])
        return _Group(name, motion, numbers, placed(ground, kind, xy, yaw))


def _put_back(state: State, was: State, row: int) -> State:
    """With one robot where it was, at rest and stopped."""
    values = {field.name: getattr(state, field.name).copy() for field in fields(State)}
    for name, column in values.items():
        column[row] = getattr(was, name)[row]
    values["speed_mps"][row], values["yaw_rate_radps"][row], values["blocked"][row] = 0.0, 0.0, True
    return State(**values)


def _command(drives: Sequence[Drive]) -> Command:
    speed, yaw_rate, altitude = np.array(drives, np.float64).T
    return Command(speed, yaw_rate, altitude)
