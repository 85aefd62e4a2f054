"""Where robots begin, and where the station stands."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import numpy as np

from terrafuse.errors import InputError
from terrafuse.simulate.mission.behaviours.soccer import SoccerSettings
from terrafuse.simulate.mission.fleet import Start
from terrafuse.simulate.mission.parts import behaviour_of
from terrafuse.simulate.mission.reachable import Reach
from terrafuse.simulate.mission.surface import Surface
from terrafuse.simulate.motion import BODIES, Rotors, placed
from terrafuse.simulate.movers import bodies
from terrafuse.simulate.scenario import Loaded
from terrafuse.simulate.scenario.model import RobotsPart
from terrafuse.simulate.streets import Streets
from terrafuse.simulate.world import World
from terrafuse.types import Array, Floats

ALONG_M = 2.5
"""Between places along a street."""
APART_M = 6.0
"""Robots that start on the streets have so much room: in a crowd they wait for each other."""
FREE_APART_M = 0.5
"""Between robots on other free ground: rooms are small."""
START_CELLS = 2**20
"""Free ground is looked for in so many cells at most."""
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
    """A free place for each robot: its own; or one on the streets, the nearest to the station first; or, where these
    have no more, or the world has none, on free ground.

    Raises InputError, with the line, where something stands in the place that the scenario gives.
    """
    taken: list[Start] = []
    for index, part in enumerate(loaded.scenario.robots):
        if part.body not in BODIES:
            raise loaded.error(("robots", index, "body"), f"body '{part.body}'; there are {', '.join(BODIES)}")
        if part.altitude_m and not isinstance(BODIES[part.body].carriage, Rotors):
            flying = ", ".join(name for name, body in BODIES.items() if isinstance(body.carriage, Rotors))
            raise loaded.error(
                ("robots", index, "altitude_m"), f"a {part.body} does not fly; leave it out, or take a {flying}"
            )
        for number in range(len(part.places)):
            taken.append(_given(loaded, surface, index, number, taken))
        others = _others(loaded, world, surface, station, index, taken)
        for number in range(len(part.places), part.count):
            if (start := next(others, None)) is None:
                raise loaded.error(
                    ("robots", index), f"no free place for {part.name}{number + 1}; take fewer robots, or give 'places'"
                )
            taken.append(start)
    return taken


def _given(loaded: Loaded, surface: Surface, index: int, number: int, taken: list[Start]) -> Start:
    """At the place that the scenario gives."""
    part = loaded.scenario.robots[index]
    x, y, yaw_deg = part.places[number]
    start = Start(part.body, x, y, math.radians(yaw_deg), part.motion)
    if (why := _in_the_way(start, surface, taken)) is not None:
        raise loaded.error(
            ("robots", index, "places", number), f"{part.name}{number + 1} at {x:g},{y:g}: {why}; choose a free one"
        )
    return start


def _others(
    loaded: Loaded, world: World, surface: Surface, station: tuple[float, float], index: int, taken: list[Start]
) -> Iterator[Start]:
    """Free places as `taken` grows: those on the streets, then those on free ground."""
    part = loaded.scenario.robots[index]

    def free(places: Iterable[tuple[float, float, float]], apart_m: float) -> Iterator[Start]:
        for x, y, yaw in places:
            start = Start(part.body, x, y, yaw, part.motion)
            crowded = any(math.hypot(x - other.x_m, y - other.y_m) < apart_m for other in taken)
            # Where there is no signal it would never hear of its route.
            if not crowded and world.communications.at(x, y) and _in_the_way(start, surface, taken) is None:
                yield start

    yield from free(_along(world.streets, station, part.spread), APART_M)
    radius_m = BODIES[part.body].radius_m
    yield from free(_on_free_ground(loaded, world, station, index, taken), 2 * radius_m + FREE_APART_M)


def _on_free_ground(
    loaded: Loaded, world: World, station: tuple[float, float], index: int, taken: list[Start]
) -> Iterator[tuple[float, float, float]]:
    """(x, y, yaw): what hangs together with where the first robot is, or the largest such part of the world; players
    begin in their own half, and look at the other."""
    part = loaded.scenario.robots[index]
    first = (taken[0].x_m, taken[0].y_m) if taken else None
    places = Reach(world, BODIES[part.body].radius_m, START_CELLS).free_places(first)
    yaw_rad = 0.0
    settings = behaviour_of(loaded, index)[0]
    if isinstance(settings, SoccerSettings):
        sign = 1.0 if settings.defends == "south" else -1.0
        (x, y), (east_m, north_m) = places.T, settings.field_m
        inside = (x > 0) & (x < east_m) & (y > 0) & (y < north_m) & (sign * (north_m / 2 - y) > 0)
        places, yaw_rad = places[inside], sign * math.pi / 2
    for x, y in places[_order(places, station, part.spread)].tolist():
        yield x, y, yaw_rad


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
    yield from map(tuple, places[_order(places[:, :2], station, spread)].tolist())


def _order(places_m: Floats, station: tuple[float, float], spread: bool) -> Array:
    if spread:
        return np.random.default_rng(0).permutation(len(places_m))
    return np.argsort(np.hypot(*(places_m - station).T), kind="stable")


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
