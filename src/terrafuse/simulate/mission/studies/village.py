"""What the village patrol shows: the *patrol* paper's tables 2 and 3, and how the guessed heights come true."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from terrafuse.models.layers import layers_of
from terrafuse.replica import Replica
from terrafuse.simulate.mission.engine import Mission
from terrafuse.simulate.mission.measures import Truth, error_facts, height_errors
from terrafuse.simulate.mission.ownmap import live
from terrafuse.simulate.mission.tables import Cell, Table, moments
from terrafuse.simulate.mission.timeline import Timeline, blocks, coarse_truth, finer
from terrafuse.simulate.mission.vehicle import Vehicle
from terrafuse.simulate.scenario import Loaded, with_robots
from terrafuse.simulate.scenario.read import changed
from terrafuse.types import Array
from terrafuse.views import mosaic

STAGES_OF_PAPER: dict[str, tuple[int, int, int]] = {
    "collision points": (55, 55, 70),
    "heights": (5, 5, 5),
    "gradients": (130, 140, 307),
    "confidence": (82, 60, 70),
    "occupation": (30, 30, 35),
    "merge into HRM": (5, 1, 5),
    "HRM to LLRM": (110, 105, 110),
    "LLRM into GLRM": (4, 5, 5),
}
"""Table 2, milliseconds: three robots, each on a Core i3 of 2.2 GHz."""
PAPER_S: dict[int, int] = {1: 445, 2: 310, 3: 190}
"""Table 3, simulated seconds to map everything, by robots."""
FLEETS = (1, 2, 3, 6, 12)
MAPPED = 0.95
FLEET_HZ = 2.0
SAMPLE_S = 30.0
GLRM_RMSE_M = 2.0
"""Of building cells of 5 m: what robots on the street can't see makes a map without a fault err by as much."""
MOST = 255
"""The layer `confidence` of what is sure."""


def stage_table(mission: Mission) -> Table:
    """Table 2: milliseconds that each stage takes, a robot a column, and the paper's."""
    several = mission.vehicles[:6]
    of_robots = [_stage_ms(mission, vehicle) for vehicle in several]
    headings = ("stage, ms", *(vehicle.name for vehicle in several), *(f"paper, robot {n}" for n in (1, 2, 3)))
    rows: list[tuple[Cell, ...]] = [
        (stage, *(ms[stage] for ms in of_robots), *paper) for stage, paper in STAGES_OF_PAPER.items()
    ]
    sums = ("all", *(sum(ms.values()) for ms in of_robots), *map(sum, zip(*STAGES_OF_PAPER.values(), strict=True)))
    scans = sum(vehicle.mapper.revision for vehicle in several) or 1
    points = sum(vehicle.points for vehicle in several) / scans
    return Table(
        "Milliseconds a stage (table 2 of the patrol paper)", headings, (*rows, sums),
        f"Up to the merge into the HRM: a scan of {points:,.0f} points in the mean. HRM to LLRM: one report of what "
        "changed since the one before. LLRM into GLRM: all that the station does, receiving, fusing, telling what it "
        "holds, by the delta taken in; the same for each robot. 'All' is one of each. The paper: Core i3, 2.2 GHz, C#; "
        "how many points a scan had, it does not say.",
    )  # fmt: skip


def _stage_ms(mission: Mission, vehicle: Vehicle) -> dict[str, float]:
    scans = max(vehicle.mapper.revision, 1)
    out = {stage: 1e3 * seconds / scans for stage, seconds in vehicle.mapper.observing.items()}
    observing = sum(out.values())
    merged_s = vehicle.mapper.seconds["merge"] + vehicle.mapper.seconds["load"] + vehicle.mapper.seconds["evict"]
    rest = 1e3 * vehicle.mapper.seconds["observe"] / scans - observing
    out["merge into HRM"] = 1e3 * merged_s / scans + max(rest, 0.0)
    out["HRM to LLRM"] = 1e3 * vehicle.node.seconds["coarsen"] / max(vehicle.node.reports, 1)
    deltas = mission.station.facts().get("deltas_applied", 0)
    out["LLRM into GLRM"] = 1e3 * mission.station.seconds / max(deltas, 1)
    return out


