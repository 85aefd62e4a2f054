"""Studies: what a scenario shows beyond its map, as tables. `STUDIES` by name, the name that a scenario gives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from terrafuse.simulate.mission.engine import Mission, Watcher
from terrafuse.simulate.mission.studies import fleet, hallway, parking, soccer, village
from terrafuse.simulate.mission.tables import Table
from terrafuse.simulate.mission.timeline import Timeline
from terrafuse.simulate.scenario import Loaded


@dataclass(frozen=True)
class Study:
    """Of one mission: made before it runs, asked when it has ended."""

    watchers: Sequence[Watcher] = ()
    tables: Callable[[], list[Table]] = list
    """The same for the same seed."""
    timed_tables: Callable[[], list[Table]] = list
    """With times of clocks in them."""
    pictures: Callable[[Path], dict[str, str]] = lambda out: {}
    """Written into a folder; names of the files by what they show."""


Tell = Callable[[str], None]


def _village(mission: Mission, timeline: Timeline) -> Study:
    heights = village.Heights(mission)
    return Study(
        [heights],
        lambda: [village.growth_table(timeline), heights.table()],
        lambda: [village.stage_table(mission)],
    )


def _parking(mission: Mission, timeline: Timeline) -> Study:
    ghosts, drift = parking.Ghosts(mission), parking.Drift(mission)
    return Study(tables=lambda: [ghosts.table(), drift.table()])


def _hallway(mission: Mission, timeline: Timeline) -> Study:
    growth = hallway.Growth(mission)
    return Study(
        [growth],
        lambda: [growth.table(), hallway.window_table(mission)],
        lambda: [hallway.pause_table([mission])],
    )


def _soccer(mission: Mission, timeline: Timeline) -> Study:
    game = soccer.Game(mission)
    return Study(
        [game],
        lambda: [game.table(), soccer.echo_table([mission]), soccer.frame_table(mission)],
        pictures=lambda out: soccer.picture(mission, out),
    )


STUDIES: dict[str, Callable[[Mission, Timeline], Study]] = {
    "fleet": lambda mission, timeline: Study(timed_tables=lambda: [fleet.cost_table(mission)]),
    "hallway": _hallway,
    "map": lambda mission, timeline: Study(),
    "parking": _parking,
    "soccer": _soccer,
    "village": _village,
}


@dataclass(frozen=True)
class Needs:
    """What a study can be made of; empty: whatever there is."""

    models: tuple[str, ...] = ()
    worlds: tuple[str, ...] = ()


NEEDS: dict[str, Needs] = {
    "hallway": Needs(worlds=("hallway",)),
    "parking": Needs(models=("elevation",)),
    "soccer": Needs(models=("grey",), worlds=("soccer_field",)),
    "village": Needs(models=("terrain",)),
}
"""By study; one that is not here needs nothing."""

SWEEPS: dict[str, Callable[[Loaded, Tell], list[Table]]] = {
    "fleet": lambda loaded, tell: [fleet.growth_table(loaded, tell=tell)],
    "hallway": lambda loaded, tell: hallway.sweep(loaded, tell=tell),
    "soccer": lambda loaded, tell: [soccer.echo_sweep(loaded, tell)],
    "village": lambda loaded, tell: [village.fleet_table(loaded, tell=tell)],
}
"""Tables that take several missions: for the page of results, not for each run."""
