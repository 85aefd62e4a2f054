"""The commands, each a thin shell around a function of the library."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from terrafuse.cli import arguments
from terrafuse.cli.output import bytes_text, count_text, log_progress, rate_text, say, say_json, tell_of_compiling
from terrafuse.cli.plugins import Plugins

Json = Annotated[bool, typer.Option("--json", help="One JSON object on stdout instead of text.")]
Out = Annotated[Path, typer.Option("--out", help="Folder for the results.")]
StoreFile = Annotated[Path, typer.Argument(metavar="STORE", help="A store: the map.db of a mapping run.")]
SPARSE = 1.5
"""Points a cell, in the mean, below which a map is more gap than surface."""
LOG_HELP = (
    "A robot's name and its log: a ROS 1/2 bag or MCAP file, a KITTI folder, a folder of clouds with a TUM trajectory, "
    "LAS/LAZ, a CARMEN log, an Argoverse 2 log. Options follow the path: r1=drive.mcap?topic=/lidar"
)

MODEL_HELP = (
    "Cell model: elevation, grey, occupancy or terrain, with its settings after a '?', as in "
    "'terrain?half_life_s=60&max_slope=0.4'. 'terrafuse models' lists them."
)

WINDOW_HELP = (
    "Tiles that a robot keeps in memory: tiles3x3, nine_block, radius?range_m=50&period_s=0.1&speed_mps=20, "
    "centred?cells=320 or all. The numbers are the defaults."
)

SENSOR_HELP = (
    "The sensor's description: a YAML file or the name of a preset, for all robots or for one, like r1=my.yaml; "
    "repeatable. docs/sensors.md lists the presets, and so does a name that there is none of."
)


def map_(
    logs: Annotated[list[str], typer.Argument(metavar="NAME=LOG…", help=LOG_HELP)],
    out: Out,
    model: Annotated[str, typer.Option(metavar="NAME[?SETTINGS]", help=MODEL_HELP)] = "elevation",
    resolution: Annotated[float, typer.Option(help="Side of a cell, metres.")] = 0.1,
    tile: Annotated[
        float | None,
        typer.Option(help="Side of a tile, metres; a whole number of cells.  [default: 40, or what cells fit into]"),
    ] = None,
    crs: Annotated[str | None, typer.Option(help="CRS of the map, like EPSG:32632.  [default: the logs' own]")] = None,
    origin: Annotated[
        str | None, typer.Option(metavar="E,N", help="Where the origin of logs in a local frame lies, in the CRS.")
    ] = None,
    window: Annotated[str, typer.Option(help=WINDOW_HELP)] = "tiles3x3",
    prior: Annotated[
        list[str] | None,
        typer.Option(metavar="FILE", help="What is known beforehand: a DEM, or GeoJSON polygons; repeatable."),
    ] = None,
    global_factor: Annotated[
        int, typer.Option(help="Also make a global map of cells this many times as wide: global.tif, global.png.")
    ] = 1,
    max_range: Annotated[
        float | None,
        typer.Option(help="Drop points further than this from the sensor, metres.  [default: the model's own]"),
    ] = None,
    sensor: Annotated[list[str] | None, typer.Option(metavar="[NAME=]FILE", help=SENSOR_HELP)] = None,
    static: Annotated[
        bool, typer.Option("--static", help="Plain statistics: nothing moves, no ghosts to remove.")
    ] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the map that is in the folder.")] = False,
    plugin: Plugins = None,
    json: Json = False,
) -> None:
    """Map the logs of one or several robots into one shared map.

    Writes map.db (the store), map.tif (a multi-band Cloud Optimized GeoTIFF), map.png, report.html and report.json.
    A run that was cut short goes on when it is started again.
    """
    from terrafuse import config, mapping, results

    tell_of_compiling()
    named = arguments.robots(logs)
    model_name, model_settings = arguments.model(model, static, max_range)
    settings = config.map_settings(
        model=model_name,
        model_settings=model_settings,
        resolution_m=arguments.positive("--resolution", resolution),
        tile_m=arguments.positive("--tile", tile),
        crs=crs,
        origin_m=arguments.numbers("--origin", origin, "EAST,NORTH"),
        window=window,
        prior=prior,
        global_factor=global_factor,
        sensors=arguments.by_robot("--sensor", sensor or (), named),
    )
    plan = mapping.plan(named, settings)
    with log_progress() as progress:
        report = results.run(plan, out, overwrite=overwrite, progress=progress, stage=progress.stage)
    if json:
        say_json(report)
    else:
        _tell_map(report, out)


def _tell_map(report: dict[str, Any], out: Path) -> None:
    for name, robot in report["robots"].items():
        lost = [f"{n} not placed ({reason})" for reason, n in robot["skipped"].items()]
        note = "".join(f", {text}" for text in lost)
        say(
            f"{name}: {robot['scans']} scans{note}, {count_text(robot['points'])}points, "
            f"{robot['distance_m']:.0f} m, deltas {bytes_text(report['delta_bytes_per_robot'][name])}"
        )
        _tell_window(robot)
    say(
        f"map: {report['cells']:,} cells of {report['map']['resolution_m']:g} m in {report['tiles']} tiles, "
        f"{rate_text(report['points_per_second'])}"
    )
    _tell_tile(report)
    if "global" in report:
        coarse = report["global"]
        say(f"global map: {coarse['cells']:,} cells of {coarse['map']['resolution_m']:g} m")
    n = report["layers"].get("n", {}).get("mean")
    if n is not None and n < SPARSE:
        say(f"hint: {n:.1f} points a cell leave gaps; a coarser --resolution gives a fuller map")
    say("wrote " + ", ".join(str(out / file) for file in report["files"].values()))


def _tell_tile(report: dict[str, Any]) -> None:
    """Where the tile is not the usual one, and nobody asked for it."""
    from terrafuse.lattice import default_tile_m

    resolution_m, tile_m = report["map"]["resolution_m"], report["map"]["tile_m"]
    usual_m = default_tile_m(resolution_m)
    if report["settings"]["tile_m"] is None and tile_m != usual_m:
        say(f"tiles of {tile_m:g} m, as cells do not fit into the usual {usual_m:g} m; --tile chooses others")


def _tell_window(robot: dict[str, Any]) -> None:
    held = robot["allocation"]
    say(
        f"  window: {held['window_cells']:,} cells, {held['observed_of_window']:.1%} of them observed; "
        f"allocated {held['allocated_cells']:,}, {held['observed_of_allocated']:.1%} observed; "
        f"at most {robot['most_resident']} tiles in memory, {robot['loads']} loaded, {robot['writes']} written"
    )


def info(store: StoreFile, plugin: Plugins = None, json: Json = False) -> None:
    """Show what a store holds: its map, its robots, the layers' ranges."""
    from terrafuse.replica import Replica
    from terrafuse.results import delta_bytes, map_facts
    from terrafuse.store.sqlite import SqliteStore

    tell_of_compiling()
    with SqliteStore.open(arguments.store_file(store)) as opened:
        facts = map_facts(Replica(store=opened))
        history, size = opened.history(), delta_bytes(opened)
        facts["robots"] = {
            name: {
                "revision": opened.revision(name),
                "deltas": sum(entry.robot == name for entry in history),
                "delta_bytes": size[name],
                "poses": len(opened.poses(name)),
            }
            for name in opened.robots()
        }
    if json:
        say_json(facts)
    else:
        _tell_info(facts)


