"""`terrafuse simulate`: a scenario, watched as it runs, and what came of it. `terrafuse demo` is one of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Protocol

import typer

from terrafuse.cli.output import LINES_EVERY_S, bytes_text, count_text, note, say, say_json, tell_of_compiling

if TYPE_CHECKING:
    from terrafuse.simulate.mission.engine import Mission
    from terrafuse.simulate.scenario import Loaded

Json = Annotated[bool, typer.Option("--json", help="One JSON object on stdout instead of text.")]
Threads = Annotated[
    int,
    typer.Option(min=1, help="That cast rays; the result is the same. More may pay where threads wake up quickly."),
]
MOVES_MPS = 0.05
"""A robot that is faster moves."""
DEMO, DEMO_ROBOTS, DEMO_S = "village", 3, 60.0
REDRAW_S = 0.2


def simulate(
    scenario: Annotated[
        str | None,
        typer.Argument(metavar="SCENARIO", help="A shipped scenario's name, or a YAML file; none: list them."),
    ] = None,
    robots: Annotated[int | None, typer.Option(help="So many robots of the scenario's first kind.")] = None,
    seed: Annotated[int | None, typer.Option(help="Of the world and of all noise.")] = None,
    duration: Annotated[float | None, typer.Option(help="Simulated seconds.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for the results.  [default: ./SCENARIO]")] = None,
    record: Annotated[
        bool, typer.Option("--record", help="Also write each robot's log, NAME.mcap, which 'terrafuse map' reads.")
    ] = False,
    threads: Threads = 1,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the map that is in the folder.")] = False,
    json: Json = False,
) -> None:
    """Rehearse a mission: robots that sense, map, report and drive in a world with a known truth.

    Writes report.html with a film of the map as it grows, pictures and tables; report.json; map.db and map.tif.
    """
    from terrafuse.errors import InputError
    from terrafuse.simulate.scenario import load_scenario, with_robots
    from terrafuse.simulate.scenario.read import changed

    if scenario is None:
        _list(json)
        return
    try:
        loaded = load_scenario(scenario)
    except InputError:
        if not json and not Path(scenario).is_file():
            note("\n".join(_lines_of_list()))
        raise
    loaded = changed(loaded, seed=seed, duration_s=duration)
    if robots is not None:
        loaded = with_robots(loaded, robots)
    folder = out or Path(loaded.name)
    report = _run(loaded, folder, record=record, threads=threads, overwrite=overwrite)
    if json:
        say_json(report)
    else:
        tell(report, folder)
        if record:
            _tell_again(report, folder)


def demo(
    out: Annotated[Path, typer.Option("--out", help="Folder for the results.")] = Path("demo"),
    headless: Annotated[bool, typer.Option("--headless", help="Do not open the report.")] = False,
    duration: Annotated[float, typer.Option(help="Simulated seconds.")] = DEMO_S,
    json: Json = False,
) -> None:
    """Watch three robots map a village: the shipped scenario 'village', cut short."""
    from terrafuse.simulate.scenario import load_scenario, with_robots
    from terrafuse.simulate.scenario.read import changed

    loaded = with_robots(changed(load_scenario(DEMO), duration_s=duration), DEMO_ROBOTS)
    report = _run(loaded, out, record=False, threads=1, overwrite=True)
    if json:
        say_json(report)
        return
    tell(report, out)
    if not headless:
        typer.launch(str(out / report["files"]["report"]))


def _run(loaded: Loaded, out: Path, **options: Any) -> dict[str, Any]:
    from terrafuse.errors import Interrupted
    from terrafuse.simulate.mission.results import run

    tell_of_compiling()
    try:
        with live(loaded.scenario.duration_s) as watch:
            return run(loaded, out, progress=watch, stage=watch.stage, **options)
    except KeyboardInterrupt:
        raise Interrupted("interrupted; nothing of this run is kept") from None


def _list(json: bool) -> None:
    if json:
        say_json({"scenarios": titles()})
    else:
        say("\n".join(_lines_of_list()))


def _lines_of_list() -> list[str]:
    found = titles()
    width = max(map(len, found))
    lines = [f"  {name:{width}}  {title}" for name, title in found.items()]
    return ["scenarios, for 'terrafuse simulate SCENARIO':", *lines, "or a YAML file of your own: docs/scenarios.md"]


def titles() -> dict[str, str]:
    """Of the shipped scenarios, by name."""
    from terrafuse.simulate.scenario import load_scenario, scenario_names

    return {name: load_scenario(name).scenario.title for name in scenario_names()}


def tell(report: dict[str, Any], out: Path) -> None:
    """A short summary, with the pictures' paths."""
    if report["study_failure"] is not None:
        note(f"warning: the study '{report['scenario']['study']}' failed, all else is there: {report['study_failure']}")
    timings, files = report["timings"], report["files"]
    say(
        f"{report['scenario']['title'] or report['scenario']['name']}: {_count(len(report['robots']))}, "
        f"{report['simulated_s']:g} s simulated at {timings['times_real_time']:.1f} times real time, "
        f"{report['mapped_share']:.1%} mapped at the station"
    )
    for name, robot in list(report["robots"].items())[:6]:
        sent = report["radio"].get(name, {}).get("bytes_sent", 0)
        say(
            f"{name}: {robot['scans']:,} scans, {count_text(robot['points'])}points, {robot['way_m']:,.0f} m, "
            f"{bytes_text(sent)} sent"
        )
    say(f"map: {report['cells']:,} cells of {report['map']['resolution_m']:g} m{_errors(report)}")
    pictures = [file for file in files.values() if file.endswith((".png", ".gif"))]
    say("pictures: " + ", ".join(str(out / file) for file in pictures))
    say(f"report: {out / files['report']}")


