"""What the soccer game shows: the *grey* paper's whole map against the field, false echoes, and its frames."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from terrafuse import views
from terrafuse.exchange.grey_frame import decode_frame, encode_frame, frames_of
from terrafuse.export.looks import look_of
from terrafuse.export.picture import Subject, draw_subject
from terrafuse.lattice import Lattice
from terrafuse.models.grey import lower, upper
from terrafuse.replica import Replica
from terrafuse.simulate import truth
from terrafuse.simulate.mission.engine import Mission
from terrafuse.simulate.mission.measures import wider
from terrafuse.simulate.mission.tables import Cell, Table
from terrafuse.simulate.mission.vehicle import Vehicle
from terrafuse.simulate.movers import bodies
from terrafuse.simulate.quantities import Place
from terrafuse.simulate.scenario import Loaded
from terrafuse.simulate.worlds.soccer import EAST_M, NORTH_M
from terrafuse.types import Array, Bounds, Floats
from terrafuse.views import CellWindow

FIELD = Bounds(0.0, 0.0, EAST_M, NORTH_M)
BAND_M = (0.1, 0.6)
"""Boards and robots stand at these heights."""
HALF = 0.5
"""White values above it are occupied, below it free: the paper's boundary."""
FIRST_S, EVERY_S = 5.0, 1.0
RECEIVERS = (("uncoded", "aligned"), ("uncoded", "random"), ("coded", "aligned"), ("coded", "random"))
WHOLE = "whole.png"
RIM_CELLS = 3
"""The picture shows so much more of what is around the field: boards, goals."""

Disc = tuple[Place, float]
"""Middle and radius of a robot."""


def whole_map(replica: Replica, window: CellWindow, robots: Sequence[Disc] = ()) -> Floats:
    """(H, W) white values of the fused map over a window, with `robots` drawn into it.

    The paper marks the cell of a robot as occupied in its sub-map, where it would stay when the robot has gone, and be
    fused away by those who see the cell free. Where robots are is no evidence of anybody's sonars: the station draws
    what they say of themselves over the map whenever it is read.
    """
    layer = replica.model.occupied
    white = views.mosaic(replica, [layer], window)[layer.name]
    for place_m, radius_m in robots:
        white[covered(replica.lattice, window, place_m, radius_m)] = 1.0
    return white


def covered(lattice: Lattice, window: CellWindow, place_m: Place, radius_m: float) -> Array:
    """(H, W): which cells a disc reaches into."""
    i0, j0, i1, j1 = window
    half = lattice.resolution_m / 2
    x = np.abs(lattice.cell_centre(np.arange(i0, i1)) - place_m[0])
    y = np.abs(lattice.cell_centre(np.arange(j0, j1)) - place_m[1])[:, None]
    return np.asarray(np.hypot(np.maximum(x - half, 0), np.maximum(y - half, 0)) <= radius_m)


def robots_said(mission: Mission) -> list[Disc]:
    """Where robots say that they are, as the station has it, and their bodies' radius."""
    radii = {vehicle.name: vehicle.situation.body.radius_m for vehicle in mission.vehicles}
    return [(place, radii[name]) for name, place in sorted(mission.station.places_m.items())]


class Game:
    """A watcher: once a second, what the whole map makes of the field as it truly is then."""

    def __init__(self, mission: Mission) -> None:
        self._window = mission.coarse_lattice.cell_window(FIELD)
        self._next_s = FIRST_S
        self._shares: dict[str, list[tuple[float, ...]]] = {"sonars alone": [], "robots drawn": []}

    def __call__(self, mission: Mission) -> None:
        if mission.now_s + 1e-9 < self._next_s:
            return
        self._next_s += EVERY_S
        self.sample(mission)

    def sample(self, mission: Mission) -> None:
        lattice, replica = mission.coarse_lattice, mission.station.replica
        stands = truth.occupied(mission.world, lattice, self._window, BAND_M, bodies(mission.fleet.bodies()))
        here = [cell_of(lattice, self._window, mission.fleet.position_m(v.number)) for v in mission.vehicles]
        for name, robots in (("sonars alone", []), ("robots drawn", robots_said(mission))):
            self._shares[name].append(_shares(whole_map(replica, self._window, robots), stands, here))

    def table(self) -> Table:
        """Means over the game."""
        rows = [(name, len(s), *np.mean(s, axis=0).tolist()) for name, s in self._shares.items() if s]
        return Table(
            "The whole map against the field as it is",
            ("whole map of", "samples", "robots' cells occupied", "least in a sample", "free cells free", "undecided",
             "called occupied"),
            tuple((*row[:3], min(s[0] for s in self._shares[str(row[0])]), *row[3:]) for row in rows),
            f"Once a second from {FIRST_S:g} s on, at the station; occupied is a white value over ½. Robots' cells are "
            "those of their true middles. Free cells: of those on the field that are over a cell away from every robot "
            "and board. Sonars alone: what robots hear of each other, a sonar that looks through where one stood "
            "fuses away. Robots drawn: over the fused map, where they say that they are, as in the paper, whose "
            "cameras tell them; here they know it exactly, so that none can be missed.",
        )  # fmt: skip


def cell_of(lattice: Lattice, window: CellWindow, position_m: Floats) -> tuple[int, int]:
    """(row, column) of a place in a window."""
    i, j = np.floor(position_m[:2] * lattice.cells_per_m).astype(int).tolist()
    return j - window[1], i - window[0]


