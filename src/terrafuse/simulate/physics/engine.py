"""A world with robots in MuJoCo, stepped beside the kinematic `motion.step`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil, isfinite
from typing import Any

import numpy as np

from terrafuse.errors import InputError
from terrafuse.simulate.motion import Command, State
from terrafuse.simulate.physics.fleet import Fleet
from terrafuse.simulate.physics.library import mujoco
from terrafuse.simulate.physics.machine import Heights
from terrafuse.simulate.physics.scene import GROUND, add_world, origin_of
from terrafuse.simulate.physics.traffic import Traffic, add_movers
from terrafuse.simulate.world import World
from terrafuse.types import Array, Floats

SUNK_M = 0.02
"""A robot that starts deeper in something than this is refused."""


@dataclass(frozen=True)
class PhysicsSettings:
    step_s: float = 0.005
    """MuJoCo's, at most."""
    control_s: float = 0.01
    """Motors are told what to do this often, at least; what moves by the clock is put where it is."""

    def __post_init__(self) -> None:
        if not 0 < self.step_s <= 0.01 or not self.step_s <= self.control_s <= 0.02:
            raise InputError(
                f"physics steps of {self.step_s} s, control every {self.control_s} s: give a step of at most 0.01 s, "
                "and control no more often than that and at least every 0.02 s"
            )


DEFAULT = PhysicsSettings()


class Physics:
    """Robots with mass and wheels on a world's ground, among what stands and what moves.

    `bodies` names the body (a key of `motion.BODIES`) of each fleet, `states` has its robots, as of `motion.placed`:
    how they start. A fleet may be a single robot. `below`: above what drones keep their altitude, if not the ground.
    Raises InputError for a robot in something.
    """

    def __init__(
        self,
        world: World,
        bodies: Mapping[str, str],
        states: Mapping[str, State],
        time_s: float = 0.0,
        settings: PhysicsSettings = DEFAULT,
        below: Heights | None = None,
    ) -> None:
        if bodies.keys() != states.keys():
            raise InputError(
                f"bodies of {sorted(bodies)} but states of {sorted(states)}: give one of each for each fleet"
            )
        self._settings, self._origin_m = settings, origin_of(world)
        self._fleets = {
            name: Fleet(name, body, len(states[name]), world.terrain, below or world.terrain.height, self._origin_m)
            for name, body in bodies.items()
        }
        self._model = _compiled(world, self._fleets, self._origin_m)
        self._data = mujoco().MjData(self._model)
        self._owners = self._model.body_rootid[self._model.geom_bodyid]
        self._ground = self._model.geom(GROUND).id
        self._traffic = Traffic(world, self._origin_m, self._model, time_s)
        self._start(states)

    def _start(self, states: Mapping[str, State]) -> None:
        self._traffic.place(self._data, 0.0, 1.0)
        for name, fleet in self._fleets.items():
            fleet.put(self._model, self._data, states[name])
        mujoco().mj_forward(self._model, self._data)
        sunk = self._touched(SUNK_M)
        for name, state in self.states(sunk).items():
            for robot in np.flatnonzero(state.blocked):
                place = tuple(np.round(state.position_m[robot, :2], 2).tolist())
                raise InputError(f"robot {robot} of {name} at {place}: something is in its place; choose a free one")

    def step(self, commands: Mapping[str, Command], dt_s: float, time_s: float) -> dict[str, State]:
        """All robots `dt_s` after `time_s`, commanded all the while. `State.blocked`: it met something other than the
        ground in between."""
        if commands.keys() != self._fleets.keys():
            raise InputError(f"commands for {sorted(commands)}: give them for {sorted(self._fleets)}")
        if not (isfinite(dt_s) and dt_s > 0):
            raise InputError(f"a step of {dt_s} s: give a positive number of seconds")
        ticks = ceil(dt_s / self._settings.control_s - 1e-9)
        steps = ceil(dt_s / ticks / self._settings.step_s - 1e-9)
        self._model.opt.timestep = dt_s / ticks / steps
        touched = [self._touched()]
        self._traffic.go(time_s, time_s + dt_s)
        for tick in range(ticks):
            self._traffic.place(self._data, tick / ticks, dt_s)
            touched.append(self._tick(commands, dt_s / ticks, steps, touched[-1]))
        return self.states(np.concatenate(touched[1:]))

    def _tick(self, commands: Mapping[str, Command], tick_s: float, steps: int, touched: Array) -> Array:
        for name, fleet in self._fleets.items():
            fleet.drive(self._data, commands[name], tick_s, touched)
        mujoco().mj_step(self._model, self._data, nstep=steps)
        self._check()
        return self._touched()

    def states(self, touched: Array | tuple[int, ...] = ()) -> dict[str, State]:
        """All robots now; `touched`: the bodies that count as blocked."""
        return {name: fleet.state(self._data, np.asarray(touched)) for name, fleet in self._fleets.items()}

    def _touched(self, deeper_m: float = 0.0) -> Array:
        """The bodies that are in contact with anything but the ground."""
        contact = self._data.contact
        pairs = contact.geom[(contact.geom != self._ground).all(axis=1) & (contact.dist < -deeper_m)]
        return np.asarray(self._owners[pairs].ravel())

    def _check(self) -> None:
        warning = mujoco().mjtWarning
        bad = (warning.mjWARN_BADQPOS, warning.mjWARN_BADQVEL, warning.mjWARN_BADQACC)
        if any(self._data.warning[kind].number for kind in bad):
            raise InputError(
                f"physics diverged at steps of {self._settings.step_s} s; give PhysicsSettings a shorter step_s"
            )


def _compiled(world: World, fleets: Mapping[str, Fleet], origin_m: Floats) -> Any:
    library = mujoco()
    spec = library.MjSpec()
    option = spec.option
    # Motors that hold a speed firmly and contacts are one stiff problem; this integrator solves both at once.
    option.integrator = library.mjtIntegrator.mjINT_DISCRETE
    # Round friction cones, else skid steering would depend on the compass; firm ones, else robots creep on slopes.
    option.cone, option.impratio = library.mjtCone.mjCONE_ELLIPTIC, 1000.0
    for fleet in fleets.values():
        fleet.build(spec)
    add_world(spec, world, origin_m)
    add_movers(spec, world)
    return spec.compile()
