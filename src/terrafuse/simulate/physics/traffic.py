"""What moves by the clock, for MuJoCo: bodies so heavy that they push robots and are pushed by none.

They have velocities as well as places, else a contact would not know how hard it is hit.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from terrafuse.simulate.movers import SHAPES, Mover, Part
from terrafuse.simulate.physics.library import mujoco
from terrafuse.simulate.physics.scene import solid, standing
from terrafuse.simulate.world import World
from terrafuse.types import Floats

AWAY_M = -1000.0
"""What is not there waits this far below."""
HEAVY_KG = 1e6
SKIRT_M = 0.5
SOLREF = (0.05, 1.0)
"""Gives way by 0.2 m at 10 m/s: what turns into a robot pushes it out, and does not shoot it away."""


def add_movers(spec: Any, world: World) -> None:
    for number, mover in enumerate(world.movers):
        body = spec.worldbody.add_body(gravcomp=1.0)
        _add_joints(body, number)
        for part in SHAPES[mover.shape]:
            body.add_geom(**solid(_skirted(part)), **(standing() | {"solref": SOLREF}), priority=1, mass=HEAVY_KG)


def _add_joints(body: Any, number: int) -> None:
    kinds = mujoco().mjtJoint
    for name, axis in (("x", [1, 0, 0]), ("y", [0, 1, 0]), ("z", [0, 0, 1])):
        body.add_joint(name=f"mover {number} {name}", type=kinds.mjJNT_SLIDE, axis=axis)
    body.add_joint(name=f"mover {number} yaw", type=kinds.mjJNT_HINGE, axis=[0, 0, 1])


def _skirted(part: Part) -> Part:
    """A part near the ground reaches into it: who is hit is pushed away, and not under a car."""
    return replace(part, bottom_m=-SKIRT_M) if part.bottom_m < SKIRT_M else part


class Traffic:
    """Where a world's movers are. They are asked for a later time each time, and go straight in between."""

    def __init__(self, world: World, origin_m: Floats, model: Any, time_s: float) -> None:
        self._world, self._origin_m = world, np.append(origin_m, 0.0)
        joints = [model.joint(f"mover {number} x") for number in range(len(world.movers))]
        self._qpos = np.array([joint.qposadr[0] for joint in joints], np.int64)[:, None] + np.arange(4)
        self._dofs = np.array([joint.dofadr[0] for joint in joints], np.int64)[:, None] + np.arange(4)
        self._time_s, self._places = time_s, self._at(time_s)
        self._begin, self._way = self._places, np.zeros_like(self._places)

    def go(self, from_s: float, until_s: float) -> None:
        """Be on the way from one time to the other."""
        begin = self._places if from_s == self._time_s else self._at(from_s)
        self._time_s, self._places = until_s, self._at(until_s)
        end = np.where(np.isnan(self._places), begin, self._places)
        self._begin = np.where(np.isnan(begin), end, begin)
        # On routes they turn at once. With the speed of such a turn a car would swat whoever is beside it.
        self._begin[:, 3] = end[:, 3]
        self._way = end - self._begin

    def place(self, data: Any, share: float, whole_s: float) -> None:
        """Put them where they are after this share of the way, which takes them `whole_s`."""
        places = self._begin + share * self._way
        there = np.isfinite(places)
        data.qpos[self._qpos] = np.where(there, places, [0.0, 0.0, AWAY_M, 0.0])
        data.qvel[self._dofs] = np.where(there, self._way / whole_s, 0.0)

    def _at(self, time_s: float) -> Floats:
        """(K, 4): x, y, z, yaw of each mover, NaN where it is not there."""
        places = np.array([_place(mover, time_s) for mover in self._world.movers]).reshape(-1, 3)
        z = self._world.terrain.height(places[:, 0], places[:, 1])
        return np.asarray(np.column_stack([places[:, :2], z, places[:, 2]]) - self._origin_m)


def _place(mover: Mover, time_s: float) -> tuple[float, float, float]:
    return mover.route.at(time_s) or (np.nan, np.nan, np.nan)