def _shares(white: Floats, stands: Array, here: Sequence[tuple[int, int]]) -> tuple[float, ...]:
    """Robots' cells that are occupied; of free cells: free, undecided or unknown, occupied."""
    free = white[~wider(stands)]
    called_free, called_occupied = float((free < HALF).mean()), float((free > HALF).mean())
    own = float(np.mean([white[cell] > HALF for cell in here]))
    return own, called_free, 1.0 - called_free - called_occupied, called_occupied


# --- false echoes ----------------------------------------------------------------------------------------------------


def echo_table(missions: Sequence[Mission]) -> Table:
    """A mission a row: what robots took for echoes of their own pings."""
    return Table(
        "False echoes that get through",
        ("pulses", "rounds begin", "readings", "false echoes", "share", "robots that have some"),
        tuple(map(_echo_row, missions)),
        "Readings that another robot's ping shortened by over 5 cm. Robots' sonars fire in turn, 20 ms each. To a "
        "correlator that finds echoes whenever they come, codes are not orthogonal: rows 2 and 3 of the Walsh–Hadamard "
        "matrix overlap by 7/8 at some lag, whether pulses are aligned or not. There are five rows that never mistake "
        "each other; the third robot has row 2, the sixth row 3.",
    )


def _echo_row(mission: Mission) -> tuple[Cell, ...]:
    part = mission.scenario.robots[0].sensors[0]
    counts = [sense.counts for vehicle in mission.vehicles for sense in vehicle.senses]
    readings, false = (sum(count[what] for count in counts) for what in ("beams", "false_echoes"))
    deceived = [v.name for v in mission.vehicles if any(sense.counts["false_echoes"] for sense in v.senses)]
    return part.crosstalk, part.pulses, readings, false, false / max(readings, 1), ", ".join(deceived) or "none"


def echo_sweep(loaded: Loaded, tell: Callable[[str], None] = lambda _: None) -> Table:
    """The same game with each receiver, robots' rounds beginning together or not."""
    missions = []
    for crosstalk, pulses in RECEIVERS:
        tell(f"{crosstalk}, {pulses}")
        mission = Mission(with_pulses(loaded, crosstalk, pulses))
        mission.run()
        missions.append(mission)
    return echo_table(missions)


def with_pulses(loaded: Loaded, crosstalk: str, pulses: str) -> Loaded:
    """The same game, all of whose sonars hear others so."""

    def changed(part: Any) -> Any:
        sensors = tuple(one.model_copy(update={"crosstalk": crosstalk, "pulses": pulses}) for one in part.sensors)
        return part.model_copy(update={"sensors": sensors})

    robots = tuple(map(changed, loaded.scenario.robots))
    return replace(loaded, scenario=loaded.scenario.model_copy(update={"robots": robots}))


# --- frames ----------------------------------------------------------------------------------------------------------


def frame_table(mission: Mission) -> Table:
    """What reporting takes: the paper's frames of whole sub-maps, and what was sent instead."""
    window = mission.coarse_lattice.cell_window(FIELD)
    rate_hz = 1 / mission.scenario.radio.report_s
    rows = [_frame_row(mission, vehicle, window, rate_hz) for vehicle in mission.vehicles]
    i0, j0, i1, j1 = window
    return Table(
        f"A sub-map of {i1 - i0} × {j1 - j0} cells in frames of {mission.scenario.radio.frame_bytes} bytes",
        (
            "robot",
            "frames",
            "bytes",
            "largest error of a, b",
            "sent so, bytes a second",
            "sent as deltas, bytes a second",
        ),
        tuple(rows),
        f"The paper's frame: 12 bytes and 2 a cell, sent {rate_hz:.3g} times a second. Deltas: all that the robot's "
        "radio sent, with headers, acknowledgements and where it is.",
    )


def _frame_row(mission: Mission, vehicle: Vehicle, window: CellWindow, rate_hz: float) -> tuple[Cell, ...]:
    own = Replica(store=mission.station.replica.store, only=[vehicle.name])
    cells = views.cells_in(own, window, own.keys)
    messages = [encode_frame(frame) for frame in frames_of(cells, window[0], window[1], 0)]
    size = sum(map(len, messages))
    sent = mission.radio.counts[vehicle.name]["bytes_sent"] / max(mission.now_s, 1e-9)
    return vehicle.name, len(messages), size, _rounding(cells, messages, window), size * rate_hz, sent


def _rounding(cells: Array, messages: Sequence[bytes], window: CellWindow) -> float:
    """How far a frame's intervals are from the cells', at most."""

    def errors() -> Iterator[float]:
        for frame in map(decode_frame, messages):
            rows, columns = frame.a.shape
            j, i = frame.j0 - window[1], frame.i0 - window[0]
            part = cells[j : j + rows, i : i + columns]
            for given, true in ((frame.a, lower(part)), (frame.b, upper(part))):
                yield float(np.abs(given / 255 - true).max())

    return max(errors(), default=0.0)


def picture(mission: Mission, out: Path) -> dict[str, str]:
    """The whole map with the robots where they say that they are."""
    replica = mission.station.replica
    i0, j0, i1, j1 = mission.coarse_lattice.cell_window(FIELD)
    window = i0 - RIM_CELLS, j0 - RIM_CELLS, i1 + RIM_CELLS, j1 + RIM_CELLS
    west, south = views.bounds_of(replica, window)[:2]
    layer = replica.model.occupied
    white = whole_map(replica, window, robots_said(mission))
    subject = Subject(layer, replica.lattice, 1, white, west, south, look_of(layer))
    draw_subject(out / WHOLE, lambda: subject, None, "The whole map at the station, with the robots")
    return {"whole map": WHOLE}


__all__ = ["Game", "echo_sweep", "echo_table", "frame_table", "picture", "whole_map"]
