"""Places to simulate."""

from __future__ import annotations

from collections.abc import Callable

from terrafuse.simulate.world import World
from terrafuse.simulate.worlds.city import city
from terrafuse.simulate.worlds.hallway import hallway
from terrafuse.simulate.worlds.imported import dem_world, image_world, ros_map_world
from terrafuse.simulate.worlds.parking import parking
from terrafuse.simulate.worlds.soccer import soccer_field
from terrafuse.simulate.worlds.village import village

WORLDS: dict[str, Callable[..., World]] = {
    "village": village,
    "city": city,
    "parking": parking,
    "hallway": hallway,
    "soccer_field": soccer_field,
    "dem": dem_world,
    "ros_map": ros_map_world,
    "image": image_world,
}
"""Generators by name; what each takes, and within which limits, is in the annotations of its own arguments."""

__all__ = [
    "WORLDS", "city", "dem_world", "hallway", "image_world", "parking", "ros_map_world", "soccer_field", "village",
]  # fmt: skip
