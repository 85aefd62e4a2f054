"""What a mission left, as pictures: the world, each robot's own map, the map of all, and the station's."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import islice
from pathlib import Path

import numpy as np

from terrafuse import views
from terrafuse.export import sheet
from terrafuse.export.looks import look_of
from terrafuse.export.picture import Subject, draw_subject, robot_paths, write_picture
from terrafuse.lattice import Lattice
from terrafuse.models.base import Layer
from terrafuse.prior import ROBOT as PRIOR
from terrafuse.replica import Replica
from terrafuse.simulate.mission.engine import Mission
from terrafuse.simulate.mission.exchange import STATION
from terrafuse.simulate.picture import world_colours
from terrafuse.types import Bounds, Floats

WORLD, MAP, GLOBAL = "world.png", "map.png", "global.png"
MOST_MAPS = 6
"""So many robots' own maps are drawn."""
MOST_PATHS = len(sheet.ROBOTS)
"""So many robots' paths are drawn on one picture: each has its colour."""
TRACK_M = 0.5
"""Between the points of a track."""
ABOUT_WORLD = "streets pale, houses redder the higher, what moves blue, whatever else stands grey"


class Tracks:
    """A watcher: where robots truly were."""

    def __init__(self, mission: Mission) -> None:
        self._tracks: dict[str, list[tuple[float, float]]] = {vehicle.name: [] for vehicle in mission.vehicles}

    def __call__(self, mission: Mission) -> None:
        for vehicle in mission.vehicles:
            x, y = mission.fleet.position_m(vehicle.number)[:2].tolist()
            track = self._tracks[vehicle.name]
            if not track or np.hypot(x - track[-1][0], y - track[-1][1]) >= TRACK_M:
                track.append((x, y))

    @property
    def paths(self) -> dict[str, Floats]:
        """(N, 2) east and north of each robot."""
        return {name: np.array(track, np.float64).reshape(-1, 2) for name, track in self._tracks.items()}


def write_pictures(mission: Mission, tracks: Mapping[str, Floats], out: Path) -> dict[str, str]:
    """Write them all into the folder; returns the files' names by what they show. A map without a cell has none.

    The world shows robots' true `tracks`; their maps, the paths that they believed in. Raises OutputError.
    """
    return dict(_written(mission, tracks, out))


def _written(mission: Mission, tracks: Mapping[str, Floats], out: Path) -> Iterator[tuple[str, str]]:
    title = mission.scenario.title or mission.loaded.name
    draw_subject(
        out / WORLD, lambda: _world(mission), _some(tracks), f"{title}: the world", {STATION: mission.station_m}
    )
    yield "world", WORLD
    seen = Replica(store=mission.store, without=[PRIOR])
    window = views.known_window(seen)
    if window is None:
        return
    bounds, held = views.bounds_of(seen, window), robot_paths(seen)
    paths = {vehicle.name: held[vehicle.name] for vehicle in mission.vehicles if vehicle.name in held}
    fused = Replica(store=mission.store)
    guessed = mission.prior is not None
    whole = "robots' maps over the prior" if guessed else "the robots' maps, fused"
    write_picture(fused, out / MAP, None, bounds, _some(paths), f"{title}: {whole}")
    yield "map", MAP
    for name in islice(paths, MOST_MAPS):
        own = Replica(store=mission.store, only=[name])
        write_picture(own, out / f"{name}.png", None, bounds, {name: paths[name]}, f"{title}: {name}'s own map")
        yield f"map of {name}", f"{name}.png"
    station = mission.station.replica
    if views.known_window(station) is not None:
        whole = "the station's map over the prior" if guessed else "the global map at the station"
        write_picture(station, out / GLOBAL, title=f"{title}: {whole}")
        yield "global", GLOBAL


def _some(paths: Mapping[str, Floats]) -> dict[str, Floats]:
    return dict(islice(paths.items(), MOST_PATHS))


def _world(mission: Mission) -> Subject:
    """As it is at the end."""
    step_m = pixel_m(mission.world.bounds)
    lattice = Lattice(step_m, step_m, mission.world.crs)
    colours = world_colours(mission.world, step_m, mission.world.bodies(mission.now_s)).clip(0, 1)
    i0, j0, _, _ = lattice.cell_window(mission.world.bounds)
    layer = Layer("truth", "1", ABOUT_WORLD, lambda cells, reading: np.zeros(cells.shape))
    return Subject(layer, lattice, 1, colours[..., 0], i0 * step_m, j0 * step_m, look_of(layer), colours)


def pixel_m(bounds: Bounds) -> float:
    """The least of 1, 2, 5 times a power of ten that lets bounds fit a picture."""
    side = max(bounds.east - bounds.west, bounds.north - bounds.south)
    steps = (digit * 10.0**power for power in range(-3, 7) for digit in (1, 2, 5))
    return next(step for step in steps if side <= step * sheet.MOST_PIXELS)
