"""What a fleet costs as it grows: the question that the *patrol* paper leaves open."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from time import process_time

from terrafuse.simulate.mission.engine import Mission
from terrafuse.simulate.mission.tables import Cell, Table
from terrafuse.simulate.scenario import Loaded, with_robots

COUNTS = (1, 3, 10, 30, 100)
HEADINGS = (
    "robots", "mapping, ms", "coarsening, ms", "fusing, ms", "fusing in all, s", "bytes", "frames", "m driven",
    "simulated s a processor second",
)  # fmt: skip


def cost_table(mission: Mission) -> Table:
    """The row of this mission."""
    return _table([_row(mission, None)])


def growth_table(loaded: Loaded, counts: Sequence[int] = COUNTS, tell: Callable[[str], None] = lambda _: None) -> Table:
    """A mission for each number of robots, one after the other."""
    rows = []
    for count in counts:
        tell(f"{count} robots")
        mission = Mission(with_robots(loaded, count))
        started = process_time()
        mission.run()
        rows.append(_row(mission, mission.now_s / (process_time() - started)))
    return _table(rows)


def _row(mission: Mission, simulated_s: float | None) -> tuple[Cell, ...]:
    robots = mission.vehicles
    robot_seconds = len(robots) * mission.now_s
    mapping = sum(robot.seconds["map"] for robot in robots)
    coarsening = sum(robot.node.seconds["coarsen"] for robot in robots)
    fusing = mission.station.seconds
    sent = [mission.radio.counts[robot.name] for robot in robots]
    per_robot_second = [1e3 * seconds / robot_seconds for seconds in (mapping, coarsening, fusing)]
    air = [sum(counts[what] for counts in sent) / robot_seconds for what in ("bytes_sent", "frames_sent")]
    way_m = sum(robot.way_m for robot in robots) / robot_seconds
    return (len(robots), *per_robot_second, fusing, *air, way_m, simulated_s)


def _table(rows: Sequence[tuple[Cell, ...]]) -> Table:
    return Table(
        "What each robot costs for each simulated second",
        HEADINGS,
        tuple(rows),
        "Processor time of mapping and coarsening on the robot, and of all that the station does, decoding and fusing "
        "above all; what the robot sends, with headers, and drives. Fusing in all grows linearly where fusing a "
        "robot-second stays the same. The last column is of the whole simulation on one thread.",
    )
