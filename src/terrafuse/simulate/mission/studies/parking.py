"""What the car park shows: what moves leaves no ghosts, and a map that drifted is put right by mapping again."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from terrafuse.mapper import Mapper
from terrafuse.models import make_model
from terrafuse.replica import Replica
from terrafuse.simulate import truth
from terrafuse.simulate.mission.engine import START_NS, Mission
from terrafuse.simulate.mission.localiser import LOCALISERS, Localiser
from terrafuse.simulate.mission.measures import GHOST_M, Truth, beyond, error_facts, ghosts, height_errors
from terrafuse.simulate.mission.ownmap import live
from terrafuse.simulate.mission.starts import names_of
from terrafuse.simulate.mission.tables import Cell, Table
from terrafuse.simulate.mission.vehicle import Vehicle
from terrafuse.simulate.movers import bodies
from terrafuse.store.memory import MemoryStore
from terrafuse.types import Array, Floats, Pose, Scan, pose_of
from terrafuse.views import mosaic

CLOSED = "-closed"
"""After a robot's name: the contribution that takes the place of its drifted one."""


@dataclass(frozen=True, eq=False)
class Standing(Truth):
    """The truth with bodies that stand in it."""

    bodies: Array

    @cached_property
    def height(self) -> Floats:
        return truth.height(self.world, self.lattice, self.window, self.bodies)


def at_end(mission: Mission) -> Standing:
    """Of all of a mission's world, as it is when the mission has ended."""
    world, lattice = mission.world, mission.lattice
    return Standing(world, lattice, lattice.cell_window(world.bounds), _standing(mission))


def _standing(mission: Mission) -> Array:
    """What moves, and the robots that do not fly."""
    robots = mission.fleet.bodies()
    return bodies([mission.world.bodies(mission.now_s), *(robots[v.number] for v in on_ground(mission))])


def on_ground(mission: Mission) -> list[Vehicle]:
    return [vehicle for vehicle in mission.vehicles if not vehicle.altitude_m]


# --- ghosts ----------------------------------------------------------------------------------------------------------


class Ghosts:
    """Beside each robot's mapper another without the dynamic rule, which takes the same scans."""

    def __init__(self, mission: Mission) -> None:
        settings = mission.scenario.map.settings | {"static": True}
        model = make_model(mission.scenario.map.model, settings)
        self._mission = mission
        self._static = [Mapper(vehicle.name, mission.lattice, model) for vehicle in mission.vehicles]
        for vehicle, mapper in zip(mission.vehicles, self._static, strict=True):
            vehicle.on_scan.append(mapper.integrate)

    def counts(self) -> dict[str, tuple[int, int, int]]:
        """Of the robots' maps and of all in one: ghost cells without the dynamic rule, with it, and how many of these
        nothing looked at since what was there left."""
        known = at_end(self._mission)
        own = [vehicle.mapper for vehicle in self._mission.vehicles]
        each = {mapper.robot: ([static], [mapper]) for static, mapper in zip(self._static, own, strict=True)}
        maps = each | {"all": (self._static, own)}
        return {
            name: (
                _ghost_cells(live(without), known),
                _ghost_cells(live(with_rule), known),
                _stale(self._mission, live(with_rule), known),
            )
            for name, (without, with_rule) in maps.items()
        }

    def table(self) -> Table:
        return Table(
            "Ghosts of what moved, in cells of the map",
            (
                "map of", "without the dynamic rule", "with it", "times fewer", "never seen again", "others, without",
                "others, with it", "times fewer of these",
            ),
            tuple(
                (name, without, with_rule, _ratio(without, with_rule), stale, without - stale, with_rule - stale,
                 _ratio(without - stale, with_rule - stale))
                for name, (without, with_rule, stale) in self.counts().items()
            ),
            "Cells that are higher in the map by 0.5 m than anything that stands, at the end, within a cell of them; "
            "from the same scans. Never seen again: true when they were last seen, and no beam came back to see that "
            "something had left, which no rule can know.",
        )  # fmt: skip