def _tell_info(facts: dict[str, Any]) -> None:
    about = facts["map"]
    say(f"model {about['model']}, {about['resolution_m']:g} m cells in {about['tile_m']:g} m tiles")
    say(f"frame {about['crs'] or 'local, metres'}")
    say(f"{facts['cells']:,} cells in {facts['tiles']} tiles, bounds {facts['bounds']}")
    say(f"digest {about['digest']}")
    for name, robot in facts["robots"].items():
        say(f"{name}: revision {robot['revision']}, {robot['deltas']} deltas, {bytes_text(robot['delta_bytes'])}")
    for name, layer in facts["layers"].items():
        if layer["cells"]:
            say(f"  {name:14} {layer['min']:12.4g} … {layer['mean']:12.4g} … {layer['max']:12.4g} {layer['unit']}")


def export(
    store: StoreFile,
    out: Annotated[Path, typer.Option("--out", help="The file to write.")],
    format: Annotated[
        str | None, typer.Option(help="cog, png, npz or ros-map.  [default: by the file's ending]")
    ] = None,
    layer: Annotated[
        list[str] | None, typer.Option(help="A layer; repeatable.  [default: all; ros-map: how surely occupied]")
    ] = None,
    bounds: Annotated[str | None, typer.Option(metavar="W,S,E,N", help="Part of the map, metres.")] = None,
    only: Annotated[list[str] | None, typer.Option(metavar="ROBOT", help="Only this robot's part; repeatable.")] = None,
    without: Annotated[
        list[str] | None, typer.Option(metavar="ROBOT", help="Leave this robot out; repeatable.")
    ] = None,
    mode: Annotated[
        str | None, typer.Option(help="ros-map: trinary, scale or raw.  [default: as imported, else trinary]")
    ] = None,
    occupied_thresh: Annotated[
        float | None, typer.Option(help="ros-map: occupied from here on.  [default: as imported, 0.65; scale 1]")
    ] = None,
    free_thresh: Annotated[
        float | None, typer.Option(help="ros-map: free up to here.  [default: as imported, 0.196; scale 0]")
    ] = None,
    negate: Annotated[bool | None, typer.Option(help="ros-map: black is free.  [default: as imported, no]")] = None,
    plugin: Plugins = None,
    json: Json = False,
) -> None:
    """Write a map, or a part or some layers of it, for other tools."""
    from terrafuse.errors import InputError
    from terrafuse.export import export_map
    from terrafuse.replica import Replica, check_robots
    from terrafuse.store.sqlite import SqliteStore

    tell_of_compiling()
    part = arguments.bounds(bounds)
    arguments.store_file(store)
    if out.exists() and store.exists() and out.samefile(store):
        raise InputError(f"{out}: that is the store itself; choose another --out")
    with SqliteStore.open(store) as opened:
        check_robots(opened, [*(only or []), *(without or [])])
        replica = Replica(store=opened, only=only, without=without or ())
        ros = {"mode": mode, "occupied_thresh": occupied_thresh, "free_thresh": free_thresh, "negate": negate}
        written = export_map(replica, out, format=format, layers=layer, bounds=part, **ros)
    if json:
        say_json({"out": str(out), "format": written})
    else:
        say(f"wrote {out}")
