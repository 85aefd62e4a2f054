"""Run scenarios at full length and write docs/results.md with their tables and pictures.

    python -m bench.results               every shipped scenario
    python -m bench.results village       only this one; the page keeps the others' parts
    ... --kept-sweeps                     with the tables of many missions, which take most of the time, as they were

What a scenario leaves behind besides stays in --out.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from PIL import Image, ImageSequence

from terrafuse.simulate.mission.report import measures_table, robots_table, windows_table
from terrafuse.simulate.mission.results import run
from terrafuse.simulate.mission.studies import SWEEPS
from terrafuse.simulate.mission.tables import Table, from_json, markdown
from terrafuse.simulate.scenario import Loaded, load_scenario, scenario_names
from terrafuse.simulate.scenario.read import changed

DOCS = Path(__file__).parent.parent / "docs"
PAGE, IMAGES = "results.md", "images"
MOST_BYTES = 300_000
SIDES = (900, 700, 550, 400, 300)
"""Pixels of a picture's longer side, tried one after the other until it is small enough."""
ORDER = ("village", "hallway", "soccer", "parking", "fleet")
SHOWN = {
    "film": "the station's map as it grows",
    "world": "the world",
    "map": "the robots' maps, fused",
    "whole map": "the whole map, with the robots where they say that they are",
    **{f"map of a{number}": f"what robot a{number} saw itself" for number in (1, 2, 3)},
}
INTRO = """# Results

Every scenario that ships, at full length, beside the papers' own figures. `make results` runs them all and writes this
page; `python -m bench.results village` runs one and leaves the others' parts. Whatever is no time of a clock is the
same in every byte for the same seed. How well maps of real recordings do is in [accuracy](accuracy.md).
"""


def main(arguments: Sequence[str] | None = None) -> None:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("scenarios", nargs="*", metavar="SCENARIO", help="names or files; all that ship by default")
    asked.add_argument("--out", type=Path, default=Path("results"), help="folder for what the scenarios leave behind")
    asked.add_argument("--docs", type=Path, default=DOCS, help="folder of the page")
    asked.add_argument("--duration", type=float, help="simulated seconds, for a try")
    asked.add_argument("--threads", type=int, default=2)
    asked.add_argument("--no-sweeps", action="store_true", help="leave out the tables that take several missions")
    asked.add_argument("--kept-sweeps", action="store_true", help="take these as they were left behind last time")
    given = asked.parse_args(arguments)
    for name in given.scenarios or ordered(scenario_names()):
        loaded = changed(load_scenario(name), duration_s=given.duration)
        tell(loaded.name)
        out = given.out / loaded.name
        report = run(loaded, out, threads=given.threads, overwrite=True, stage=tell)
        sweeps = [] if given.no_sweeps else swept(loaded, given.out / f"{loaded.name}-sweeps.json", given.kept_sweeps)
        put(given.docs / PAGE, loaded.name, section(loaded, report, sweeps, out, given.docs / IMAGES))


def swept(loaded: Loaded, path: Path, kept: bool) -> list[Table]:
    """The tables of several missions, run now or as `path` has them."""
    if not kept or not path.exists():
        sweep = SWEEPS.get(loaded.scenario.study)
        tables = sweep(loaded, tell) if sweep else []
        path.write_text(json.dumps([table.as_json() for table in tables]), encoding="utf-8")
    return [from_json(table) for table in json.loads(path.read_text(encoding="utf-8"))]


def section(loaded: Loaded, report: dict[str, Any], sweeps: Sequence[Table], out: Path, images: Path) -> str:
    """A scenario's part of the page; its pictures go into `images`."""
    timings = report["timings"]
    parts = [
        f"## {loaded.scenario.title or loaded.name}",
        f"`terrafuse simulate {loaded.name}`: {len(report['robots'])} robots, {report['simulated_s']:g} s simulated at "
        f"{timings['times_real_time']:.1f} times real time, {report['mapped_share']:.1%} mapped at the station, seed "
        f"{report['seed']}.",
        *_pictures(loaded.name, report["files"], out, images),
        *(markdown(table) for table in (*sweeps, *_tables(report))),
    ]
    return "\n\n".join(part.rstrip() for part in parts if part) + "\n"


def _tables(report: dict[str, Any]) -> Iterator[Table]:
    yield from map(from_json, (*report["tables"], *report["timings"]["tables"]))
    yield from (measures_table(report), robots_table(report), windows_table(report))


def _pictures(name: str, files: dict[str, str], out: Path, images: Path) -> Iterator[str]:
    images.mkdir(parents=True, exist_ok=True)
    for kind, about in SHOWN.items():
        if kind in files:
            target = images / f"results-{name}-{Path(files[kind]).name}"
            shrink(out / files[kind], target)
            yield f"![{name}: {about}]({IMAGES}/{target.name})"


def put(page: Path, name: str, text: str) -> None:
    """Replace a scenario's part of the page, or add it where it belongs."""
    parts = parts_of(page.read_text(encoding="utf-8")) if page.exists() else {}
    parts[name] = text
    marked = (f"<!-- {part}: begin -->\n{parts[part]}<!-- {part}: end -->\n" for part in ordered(parts))
    page.write_text("\n".join([INTRO, *marked]), encoding="utf-8")


def parts_of(page: str) -> dict[str, str]:
    """The scenarios' parts of a page that `put` wrote."""
    return dict(re.findall(r"<!-- (\S+): begin -->\n(.*?)<!-- \1: end -->\n", page, re.DOTALL))


def ordered(names: Sequence[str] | dict[str, str]) -> list[str]:
    known = [name for name in ORDER if name in names]
    return [*known, *sorted(set(names) - set(known))]


def shrink(source: Path, target: Path) -> None:
    """A picture or an animation of at most MOST_BYTES: smaller, with fewer frames, in 256 colours."""
    for side in SIDES:
        with Image.open(source) as picture:
            frames = _smaller(picture, side)
        for step in (1, 2, 4) if len(frames) > 1 else (1,):
            _save(frames, step, target)
            if target.stat().st_size <= MOST_BYTES:
                return


def _smaller(picture: Any, side: int) -> list[Any]:
    """Its frames in one palette, that of the last."""
    scale = min(1.0, side / max(picture.size))
    size = tuple(round(scale * pixels) for pixels in picture.size)
    several = getattr(picture, "n_frames", 1) > 1
    how = Image.Resampling.NEAREST if several else Image.Resampling.LANCZOS
    frames = [frame.convert("RGB").resize(size, how) for frame in ImageSequence.Iterator(picture)]
    # Colours far apart, or robots' few pixels would take that of their neighbours.
    colours = frames[-1].quantize(255, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    return [frame.quantize(palette=colours, dither=Image.Dither.NONE) for frame in frames]


def _save(frames: list[Any], step: int, target: Path) -> None:
    """Every so many frames, counted back from the last."""
    first, *others = frames[::-1][::step][::-1]
    if others:
        first.save(
            target, save_all=True, append_images=others, loop=0, disposal=1, optimize=True,
            duration=[100 * step] * len(others) + [2500],
        )  # fmt: skip
    else:
        first.save(target, optimize=True)


def tell(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
