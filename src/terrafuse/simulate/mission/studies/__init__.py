"""Studies: what a scenario shows beyond its map, as tables. `STUDIES` by name, the name that a scenario gives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from terrafuse.simulate.mission.engine import Mission, Watcher
from terrafuse.simulate.mission.studies import fleet, village
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


Tell = Callable[[str], None]


def _village(mission: Mission, timeline: Timeline) -> Study:
    heights = village.Heights(mission)
    return Study(
        [heights],
        lambda: [village.growth_table(timeline), heights.table()],
        lambda: [village.stage_table(mission)],
    )


STUDIES: dict[str, Callable[[Mission, Timeline], Study]] = {
    "fleet": lambda mission, timeline: Study(timed_tables=lambda: [fleet.cost_table(mission)]),
    "hallway": lambda mission, timeline: Study(),
    "map": lambda mission, timeline: Study(),
    "village": _village,
}

SWEEPS: dict[str, Callable[[Loaded, Tell], list[Table]]] = {
    "fleet": lambda loaded, tell: [fleet.growth_table(loaded, tell=tell)],
    "village": lambda loaded, tell: [village.fleet_table(loaded, tell=tell)],
}
"""Tables that take several missions: for the page of results, not for each run."""
