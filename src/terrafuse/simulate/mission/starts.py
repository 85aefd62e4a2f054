"""Where robots begin, and where the station stands."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from terrafuse.errors import InputError
from terrafuse.simulate.mission.fleet import Start
from terrafuse.simulate.mission.surface import Surface
from terrafuse.simulate.motion import BODIES, Rotors, placed
from terrafuse.simulate.movers import bodies
from terrafuse.simulate.scenario import Loaded
from terrafuse.simulate.scenario.model import RobotsPart
from terrafuse.simulate.streets import Streets
from terrafuse.simulate.world import World
from terrafuse.types import Floats

ALONG_M = 2.5
"""Between places along a street."""
APART_M = 6.0
"""Robots that start on the streets have so much room: in a crowd they wait for each other."""
LANE = 0.25
"""Of a street's width, to the right of its middle."""


def station_place(loaded: Loaded, world: World) -> tuple[float, float]:
    """As the scenario says, or the street corner nearest to the world's middle. Raises InputError."""
    given = loaded.scenario.station.place
    if given is not None:
        if not math.isfinite(float(world.terrain.height(*given))):
            raise loaded.error(("station", "place"), f"station at {given}: lies off the world; choose a place in it")
        return given
    west, south, east, north = world.bounds
    middle = np.array([(west + east) / 2, (south + north) / 2])
    nodes = world.streets.nodes_m
    place = middle if not len(nodes) else nodes[int(np.hypot(*(nodes - middle).T).argmin())]
    return float(place[0]), float(place[1])


def names_of(loaded: Loaded) -> list[tuple[str, RobotsPart]]:
    """Each robot's name and kind, in order. Raises InputError for a name that comes twice."""
    out: list[tuple[str, RobotsPart]] = []
    for index, part in enumerate(loaded.scenario.robots):
        for number in range(1, part.count + 1):
            name = f"{part.name}{number}"
            if name in {known for known, _ in out}:
                raise loaded.error(("robots", index), f"two robots are called {name}; give each kind a name of its own")
            out.append((name, part))
    return out


def starts_of(loaded: Loaded, world: World, surface: Surface, station: tuple[float, float]) -> list[Start]:
    """A free place for each robot: its own, or one on the streets, the nearest to the station first.

    Raises InputError, with the line, where something stands in the place that the scenario gives.
    """
    taken: list[Start] = []
    for index, part in enumerate(loaded.scenario.robots):
        if part.body not in BODIES:
            raise loaded.error(("robots", index, "body"), f"body '{part.body}'; there are {', '.join(BODIES)}")
        for number in range(part.count):
            taken.append(_start(loaded, world, surface, station, index, number, taken))
    return taken


def _start(
    loaded: Loaded, world: World, surface: Surface, station: tuple[float, float], index: int, number: int,
    taken: list[Start],
) -> Start:  # fmt: skip
    part = loaded.scenario.robots[index]
    if number < len(part.places):
        x, y, yaw_deg = part.places[number]
        start = Start(part.body, x, y, math.radians(yaw_deg), part.motion)
        if (why := _in_the_way(start, surface, taken)) is not None:
            raise loaded.error(
                ("robots", index, "places", number), f"{part.name}{number + 1} at {x:g},{y:g}: {why}; choose a free one"
            )
        return start
    for x, y, yaw in _along(world.streets, station, part.spread):
        start = Start(part.body, x, y, yaw, part.motion)
        if not world.communications.at(x, y):
            continue  # it would never hear of its route
        crowded = any(math.hypot(x - other.x_m, y - other.y_m) < APART_M for other in taken)
        if not crowded and _in_the_way(start, surface, taken) is None:
            return start
    raise loaded.error(
        ("robots", index), f"no free place on the streets for {part.name}{number + 1}; give 'places', one a robot"
    )


def _in_the_way(start: Start, surface: Surface, taken: list[Start]) -> str | None:
    kind = BODIES[start.body]
    flies = isinstance(kind.carriage, Rotors)
    ground = surface.for_wings() if flies else surface.for_wheels([bodies([])])
    try:
        placed(ground, kind, [[start.x_m, start.y_m]], [start.yaw_rad])
    except InputError:
        return "something stands in its place, or it lies off the world"
    for other in taken:
        if math.hypot(start.x_m - other.x_m, start.y_m - other.y_m) < kind.radius_m + BODIES[other.body].radius_m:
            return "another robot starts there"
    return None


def _along(streets: Streets, station: tuple[float, float], spread: bool) -> Iterator[tuple[float, float, float]]:
    """(x, y, yaw) on the right side of the streets, each way, nearest to the station first; or, spread, in an order
    that leaves none of the streets out."""
    places = _lanes(streets)
    if not len(places):
        return
    order = np.argsort(np.hypot(*(places[:, :2] - station).T), kind="stable")
    if spread:
        order = np.random.default_rng(0).permutation(len(places))
    yield from map(tuple, places[order].tolist())


def _lanes(streets: Streets) -> Floats:
    rows = []
    for x0, y0, x1, y1 in streets.segments_m.tolist():
        length = math.hypot(x1 - x0, y1 - y0)
        yaw = math.atan2(y1 - y0, x1 - x0)
        aside = LANE * streets.width_m
        for along in np.arange(ALONG_M, length - ALONG_M, ALONG_M).tolist():
            x, y = x0 + along * math.cos(yaw), y0 + along * math.sin(yaw)
            rows.append((x + aside * math.sin(yaw), y - aside * math.cos(yaw), yaw))
            rows.append((x - aside * math.sin(yaw), y + aside * math.cos(yaw), yaw + math.pi))
    return np.array(rows).reshape(-1, 3)
