"""`terrafuse compare`: how two maps differ."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from terrafuse.cli import arguments
from terrafuse.cli.output import say, say_json, tell_of_compiling
from terrafuse.cli.plugins import Plugins

MAP_HELP = "A store, a raster (GeoTIFF) or a ROS map (its .yaml)."


def compare_(
    a: Annotated[Path, typer.Argument(metavar="A", help=MAP_HELP)],
    b: Annotated[Path, typer.Argument(metavar="B", help=MAP_HELP + " The truth, if one of them is.")],
    layer: Annotated[
        str | None, typer.Option(help="Layer of the stores.  [default: height, or how surely occupied]")
    ] = None,
    band: Annotated[
        str | None,
        typer.Option(help="Band of the rasters: number from 1 or name.  [default: as --layer, 'height', else 1]"),
    ] = None,
    bounds: Annotated[str | None, typer.Option(metavar="W,S,E,N", help="Part of A to look at, metres.")] = None,
    occupied_thresh: Annotated[float, typer.Option(help="Probability from which a cell is occupied.")] = 0.65,
    free_thresh: Annotated[float, typer.Option(help="Probability up to which it is free.")] = 0.196,
    out: Annotated[
        Path | None, typer.Option("--out", help="Picture of the differences: a .png, or a folder for difference.png.")
    ] = None,
    plugin: Plugins = None,
    json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout instead of text.")] = False,
) -> None:
    """Show how two maps differ: errors of heights, or agreement on what is free and what occupied.

    B is looked up at the centres of A's cells, the nearest value; differences are A − B.
    """
    from terrafuse.compare import Question, compare_maps

    tell_of_compiling()
    question = Question(layer, band, arguments.bounds(bounds), occupied_thresh, free_thresh)
    result = compare_maps(a, b, question, out)
    if json:
        say_json(result)
        return
    say(f"A {a}: {result['a']['what']}")
    say(f"B {b}: {result['b']['what']}")
    for remark in result["remarks"]:
        say(f"note: {remark}")
    (_tell_values if result["kind"] == "values" else _tell_occupancy)(result)
    if "picture" in result:
        say(f"wrote {result['picture']}")


def _tell_values(result: dict[str, Any]) -> None:
    unit = result["unit"]
    _tell_cells(result)
    say(f"\nA − B ({unit})")
    for name, words in (
        ("rmse", "RMSE"),
        ("bias", "bias (mean)"),
        ("median_abs", "median of |A − B|"),
        ("p95_abs", "95 % of |A − B| within"),
        ("max_abs", "largest |A − B|"),
    ):
        say(f"  {words:24}{result[name]:12.4g}")


def _tell_cells(result: dict[str, Any]) -> None:
    cells = result["cells"]
    say(f"\n{'cells of A':26}{cells['looked_at']:>12,}")
    say(f"  {'known in A':24}{cells['a']:>12,}")
    say(f"  {'known in B':24}{cells['b']:>12,}")
    say(f"  {'known in both':24}{cells['both']:>12,}  {_share(result['overlap'])} of those known in either")
    say(f"  {'B is covered by A to':24}{_share(result['completeness_a']):>12}")
    say(f"  {'A is covered by B to':24}{_share(result['completeness_b']):>12}")


def _tell_occupancy(result: dict[str, Any]) -> None:
    kinds = ("free", "occupied", "unknown")
    _tell_cells(result)
    say("\n" + f"{'cells':14}" + "".join(f"{f'B {kind}':>14}" for kind in kinds))
    for kind in kinds:
        row = result["table"][kind]
        say(f"{f'A {kind}':14}" + "".join(f"{row[other]:>14,}" for other in kinds))
    say(f"\n{'agreement on cells known in both':34}{_share(result['agreement']):>10}")
    for kind in kinds[:2]:
        for name in "ab":
            say(f"  {f'on what {name.upper()} calls {kind}':32}{_share(result[f'agreement_{kind}_{name}']):>10}")


def _share(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:.2f} %"