class Heights:
    """A watcher: every so often, how far the robots' fused map is from the true heights of the buildings, in the HRM's
    cells and in the GLRM's."""

    def __init__(self, mission: Mission) -> None:
        self.rows: list[tuple[Cell, ...]] = []
        window = mission.coarse_lattice.cell_window(mission.world.bounds)
        self._factor = mission.scenario.map.global_factor
        self._known = Truth(mission.world, mission.lattice, finer(window, self._factor))
        self._coarse_m, self._coarse_houses = coarse_truth(mission, window)
        self._window = window
        self._next_s = 0.0

    def __call__(self, mission: Mission) -> None:
        if mission.now_s + 1e-9 < self._next_s:
            return
        self._next_s += SAMPLE_S
        if mission.now_s >= 1:
            self.sample(mission)

    def sample(self, mission: Mission) -> None:
        mappers = [vehicle.mapper for vehicle in mission.vehicles]
        fine = live(mappers)
        errors, sure = height_errors(fine, self._known), self._sure(fine)
        houses, streets = self._known.houses, self._known.streets
        facts, glimpses, on_streets = (error_facts(errors, where) for where in (houses & sure, houses, streets & sure))
        coarse, faultless = self._coarse(live(mappers, factor=self._factor)), self._faultless(np.isfinite(errors))
        self.rows.append((
            round(mission.now_s, 1), facts["cells"], facts["rmse_m"], facts["bias_m"], facts["median_abs_m"],
            glimpses["cells"], glimpses["rmse_m"], on_streets["rmse_m"], coarse["cells"], coarse["rmse_m"],
            faultless["rmse_m"],
        ))  # fmt: skip

    def _sure(self, replica: Replica) -> Array:
        """Cells that are sure enough to count in the model's own rule for coarser ones."""
        layer = layers_of(replica.model)["confidence"]
        confidence = mosaic(replica, [layer], self._known.window)[layer.name]
        return np.asarray(confidence >= MOST * replica.model.settings()["coarse_confidence"])

    def _coarse(self, replica: Replica) -> dict[str, Any]:
        layer = layers_of(replica.model)["height"]
        errors = mosaic(replica, [layer], self._window)[layer.name] - self._coarse_m
        return error_facts(errors, self._coarse_houses)

    def _faultless(self, seen: Array) -> dict[str, Any]:
        """Of a map that has the true height in each cell that was seen: what lacks is the roofs that nobody sees."""
        parts, counts = blocks(seen, self._factor), blocks(seen, self._factor).sum(axis=(1, 3))
        sums = np.where(parts, blocks(self._known.height, self._factor), 0.0).sum(axis=(1, 3))
        means = np.divide(sums, counts, out=np.full(sums.shape, np.nan), where=counts > 0)
        return error_facts(means - self._coarse_m, self._coarse_houses)

    def table(self) -> Table:
        return Table(
            "Heights of what was seen",
            (
                "simulated s", "building cells", "RMSE, m", "bias, m", "median, m", "with glimpses", "RMSE of these, m",
                "streets RMSE, m", "building cells of the GLRM", "their RMSE, m", "of a faultless HRM, m",
            ),
            tuple(moments(self.rows, 20)),
            "Of what robots saw, without the prior's guess. HRM: against the true height at each cell's centre; cells "
            "whose confidence is 2/16 or more, from which on a cell counts for coarser ones; a glimpse is one that is "
            "less sure, of a beam or two from far away, often at the foot of a wall. With glimpses, 0.5 m is not kept. "
            "Of what was seen neither falls with time, as new houses come in all the while; the global map with its "
            "guesses does. GLRM: cells that are a building's by half or more, against the mean of the true heights "
            "within. Robots on the street see walls and eaves and hardly a roof, so a GLRM cell is the mean of a part "
            "of its ground; a faultless HRM, which has the true height in each cell that was seen, errs by this part "
            f"alone, by 1.7 to 2.1 m. So {GLRM_RMSE_M:g} m is what the GLRM is to stay under.",
        )  # fmt: skip


def growth_table(timeline: Timeline) -> Table:
    """The station's global map as time goes by: what is mapped, and the buildings' heights, the guesses included."""
    rows = [row for row in timeline.rows if "mapped_share_at_station" in row]
    return Table(
        "The global map (GLRM) as it grows",
        ("simulated s", "streets mapped", "at the station", "building RMSE, m", "of what was seen, m", "cells seen"),
        tuple(
            (
                row["time_s"], row["mapped_share"], row["mapped_share_at_station"], row.get("building_rmse_map_m"),
                row.get("building_rmse_seen_m"), row.get("building_cells_seen"),
            )
            for row in moments(rows, 12)
        ),
        "Cells of 5 m that are a building's by half or more, against the mean of the true heights within. Before "
        "anything is seen, the map has the prior's guess.",
    )  # fmt: skip


def fleet_table(loaded: Loaded, counts: Sequence[int] = FLEETS, tell: Callable[[str], None] = lambda _: None) -> Table:
    """Table 3: simulated seconds until the streets are mapped, by the number of robots."""
    times: dict[int, float | None] = {}
    to_the_end = slower(changed(loaded, stop_mapped_share=MAPPED, duration_s=20_000.0))
    for count in counts:
        tell(f"{count} robots")
        times[count] = mapped_s(with_robots(to_the_end, count))
    alone = times.get(1)
    rows = tuple(
        (count, seconds, alone / seconds if alone and seconds else None, PAPER_S.get(count),
         PAPER_S[1] / PAPER_S[count] if count in PAPER_S else None)
        for count, seconds in times.items()
    )  # fmt: skip
    return Table(
        f"Simulated seconds until {MAPPED:.0%} of the streets are mapped (table 3 of the patrol paper)",
        ("robots", "seconds", "speed-up", "paper, s", "its speed-up"),
        rows,
        f"Street cells of 5 m that some robot has in its own map, with lidars at {FLEET_HZ:g} Hz, which is often "
        "enough for these, and the global map at the station alone. All start there, in the middle. The paper's "
        "village is another one.",
    )


def slower(loaded: Loaded) -> Loaded:
    """The same with sensors that look less often, and robots that report to the station alone: what they map hardly
    differs, and takes less time to simulate."""
    robots = [
        part.model_copy(
            update={"sensors": tuple(sensor.model_copy(update={"rate_hz": FLEET_HZ}) for sensor in part.sensors)}
        )
        for part in loaded.scenario.robots
    ]
    radio = loaded.scenario.radio.model_copy(update={"share": "station"})
    return replace(loaded, scenario=loaded.scenario.model_copy(update={"robots": tuple(robots), "radio": radio}))


def mapped_s(loaded: Loaded) -> float | None:
    """When a mission has mapped what its scenario asks for."""
    with TemporaryDirectory() as folder:
        mission = Mission(loaded, folder=Path(folder))
        timeline = Timeline(mission, at_station=False)
        mission.run([timeline])
    share = loaded.scenario.stop_mapped_share
    return None if share is None else timeline.reached_s(share)
