"""A world as seen from above, as a picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from terrafuse.errors import InputError, MissingExtra
from terrafuse.export.shade import hillshade
from terrafuse.lattice import Lattice
from terrafuse.simulate import truth
from terrafuse.simulate.movers import NO_BODIES
from terrafuse.simulate.world import World
from terrafuse.types import Array, Floats

GROUND, STREET, OTHER, MOVING = (0.74, 0.79, 0.67), (0.88, 0.87, 0.85), (0.42, 0.43, 0.47), (0.10, 0.30, 0.95)
LOW_HOUSE, HIGH_HOUSE, HIGH_M = np.array([0.93, 0.74, 0.52]), np.array([0.60, 0.12, 0.12]), 20.0
"""Colours, red green blue; houses take theirs by their height above the ground, up to HIGH_M."""
STANDS_M = 0.05
MOST_PIXELS = 10**8


def write_world_picture(world: World, path: Path | str, metres_a_pixel: float, time_s: float | None = None) -> None:
    """Write a PNG, north up: ground and streets under a light, houses by height, what else stands in grey; with a time,
    what moves, as it is then, in blue. Raises InputError for more than 10⁸ pixels."""
    try:
        from PIL import Image
    except ImportError as error:
        raise MissingExtra("a picture of a world", "pillow", "plot") from error
    bodies = NO_BODIES if time_s is None else world.bodies(time_s)
    colours = world_colours(world, metres_a_pixel, bodies)
    Image.fromarray(np.round(255 * np.clip(colours[::-1], 0, 1)).astype(np.uint8)).save(path, "PNG")


def world_colours(world: World, metres_a_pixel: float, bodies: Array = NO_BODIES) -> Floats:
    """(H, W, 3) red green blue, about 0 to 1, row 0 in the south."""
    lattice = Lattice(metres_a_pixel, metres_a_pixel)
    window = lattice.cell_window(world.bounds)
    if (window[2] - window[0]) * (window[3] - window[1]) > MOST_PIXELS:
        raise InputError(f"{metres_a_pixel} m a pixel makes a picture of over 10⁸ pixels; give more metres a pixel")
    z, ground = truth.height(world, lattice, window), truth.ground(world, lattice, window)
    above = np.nan_to_num(z - ground)
    share = np.clip(above / HIGH_M, 0, 1)[..., None]
    out = np.broadcast_to(GROUND, (*z.shape, 3)).copy()
    out[truth.streets(world, lattice, window)] = STREET
    out[above > STANDS_M] = OTHER
    out = np.where(
        truth.footprints(world, lattice, window)[..., None], (1 - share) * LOW_HOUSE + share * HIGH_HOUSE, out
    )
    out *= 0.4 + 0.6 * np.nan_to_num(hillshade(z, metres_a_pixel), nan=1.0)[..., None]
    out[truth.height(world, lattice, window, bodies) > z] = MOVING
    return out