def _ratio(more: int, fewer: int) -> float | None:
    return more / fewer if fewer else None


def _ghost_cells(replica: Replica, known: Truth) -> int:
    return int(ghosts(height_errors(replica, known), known.height).sum())


def _stale(mission: Mission, replica: Replica, known: Truth) -> int:
    """Ghosts at whose place, when it was last seen, something moved that was as high."""
    errors = height_errors(replica, known)
    stamps = mosaic(replica, [replica.model.layers["stamp"]], known.window)["stamp"]
    bare = replace(mission.world, houses=(), walls=(), furniture=())
    i0, j0 = known.window[:2]
    out = 0
    for j, i in np.argwhere(ghosts(errors, known.height)).tolist():
        moving = bare.bodies(float(stamps[j, i]) - START_NS * 1e-9)
        around = (i0 + i - 1, j0 + j - 1, i0 + i + 2, j0 + j + 2)
        then = truth.height(bare, mission.lattice, around, moving)
        out += bool(known.height[j, i] + errors[j, i] <= then.max() + GHOST_M)
    return out


# --- drift and a closed loop -----------------------------------------------------------------------------------------


def spread_back(trajectory: Sequence[Pose], end: Pose) -> list[Pose]:
    """The trajectory, its last pose now at `end`: the error there is spread back along the way, the first pose stays.

    At the share s of the way's length a pose has turned by s times the end's error of yaw, and each step of the way
    with the poses at its ends; by how far this still misses the end's x, y and z, a pose then moves by s times that.
    Roll and pitch, which gravity shows, stay. Where nothing has moved at all, all but the first take the whole error.
    """
    if len(trajectory) < 2:
        return list(trajectory)
    shares = _shares(trajectory)
    turned = (yaw_of(end) - yaw_of(trajectory[-1]) + math.pi) % math.tau - math.pi
    steps = np.diff([pose.position for pose in trajectory], axis=0)
    middle = (shares[1:] + shares[:-1]) / 2
    turned_steps = [_turn(share * turned) @ step for share, step in zip(middle.tolist(), steps, strict=True)]
    places = trajectory[0].position + np.vstack([np.zeros(3), np.cumsum(turned_steps, axis=0)])
    places += shares[:, None] * (end.position - places[-1])
    return [
        pose_of(_turn(share * turned) @ pose.matrix[:3, :3], place)
        for pose, share, place in zip(trajectory, shares.tolist(), places, strict=True)
    ]


def _shares(trajectory: Sequence[Pose]) -> Floats:
    steps = np.diff([pose.position for pose in trajectory], axis=0)
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(steps, axis=1))])
    return way / way[-1] if way[-1] > 0 else np.minimum(np.arange(len(way), dtype=np.float64), 1.0)


def yaw_of(pose: Pose) -> float:
    return math.atan2(pose.matrix[1, 0], pose.matrix[0, 0])


def _turn(yaw_rad: float) -> Floats:
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@dataclass(eq=False)
class Way:
    """A robot's scans, with the poses of its base that odometry alone gave, and the true ones."""

    name: str
    localiser: Localiser
    scans: list[Scan] = field(default_factory=list)
    T_base_sensor: list[Pose] = field(default_factory=list)
    drifted: list[Pose] = field(default_factory=list)
    true: list[Pose] = field(default_factory=list)

    def mapped(self, mission: Mission, trajectory: Sequence[Pose], name: str) -> Mapper:
        """The map of its scans from these poses."""
        mapper = Mapper(name, mission.lattice, mission.model)
        for scan, pose, T_base_sensor in zip(self.scans, trajectory, self.T_base_sensor, strict=True):
            mapper.integrate(replace(scan, T_world_sensor=pose @ T_base_sensor))
        return mapper