def _count(robots: int) -> str:
    return "1 robot" if robots == 1 else f"{robots} robots"


def _tell_again(report: dict[str, Any], out: Path) -> None:
    from terrafuse.simulate.mission.recording import map_command

    say(f"the same map, from the logs: {map_command(report, out)}")


def _errors(report: dict[str, Any]) -> str:
    median_m = report["measures"]["map"].get("height", {}).get("median_abs_m")
    return "" if median_m is None else f", heights off by {median_m:.3f} m in the median"


class Watch(Protocol):
    """Told of each tick, and of what else takes time."""

    def __call__(self, mission: Mission, share: float) -> None: ...

    def stage(self, word: str) -> None: ...


class Watching:
    """Writes where a mission is, every so often."""

    def __init__(
        self, duration_s: float, write: Callable[[float, str], None], every_s: float, stage: Callable[[str], None]
    ) -> None:
        self._duration_s, self._write, self._every_s, self.stage = duration_s, write, every_s, stage
        self._started: float | None = None
        self._last = 0.0

    def __call__(self, mission: Mission, share: float) -> None:
        now = time.perf_counter()
        if self._started is None:
            self._started = self._last = now
        if now - self._last >= self._every_s:
            self._last = now
            rate = mission.now_s / (now - self._started)
            self._write(mission.now_s, progress_text(mission, share, self._duration_s, rate))


def progress_text(mission: Mission, share: float, duration_s: float, times_real: float) -> str:
    moving = sum(abs(mission.fleet.speed_mps(v.number)[0]) > MOVES_MPS for v in mission.vehicles)
    return (
        f"{mission.now_s:.0f} of {duration_s:.0f} s, {times_real:.1f} × real time, {share:.0%} mapped, "
        f"{moving} of {len(mission.vehicles)} robots moving"
    )


@contextmanager
def live(duration_s: float) -> Iterator[Watch]:
    """On stderr: a bar where that is a terminal, else lines."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    if not console.is_terminal:
        yield Watching(duration_s, lambda _, text: note(text), LINES_EVERY_S, lambda word: note(f"{word} …"))
        return
    with Progress(TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), console=console) as progress:
        task = progress.add_task("", total=duration_s)

        def write(now_s: float, text: str) -> None:
            progress.update(task, completed=now_s, description=text)

        yield Watching(duration_s, write, REDRAW_S, lambda word: progress.update(task, description=f"{word} …"))
