"""The mission: what is there, and one tick after the other. The loop reads like the plan of a field day."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from terrafuse.errors import InputError
from terrafuse.exchange.coarse import CoarseContribution, delta_since
from terrafuse.exchange.delta import Delta
from terrafuse.lattice import Lattice, default_tile_m
from terrafuse.logs.recorder import McapRecorder
from terrafuse.mapper import Mapper
from terrafuse.models import make_model
from terrafuse.navigate.allotment import nearest_takes, patrol
from terrafuse.sense import Sensor
from terrafuse.simulate.mission.behaviours import Behaviour
from terrafuse.simulate.mission.behaviours.patrol import ROUTE, Patrol
from terrafuse.simulate.mission.exchange import ANTENNA_M, STATION, Node, Station, radio_of
from terrafuse.simulate.mission.fleet import Fleet
from terrafuse.simulate.mission.localiser import LOCALISERS
from terrafuse.simulate.mission.ownmap import OwnMap
from terrafuse.simulate.mission.parts import behaviour_of, check_parts, sensor_of
from terrafuse.simulate.mission.prior import FILE as PRIOR_FILE
from terrafuse.simulate.mission.prior import coarse_prior, prior_store, write_buildings
from terrafuse.simulate.mission.reachable import Reach, first_unreachable
from terrafuse.simulate.mission.senses import Around, Sense
from terrafuse.simulate.mission.situation import Situation
from terrafuse.simulate.mission.starts import LANE, names_of, starts_of, station_place
from terrafuse.simulate.mission.surface import Surface
from terrafuse.simulate.mission.vehicle import Vehicle
from terrafuse.simulate.motion import Rotors
from terrafuse.simulate.movers import bodies
from terrafuse.simulate.rays import RayCaster
from terrafuse.simulate.scenario import Loaded
from terrafuse.simulate.scenario.model import RobotsPart, SensorPart
from terrafuse.store.base import Store
from terrafuse.store.memory import MemoryStore
from terrafuse.types import Stamp
from terrafuse.window import make_window

START_NS: Stamp = 1_767_225_600 * 10**9
"""2026-01-01 UTC: when simulated time is 0."""
SIGHT_M = 55.0
"""How far down a side street a patrol sees in passing."""

Watcher = Callable[["Mission"], None]
"""Called after each tick."""


class Mission:
    """A scenario, set up; `run` lets it happen. What it holds afterwards is what came of it."""

    def __init__(
        self, loaded: Loaded, store: Store | None = None, folder: Path | None = None, record: bool = False
    ) -> None:
        """`store` takes the robots' fine maps (in memory without one); `folder` the prior's file and, to `record`,
        a log for each robot. Raises InputError that names the scenario's line."""
        check_parts(loaded)
        self.loaded, self.scenario, self.world = loaded, loaded.scenario, loaded.world
        self.now_s = 0.0
        self._tick = 0
        self._files = ExitStack()
        self.lattice = lattice_of(loaded)
        self.model = model_of(loaded)
        self.store = store or MemoryStore(self.lattice, self.model)
        self.prior, coarse = self._known_before(folder)
        self.caster = RayCaster(self.world)
        surface = Surface(self.world, self.caster)
        self.station_m = station_place(loaded, self.world)
        starts = starts_of(loaded, self.world, surface, self.station_m)
        self.fleet = Fleet(starts, surface, self.world)
        self.radio = radio_of(self.scenario.radio, self.world, self.caster, self.scenario.seed)
        z = float(self.world.terrain.height(*self.station_m)) + self.scenario.station.height_m
        self.station = Station(
            self.radio.link(STATION, (*self.station_m, z)), self.coarse_lattice, self.model,
            self.scenario.radio, coarse,
        )  # fmt: skip
        self.vehicles = [
            self._vehicle(number, name, part, coarse, folder if record else None)
            for number, (name, part) in enumerate(names_of(loaded))
        ]
        self._check_waypoints()
        self._allot()
        self._warm_up()

    @property
    def coarse_lattice(self) -> Lattice:
        return self.lattice.coarser(self.scenario.map.global_factor)

    @property
    def stamp_ns(self) -> Stamp:
        return START_NS + self._tick * round(self.scenario.tick_s * 1e9)

    def run(self, watchers: Sequence[Watcher] = (), threads: int = 1) -> None:
        """To the end of the scenario's duration, or until a watcher calls `stop`. `threads` cast rays; the rest is
        Python's, which one thread at a time can run. The same whatever the threads."""
        for _ in self.steps(threads):
            for watch in watchers:
                watch(self)

    def steps(self, threads: int = 1) -> Iterator[None]:
        """The same, tick by tick, as they are asked for."""
        self._stopped = False
        ticks = round(self.scenario.duration_s / self.scenario.tick_s)
        with self._files, self.caster.threads(threads):
            while self._tick < ticks and not self._stopped:
                self._step()
                yield
        for vehicle in self.vehicles:
            vehicle.mapper.commit()

    def stop(self) -> None:
        self._stopped = True

    def _step(self) -> None:
        """Sense and map; exchange; decide; move."""
        stamp_ns = self.stamp_ns
        moving = self.world.bodies(self.now_s)
        self._sense(stamp_ns, moving)
        for vehicle in self.vehicles:
            east, north, up = self.fleet.position_m(vehicle.number).tolist()
            self.radio.move(vehicle.name, (east, north, up + ANTENNA_M), stamp_ns)
        for vehicle in self.vehicles:
            vehicle.exchange(stamp_ns)
        self.station.tick(stamp_ns)
        drives = {vehicle.number: vehicle.decide(self.now_s) for vehicle in self.vehicles}
        self.fleet.step(drives, self.scenario.tick_s, moving)
        self._tick += 1
        self.now_s = self._tick * self.scenario.tick_s

    def _sense(self, stamp_ns: Stamp, moving: Any) -> None:
        seen = self.fleet.bodies()
        pings = {v.number: v.pings(self.fleet.pose(v.number), stamp_ns) for v in self.vehicles}
        for vehicle in self.vehicles:
            others = [body for number, body in enumerate(seen) if number != vehicle.number]
            heard = [ping for number, several in pings.items() if number != vehicle.number for ping in several]
            own = next(iter(pings[vehicle.number]), None)
            vehicle.sense(self.fleet, Around(self.caster, stamp_ns, bodies([moving, *others]), heard), stamp_ns, own)

    def _check_waypoints(self) -> None:
        """Raise InputError, with its line, for the first waypoint that no way leads to on the ground."""
        reaches: dict[float, Reach] = {}
        for vehicle, (_, part) in zip(self.vehicles, names_of(self.loaded), strict=True):
            behaviour, kind = vehicle.behaviour, self.fleet.kind(vehicle.number)
            if not isinstance(behaviour, Patrol) or isinstance(kind.carriage, Rotors):
                continue
            goals = behaviour.settings.waypoints_m
            if goals and kind.radius_m not in reaches:
                reaches[kind.radius_m] = Reach(self.world, kind.radius_m)
            east, north, _ = self.fleet.position_m(vehicle.number).tolist()
            wrong = first_unreachable(reaches[kind.radius_m], (east, north), goals) if goals else None
            if wrong is not None:
                place = ("robots", self.scenario.robots.index(part), "behaviour", "waypoints_m", wrong[0])
                raise self.loaded.error(place, f"waypoint {goals[wrong[0]]} of {vehicle.name} {wrong[1]}; move it")

    def _warm_up(self) -> None:
        """Map a made-up scan on the side: kernels are compiled with their first use, which is no robot's time."""
        mapper = Mapper("nobody", self.lattice, self.model)
        contribution = CoarseContribution(mapper, self.scenario.map.global_factor)
        firsts = {
            part.name: vehicle
            for vehicle, (_, part) in reversed([*zip(self.vehicles, names_of(self.loaded), strict=True)])
        }
        for index, part in enumerate(self.scenario.robots):
            for k, sense in enumerate(firsts[part.name].senses):
                sensor, where = sense.sensor, self.fleet.pose(sense.number)
                beams = len(sensor.beams.angles()[0]) if sensor.beams else 0
                for _ in range(2):
                    with self.loaded.at("robots", index, "sensors", k):
                        mapper.integrate(sense.scan(np.full(beams, sensor.max_range_m / 2), self.stamp_ns, where))
                    contribution.update()

    def _known_before(self, folder: Path | None) -> tuple[MemoryStore | None, Delta | None]:
        """The prior on the robots' lattice, and coarsened."""
        height_m = self.scenario.map.prior_building_height_m
        if height_m is None:
            return None, None
        if folder is None:
            raise InputError("a mission with a prior map needs a folder for its file")
        if not self.world.houses:
            raise self.loaded.error(
                ("map", "prior_building_height_m"), "this world has no buildings; leave it out, or take a village"
            )
        path = folder / PRIOR_FILE
        write_buildings(self.world, height_m, path)
        try:
            fine = prior_store(path, self.lattice, self.model)
        except InputError as error:
            raise self.loaded.error(
                ("map", "prior_building_height_m"),
                f"{str(error).partition(': ')[2]}; leave it out, or take finer cells",
            ) from error
        for delta in prior_deltas(fine):
            self.store.accept(delta)
        return fine, coarse_prior(fine, self.scenario.map.global_factor)

    def _vehicle(self, number: int, name: str, part: RobotsPart, coarse: Delta | None, logs: Path | None) -> Vehicle:
        position, (_, _, yaw) = self.fleet.position_m(number), self.fleet.angles_rad(number)
        index = self.scenario.robots.index(part)
        senses = [self._sense_of(number, index, k, one) for k, one in enumerate(part.sensors)]
        window = make_window(self.scenario.map.window, self.lattice)
        mapper = Mapper(name, self.lattice, self.model, window, self.store)
        link = self.radio.link(name, (*position[:2].tolist(), float(position[2]) + ANTENNA_M))
        node = Node(link, mapper, self.scenario.map.global_factor, self.scenario.radio, coarse)
        situation = Situation(name, self.fleet.kind(number), own_map=OwnMap(mapper, self.prior, node.replica))
        localiser = LOCALISERS[part.pose.kind](
            part.pose, self.world.gps_quality.at, position, yaw, [self.scenario.seed, number, 1]
        )
        recorder = None if logs is None else self._recorder(logs / f"{name}.mcap", senses[0].sensor)
        return Vehicle(
            name, number, senses, localiser, mapper, node, self._behaviour(index, number), situation,
            part.altitude_m, recorder,
        )  # fmt: skip

    def _recorder(self, path: Path, sensor: Sensor) -> McapRecorder:
        recorder = self._files.enter_context(McapRecorder(path))
        recorder.static(sensor.mounting.T_base_sensor)
        return recorder

    def _sense_of(self, number: int, index: int, k: int, part: SensorPart) -> Sense:
        return Sense(
            part, sensor_of(self.loaded, index, k), number, np.random.default_rng([self.scenario.seed, number, 2, k])
        )

    def _behaviour(self, index: int, number: int) -> Behaviour:
        settings, makes = behaviour_of(self.loaded, index)
        return makes(settings, np.random.default_rng([self.scenario.seed, number, 3]))

    def _allot(self) -> None:
        """The station's first act: routes along the streets for all who patrol and have none."""
        waiting = [v for v in self.vehicles if isinstance(v.behaviour, Patrol) and not v.behaviour.settings.waypoints_m]
        if not waiting:
            return
        streets = self.world.streets
        if not len(streets.nodes_m):
            raise self.loaded.error(
                ("robots",), "a patrol needs streets, or waypoints_m of its own; this world has none"
            )
        places_m = np.array([self.fleet.position_m(v.number)[:2] for v in waiting])
        near = [int(np.hypot(*(streets.nodes_m - place_m).T).argmin()) for place_m in places_m]
        routes = patrol(streets.nodes_m, streets.edges, near, SIGHT_M, LANE * streets.width_m)
        for vehicle, route in zip(waiting, nearest_takes(routes, near, places_m), strict=True):
            self.station.order(vehicle.name, ROUTE, route.round(3).tolist())


def lattice_of(loaded: Loaded) -> Lattice:
    """Of the robots' maps. Raises InputError with the line."""
    part = loaded.scenario.map
    try:
        lattice = Lattice(part.resolution_m, part.tile_m or default_tile_m(part.resolution_m), loaded.world.crs)
    except InputError as error:
        raise loaded.error(("map", "resolution_m"), str(error)) from error
    try:
        lattice.coarser(part.global_factor)
    except InputError as error:
        raise loaded.error(("map", "global_factor"), str(error)) from error
    try:
        make_window(part.window, lattice)
    except InputError as error:
        raise loaded.error(("map", "window"), str(error)) from error
    return lattice


def model_of(loaded: Loaded) -> Any:
    """Likewise, their cell model."""
    part = loaded.scenario.map
    try:
        return make_model(part.model, part.settings)
    except InputError as error:
        raise loaded.error(("map", "model"), str(error)) from error


def prior_deltas(store: MemoryStore) -> list[Delta]:
    """A memory store's contributions, as deltas for another."""
    return [delta_since(store, robot) for robot in store.robots()]