class Drift:
    """The scans of the robots on the ground, which are told their start and then have odometry alone.

    When a robot is back at its start, it knows where that is: its trajectory is put right, and it maps its own scans
    again. That there is a closure, and the pose at its end, are taken from the truth: no scans are matched.
    """

    def __init__(self, mission: Mission) -> None:
        self._mission = mission
        self.ways = [self._way(vehicle) for vehicle in on_ground(mission)]

    def table(self) -> Table:
        known = at_end(self._mission)
        rest = [vehicle.mapper for vehicle in self._mission.vehicles if vehicle.altitude_m]
        drifted = [way.drifted for way in self.ways]
        closed = [spread_back(way.drifted, way.true[-1]) if way.true else [] for way in self.ways]
        true = [way.true for way in self.ways]
        store = MemoryStore(self._mission.lattice, self._mission.model)
        for mapper in rest:
            store.accept(mapper.delta())
        rows = [
            self._row("before the closure", drifted, store, known, ""),
            self._row("after it", closed, store, known, CLOSED),
            self._row("with true poses", true, store, known, "-true"),
        ]
        return Table(
            "Drift, and a closed loop",
            (
                "poses of the ground robot", "trajectory RMSE, m", "largest error, m", "height RMSE, m", "ghosts",
                "height RMSE with the drone, m", "ghosts with the drone",
            ),
            tuple(rows),
            "As if the robot had had odometry alone: the scans of its way are mapped at the poses of that; when it is "
            "back at its start, the error there is spread back along its way, it maps its scans again, and what it "
            "reports then takes the place of what it had reported. Heights count as wrong by how far they are above "
            "or below all that stands within a cell, at the end; ghosts are higher by 0.5 m.",
        )  # fmt: skip

    def _row(
        self, what: str, trajectories: Sequence[Sequence[Pose]], store: MemoryStore, known: Truth, suffix: str
    ) -> tuple[Cell, ...]:
        """Of each robot's own contribution from these poses; earlier ones stay in the store, and out of the map."""
        names = [way.name + suffix for way in self.ways]
        for way, trajectory, name in zip(self.ways, trajectories, names, strict=True):
            store.accept(way.mapped(self._mission, trajectory, name).delta())
        flying = [vehicle.name for vehicle in self._mission.vehicles if vehicle.altitude_m]
        errors_m = np.array([
            np.linalg.norm(pose.position - true.position)
            for way, trajectory in zip(self.ways, trajectories, strict=True)
            for pose, true in zip(trajectory, way.true, strict=True)
        ])  # fmt: skip
        own, whole = (_map_facts(Replica(store=store, only=only), known) for only in (names, names + flying))
        rmse_m = float(np.sqrt((errors_m**2).mean())) if len(errors_m) else None
        return (what, rmse_m, float(errors_m.max(initial=0.0)), *own, *whole)

    def _way(self, vehicle: Vehicle) -> Way:
        fleet, number = self._mission.fleet, vehicle.number
        part = names_of(self._mission.loaded)[number][1]
        position, angles = fleet.position_m(number), fleet.angles_rad(number)
        quality_at = self._mission.world.gps_quality.at
        seed = [self._mission.scenario.seed, number, 4]
        way = Way(vehicle.name, LOCALISERS["odometry"](part.pose, quality_at, position, angles[2], seed))

        def take(scan: Scan) -> None:
            way.scans.append(scan)
            way.T_base_sensor.append(vehicle.situation.T_world_base.inverse() @ scan.T_world_sensor)
            way.drifted.append(way.localiser.read(scan.stamp_ns, fleet.position_m(number), fleet.angles_rad(number)))
            way.true.append(fleet.pose(number))

        vehicle.on_scan.append(take)
        return way


def _map_facts(replica: Replica, known: Truth) -> tuple[Any, int]:
    errors = height_errors(replica, known)
    rmse_m = error_facts(beyond(errors, known.height))["rmse_m"]
    return rmse_m, int(ghosts(errors, known.height).sum())
