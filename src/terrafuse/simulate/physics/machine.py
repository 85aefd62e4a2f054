"""What a kind of robot is to the engine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from terrafuse.simulate.motion import Body, Command
from terrafuse.types import Array, Floats

Heights = Callable[[Floats, Floats], Floats]
"""z at x and y, NaN where there is nothing."""


@dataclass(frozen=True, eq=False)
class Places:
    """Where the numbers of N robots of one kind are in MuJoCo's arrays."""

    qpos: Array
    """(N, 7): place and quaternion of the base."""
    dofs: Array
    """(N, 6): its velocity, in the world, and its spin, about its own axes."""
    wheels: Array
    """(N, W): the dofs of its wheels."""
    motors: Array
    """(N, W): their actuators."""
    bodies: Array
    """(N,)"""


@dataclass(frozen=True, eq=False)
class Moving:
    """N robots now. `turn` (N, 3, 3) takes their axes to the world's."""

    position_m: Floats
    turn: Floats
    velocity_mps: Floats
    spin_radps: Floats
    """(N, 3), about their own axes."""

    @property
    def yaw_rad(self) -> Floats:
        return np.asarray(np.arctan2(self.turn[:, 1, 0], self.turn[:, 0, 0]))

    @property
    def speed_mps(self) -> Floats:
        """Along where they look, on the plane that they stand on."""
        return np.asarray(np.einsum("ni,ni->n", self.velocity_mps, self.turn[:, :, 0]))

    @property
    def yaw_rate_radps(self) -> Floats:
        """About the world's z."""
        return np.asarray(np.einsum("ni,ni->n", self.turn[:, 2], self.spin_radps))


class Machine(Protocol):
    """A body that can be built and driven. `motors`: how many wheels it drives. `steering_track_m`: between the wheels
    of a robot of two that turns as this one does."""

    @property
    def mass_kg(self) -> float: ...

    @property
    def motors(self) -> int: ...

    @property
    def flies(self) -> bool: ...

    @property
    def steering_track_m(self) -> float: ...

    @property
    def feet_m(self) -> Floats:
        """(K, 3): with what it stands on level ground, in its own frame."""

    def build(self, spec: Any, body: Any) -> None:
        """Give a body, which is free to move, its mass, shape, wheels and motors."""

    def set_wheels(self, data: Any, places: Places, speed_mps: Floats, yaw_rate_radps: Floats) -> None:
        """Let wheels turn as they do at this speed and yaw rate."""

    def drive(self, data: Any, places: Places, moving: Moving, command: Command, limits: Body, below: Heights) -> None:
        """Set motors and forces for the next moment. The command is of speeds within limits; altitudes count from
        `below`."""
