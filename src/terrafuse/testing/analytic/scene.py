"""A small world whose truth is known in closed form, and a lidar in it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np

from terrafuse.lattice import Lattice
from terrafuse.testing.analytic.boxes import Box, Car, Pit, spans
from terrafuse.testing.analytic.ground import Ground, ground_ranges
from terrafuse.types import Array, Floats, Pose
from terrafuse.views import CellWindow


@dataclass(frozen=True)
class Scene:
    """Ground, what stands on it for good, and what moves."""

    ground: Ground = field(default_factory=Ground)
    boxes: tuple[Box, ...] = ()
    cars: tuple[Car, ...] = ()
    pits: tuple[Pit, ...] = ()


@dataclass(frozen=True)
class Lidar:
    """A spinning lidar: `columns` firings a turn, in each `beams` beams evenly spaced in elevation.

    Its frame has x ahead, y left, z up. `order`: "firing" has a firing's beams together, lowest first; "ring" a beam's
    whole turn together.
    """

    beams: int = 32
    columns: int = 900
    lowest_deg: float = -25.0
    highest_deg: float = 15.0
    min_range_m: float = 1.0
    max_range_m: float = 100.0
    noise_m: float = 0.02
    """Standard deviation of the range."""
    order: Literal["firing", "ring"] = "firing"

    @cached_property
    def directions(self) -> Floats:
        """(beams·columns, 3) unit vectors in the sensor's frame."""
        elevation = np.radians(np.linspace(self.lowest_deg, self.highest_deg, self.beams))
        azimuth = np.arange(self.columns) * (2 * math.pi / self.columns)
        grid = np.stack(
            [
                np.outer(np.cos(azimuth), np.cos(elevation)),
                np.outer(np.sin(azimuth), np.cos(elevation)),
                np.outer(np.ones(self.columns), np.sin(elevation)),
            ],
            axis=-1,
        )
        return (grid if self.order == "firing" else grid.swapaxes(0, 1)).reshape(-1, 3)


def scan(scene: Scene, lidar: Lidar, T_world_sensor: Pose, time_s: float, rng: np.random.Generator) -> Array:
    """What the lidar sees at an instant: (N, 3) float32 points in its own frame, NaN rows where nothing returns.

    N and the rows' order are always the lidar's. Noise is along the ray.
    """
    rotation, origin = T_world_sensor.matrix[:3, :3], T_world_sensor.position
    ranges = first_returns(scene, origin, lidar.directions @ rotation.T, lidar.max_range_m, time_s)
    ranges[(ranges < lidar.min_range_m) | (ranges > lidar.max_range_m)] = np.nan
    ranges += lidar.noise_m * rng.standard_normal(len(ranges))
    return (lidar.directions * ranges[:, None]).astype(np.float32)


def first_returns(scene: Scene, origin: Floats, directions: Floats, reach_m: float, time_s: float) -> Floats:
    """Range of the first surface on each ray, (N,), inf where there is none; arguments as of `ground_ranges`."""
    still = at_time(scene, time_s)
    ranges = ground_ranges(still.ground, origin, directions, reach_m)
    for pit in still.pits:
        ranges = _into(pit, origin, directions, ranges)
    for box in still.boxes:
        enter, leave = spans(box, origin, directions)
        ranges = np.where((enter > 0) & (enter <= leave), np.minimum(ranges, enter), ranges)
    return np.where(ranges <= reach_m, ranges, np.inf)


def _into(pit: Pit, origin: Floats, directions: Floats, ranges: Floats) -> Floats:
    """Rays that meet the ground over the hole go on to its floor or wall: where they leave the hole's column."""
    over = np.flatnonzero(np.isfinite(ranges))
    at = origin + directions[over] * ranges[over, None]
    over = over[pit.floor.covers(at[:, 0], at[:, 1])]
    column = replace(pit.floor, bottom_m=pit.floor.top_m, top_m=np.inf)
    out = ranges.copy()
    out[over] = spans(column, origin, directions[over])[1]
    return out


def at_time(scene: Scene, time_s: float | None) -> Scene:
    """The scene as it stands at a time: cars are boxes, pits are the open ones. None leaves out all that moves."""
    if time_s is None:
        return Scene(scene.ground, scene.boxes)
    cars = [box for car in scene.cars if (box := car_box(scene.ground, car, time_s))]
    pits = [pit for pit in scene.pits if pit.opens_s <= time_s < pit.closes_s]
    return Scene(scene.ground, (*scene.boxes, *cars), pits=tuple(pits))


def car_box(ground: Ground, car: Car, time_s: float) -> Box | None:
    """The car at this time, upright on the ground under its middle; None where it is not there."""
    place = car.place(time_s)
    if place is None:
        return None
    x, y, yaw = place
    box = box_on(ground, x, y, car.length_m, car.width_m, car.height_m, yaw)
    return replace(box, bottom_m=box.top_m - car.height_m + car.clearance_m) if car.clearance_m else box


def box_on(
    ground: Ground, x_m: float, y_m: float, length_m: float, width_m: float, height_m: float, yaw_rad: float = 0.0
) -> Box:
    """A box whose flat top is `height_m` above the ground at its centre."""
    return Box(x_m, y_m, length_m, width_m, float(ground.height(x_m, y_m)) + height_m, yaw_rad)


def truth(scene: Scene, lattice: Lattice, window: CellWindow, time_s: float | None = None) -> Floats:
    """Height of what is seen from above at the cells' centres, (H, W) [j, i], metres: the ground and the boxes' tops.

    With a time, of the cars and the pits too, as they are then.
    """
    still = at_time(scene, time_s)
    x, y = _centres(lattice, window)
    z = still.ground.height(x, y)
    for pit in still.pits:
        z = np.where(pit.floor.covers(x, y), pit.floor.top_m, z)
    for box in still.boxes:
        z = np.where(box.covers(x, y), np.maximum(z, box.top_m), z)
    return z


def covered(
    scene: Scene, lattice: Lattice, window: CellWindow, grown_m: float = 0.0, time_s: float | None = None
) -> Array:
    """Which cells' centres lie in a footprint grown by this much (shrunk, below 0), (H, W) booleans.

    A cell whose centre is further than half its diagonal from a wall is wholly on one side of it, so cells that are
    covered when grown by that and not when shrunk by it are the ones on walls.
    """
    still = at_time(scene, time_s)
    x, y = _centres(lattice, window)
    out = np.zeros(np.broadcast(x, y).shape, bool)
    for box in (*still.boxes, *(pit.floor for pit in still.pits)):
        out |= box.covers(x, y, grown_m)
    return out


def _centres(lattice: Lattice, window: CellWindow) -> tuple[Floats, Floats]:
    """x (1, W) and y (H, 1) of the cells' centres."""
    i0, j0, i1, j1 = window
    return lattice.cell_centre(np.arange(i0, i1))[None, :], lattice.cell_centre(np.arange(j0, j1))[:, None]
