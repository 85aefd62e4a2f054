"""`terrafuse import`: a map from elsewhere in."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from terrafuse.cli import arguments
from terrafuse.cli.output import say, say_json, tell_of_compiling
from terrafuse.cli.plugins import Plugins
from terrafuse.errors import InputError


def import_(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="A ROS map (its .yaml), or a raster of heights (GeoTIFF and others).")
    ],
    out: Annotated[Path, typer.Option("--out", help="The store to make, like map.db.")],
    name: Annotated[str, typer.Option(help="The robot as whose contribution it comes in.")] = "import",
    crs: Annotated[
        str | None, typer.Option(help="CRS that a ROS map is in, or that --resample brings a raster to.")
    ] = None,
    tile: Annotated[
        float | None, typer.Option(help="Side of a tile, metres.  [default: about 40, a whole number of cells]")
    ] = None,
    resample: Annotated[
        bool, typer.Option("--resample", help="Where it does not lie on the cells, give each the nearest pixel.")
    ] = False,
    resolution: Annotated[
        float | None, typer.Option(help="With --resample: side of a cell, metres.  [default: the file's]")
    ] = None,
    band: Annotated[
        str | None, typer.Option(help="Of a raster: number from 1 or name.  [default: 'height', else 1]")
    ] = None,
    nodata: Annotated[float | None, typer.Option(help="Of a raster that does not say which value is unknown.")] = None,
    time: Annotated[
        str | None,
        typer.Option(metavar="TIME", help="When it was measured, like 2026-05-01T12:00Z.  [default: before all scans]"),
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the store that is there.")] = False,
    plugin: Plugins = None,
    json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout instead of text.")] = False,
) -> None:
    """Take in a ROS map (as an occupancy map) or a raster of heights (as an elevation map), as one robot's part.

    A ROS map that is imported and exported again has the same pixels and the same numbers.
    """
    from terrafuse.imports import Wishes, import_map

    tell_of_compiling()
    cells_m, tile_m = arguments.positive("--resolution", resolution), arguments.positive("--tile", tile)
    wishes = Wishes(_robot(name), _stamp_ns(time), crs, tile_m, resample, cells_m, band, nodata)
    done = import_map(file, out, wishes, overwrite)
    if json:
        say_json(done)
        return
    for remark in done["remarks"]:
        say(remark)
    say(f"{done['robot']}: {done['cells']:,} {done['model']} cells of {done['resolution_m']:g} m")
    say(f"wrote {out}")


def _robot(name: str) -> str:
    from terrafuse.exchange.delta import MAX_NAME, is_robot_name

    if not is_robot_name(name):
        raise InputError(f"--name '{name}': give a robot's name of 1 to {MAX_NAME} printable characters")
    return name


def _stamp_ns(text: str | None) -> int:
    """ISO 8601 → nanoseconds since 1970; UTC where no zone is given."""
    if text is None:
        return 0
    try:
        moment = datetime.fromisoformat(text)
    except ValueError as error:
        raise InputError(f"--time {text}: give a date and time like 2026-05-01T12:00Z") from error
    aware = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    stamp_ns = round(aware.timestamp() * 1e6) * 1000
    if stamp_ns < 0:
        raise InputError(f"--time {text}: stamps start in 1970; give a later one")
    return stamp_ns
