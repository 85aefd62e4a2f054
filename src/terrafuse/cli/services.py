"""`terrafuse station`, `robot`, `fleet`: nodes that run; `services`, `get`: how they fare."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from terrafuse.cli import arguments
from terrafuse.cli.asking import entry_json, operator_at, print_table, status_json, watch
from terrafuse.cli.commands import MODEL_HELP, SENSOR_HELP, WINDOW_HELP, Json
from terrafuse.cli.output import bytes_text, note, say, say_json
from terrafuse.cli.plugins import Plugins
from terrafuse.cli.running import run_nodes

if TYPE_CHECKING:
    from terrafuse.services.settings import FleetSettings

ADDRESS = "tcp/127.0.0.1:7447"

Model = Annotated[str, typer.Option(metavar="NAME[?SETTINGS]", help=MODEL_HELP)]
Resolution = Annotated[float, typer.Option(help="Side of a cell, metres.")]
Tile = Annotated[float | None, typer.Option(help="Side of a tile, metres.  [default: 40, or what cells fit into]")]
Crs = Annotated[str | None, typer.Option(help="CRS of the map, like EPSG:32632.")]
Factor = Annotated[int, typer.Option(help="Also exchange a global map of cells this many times as wide, first.")]
Budget = Annotated[float | None, typer.Option("--budget", metavar="BYTES_PER_S", help="What this node sends at most.")]
Keys = Annotated[
    Path | None, typer.Option(metavar="DIR", help="This node's keys, of 'terrafuse keys add': all goes encrypted.")
]
Insecure = Annotated[
    bool, typer.Option("--insecure", help="No encryption, no identity: whoever reaches the address is believed.")
]
Connect = Annotated[list[str], typer.Option(metavar="ADDRESS", help=f"Of the station, like {ADDRESS}; repeatable.")]
StationName = Annotated[str, typer.Option("--station", metavar="NAME", help="The station's name.")]


def station(
    store: Annotated[
        str, typer.Option(metavar="FILE|URL", help="Of the map; made if it is not there, else gone on with.")
    ],
    listen: Annotated[
        list[str], typer.Option(metavar="ADDRESS", help="Where robots find it, like tcp/0.0.0.0:7447; repeatable.")
    ],
    name: Annotated[str, typer.Option(help="Of this station, in the fleet.")] = "station",
    model: Model = "elevation",
    resolution: Resolution = 0.1,
    tile: Tile = None,
    crs: Crs = None,
    global_factor: Factor = 1,
    budget: Budget = None,
    upstream: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ADDRESS", help="Of a station above this one, which gets all that this one does; repeatable."
        ),
    ] = None,
    upstream_station: Annotated[str, typer.Option(metavar="NAME", help="That station's name.")] = "station",
    area: Annotated[
        str | None, typer.Option(metavar="W,S,E,N", help="Hold that station's map there, in STORE.global.db.")
    ] = None,
    relay: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME", help="With --insecure: a station below this one, say, believed for any robot; repeatable."
        ),
    ] = None,
    quota_rate: Annotated[
        float, typer.Option(metavar="BYTES_PER_S", help="What it takes of a robot at most, over half a minute.")
    ] = 5e6,
    quota_distance: Annotated[
        float | None,
        typer.Option(
            metavar="METRES", help="How far from itself a robot may report anything, more than its sensor sees."
        ),
    ] = None,
    keys: Keys = None,
    insecure: Insecure = False,
    plugin: Plugins = None,
    json: Json = False,
) -> int:
    """Run a station: where robots meet, and where their maps become one.

    It runs until it is stopped (Ctrl-C, SIGTERM); the same command goes on with the same map. Robots must be given the
    same --model, --resolution and --tile.
    """
    from terrafuse.services.settings import LinkPart, QuotasPart, StationPart

    quotas = QuotasPart(
        bytes_per_s=arguments.positive("--quota-rate", quota_rate, "bytes") or quota_rate,
        distance_m=arguments.positive("--quota-distance", quota_distance),
    )
    about = _map(model, resolution, tile, crs, global_factor)
    link = _link(listen=tuple(listen), keys=keys, insecure=insecure, kind=LinkPart)
    part = _checked_part(
        StationPart, name=name, store=str(_path(store)), bytes_per_s=arguments.positive("--budget", budget, "bytes"),
        quotas=quotas, upstream=tuple(upstream or ()), upstream_name=upstream_station,
        area_m=arguments.bounds(area, "--area"), relays=tuple(relay or ()),
    )  # fmt: skip
    return run_nodes(_settings(map=about, link=link, station=part), [name], json)


def robot(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Of this robot, in the fleet.")],
    source: Annotated[
        str,
        typer.Option(
            metavar="LOG|SCENARIO[/ROBOT]", help="What it senses: a log, or in a scenario as the robot of this name."
        ),
    ],
    connect: Annotated[
        list[str] | None, typer.Option(metavar="ADDRESS", help=f"Of the station, like {ADDRESS}; repeatable.")
    ] = None,
    listen: Annotated[
        list[str] | None, typer.Option(metavar="ADDRESS", help="Where other robots find it; repeatable.")
    ] = None,
    peer: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="A robot with which it exchanges maps, instead of a station; repeatable."),
    ] = None,
    store: Annotated[
        str | None,
        typer.Option(metavar="FILE|URL", help="Of its own map, and of what is still to send.  [default: NAME.db]"),
    ] = None,
    model: Model = "elevation",
    resolution: Resolution = 0.1,
    tile: Tile = None,
    crs: Crs = None,
    origin: Annotated[
        str | None, typer.Option(metavar="E,N", help="Where the origin of a log in a local frame lies, in the CRS.")
    ] = None,
    window: Annotated[str, typer.Option(help=WINDOW_HELP)] = "tiles3x3",
    sensor: Annotated[str | None, typer.Option(metavar="FILE", help=SENSOR_HELP)] = None,
    global_factor: Factor = 1,
    share: Annotated[
        str | None,
        typer.Option(help="Which map of the fleet it holds: coarse, fine or none.  [default: the coarsest there is]"),
    ] = None,
    precision: Annotated[
        str, typer.Option(help="Of what it reports: exact, full (all layers rounded) or lean (height and confidence).")
    ] = "exact",
    area: Annotated[
        str | None, typer.Option(metavar="W,S,E,N", help="Hold the fleet's map there, in NAME.global.db.")
    ] = None,
    area_radius: Annotated[
        float | None, typer.Option(metavar="METRES", help="The same, so far about where it is by now.")
    ] = None,
    station_name: StationName = "station",
    budget: Budget = None,
    realtime: Annotated[bool, typer.Option("--realtime", help="Scans come when their stamps say so.")] = False,
    keys: Keys = None,
    insecure: Insecure = False,
    plugin: Plugins = None,
    json: Json = False,
) -> int:
    """Run one robot: it senses, maps and reports, and ends when its source ends and all is at the station.

    Stopped before that (Ctrl-C, SIGTERM, a crash), what it had is in its store; the same command goes on from there.
    """
    from terrafuse.errors import InputError
    from terrafuse.services.settings import LinkPart, RobotPart, checked_name

    checked_name(name)
    if not (connect or listen):
        raise InputError("give --connect ADDRESS, of the station or of a robot, or --listen ADDRESS for other robots")
    if share not in (None, "coarse", "fine", "none"):
        raise InputError(f"--share {share}: give coarse, fine or none")
    if precision not in ("exact", "full", "lean"):
        raise InputError(f"--precision {precision}: give exact, full or lean")
    if share == "coarse" and global_factor == 1:
        raise InputError("--share coarse: there is a coarse map only with a --global-factor over 1")
    about = _map(
        model, resolution, tile, crs, global_factor,
        origin_m=arguments.numbers("--origin", origin, "EAST,NORTH"), window=window,
    )  # fmt: skip
    part = _checked_part(
        RobotPart,
        listen=tuple(listen or ()), peers=tuple(peer or ()),
        source=source, store=str(_path(store or f"{name}.db")), sensor=sensor, realtime=realtime,
        area_m=arguments.bounds(area, "--area"), area_radius_m=arguments.positive("--area-radius", area_radius),
        share=share, precision=precision, bytes_per_s=arguments.positive("--budget", budget, "bytes"),
    )  # fmt: skip
    link = _link(connect=tuple(connect or ()), keys=keys, insecure=insecure, kind=LinkPart)
    return run_nodes(_settings(map=about, link=link, stations=(station_name,), robots={name: part}), [name], json)


def fleet(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="What runs where: docs/services.md.")],
    node: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Only this node of it, here; repeatable.")
    ] = None,
    plugin: Plugins = None,
    json: Json = False,
) -> int:
    """Run the station and the robots of a file, all in this process, or those named.

    Ends when all robots here are done; without robots, when it is stopped.
    """
    from terrafuse.services.settings import chosen, load_fleet

    settings = load_fleet(file)
    return run_nodes(settings, chosen(settings, node or []), json)


def services(
    connect: Connect,
    station_name: StationName = "station",
    once: Annotated[bool, typer.Option("--once", help="Say it once, and end.")] = False,
    name: Annotated[str | None, typer.Option(help="Of this node; with --keys, the keys' own.")] = None,
    keys: Keys = None,
    insecure: Insecure = False,
    json: Json = False,
) -> None:
    """List every service of the fleet with its health and state, live: Ctrl-C ends it. --json says it once."""
    with operator_at(connect, station_name, name, keys, insecure) as asking:
        if json:
            say_json({"nodes": [entry_json(entry) for entry in asking.fleet()]})
        elif once or not sys.stdout.isatty():
            print_table(asking.fleet())
        else:
            watch(asking)


def get(
    service: Annotated[
        str, typer.Argument(metavar="NODE/SERVICE", help="As 'terrafuse services' lists it, like station/map-manager.")
    ],
    connect: Connect,
    layer: Annotated[
        str | None, typer.Option(metavar="LAYER", help="Of a map manager: bring this layer of its map into --out.")
    ] = None,
    area: Annotated[
        str | None, typer.Option(metavar="W,S,E,N", help="Of it this part, metres.  [default: all]")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="By its ending: .png, .tif, .npz or a ROS map's .yaml.")
    ] = None,
    map_: Annotated[str, typer.Option("--map", help="Which of its maps: fine or coarse.")] = "fine",
    sketch: Annotated[
        bool, typer.Option("--sketch", help="The station draws it: a bare .png, for thin links.")
    ] = False,
    station_name: StationName = "station",
    name: Annotated[str | None, typer.Option(help="Of this node; with --keys, the keys' own.")] = None,
    keys: Keys = None,
    insecure: Insecure = False,
    plugin: Plugins = None,
    json: Json = False,
) -> None:
    """Print what a service shows of itself; or, with --layer, bring a part of a station's map into a file.

    What is brought is what the station holds now, at full resolution: the same as 'terrafuse export' of its store.
    """
    from terrafuse.errors import InputError

    if layer is None:
        for option, given in {"--area": area, "--out": out, "--sketch": sketch or None}.items():
            if given is not None:
                raise InputError(f"{option} is for a layer of a map: give --layer, too")
    elif out is None:
        raise InputError("--layer: say where to, --out FILE.png, .tif, .npz or .yaml")
    with operator_at(connect, station_name, name, keys, insecure) as asking:
        value = _shown(asking, service)
        if layer is not None:
            assert out is not None
            if service != f"{station_name}/map-manager":
                raise InputError(f"{service} hands out no map: '{station_name}/map-manager' does")
            value = _brought(asking, value["state"], map_, layer, arguments.bounds(area, "--area"), out, sketch)
    if json:
        say_json(value)
    elif layer is not None:
        say(f"wrote {out}: {value['layer']}, {value['tiles']} tiles, {bytes_text(value['bytes'])} came")
    else:
        from json import dumps

        say(dumps(value, indent=1, allow_nan=False))


def _shown(asking: Any, service: str) -> dict[str, Any]:
    from terrafuse.errors import InputError

    found = {f"{entry.node}/{status.name}": (entry, status) for entry in asking.fleet() for status in entry.services}
    if service not in found:
        raise InputError(f"no service '{service}'; there are {', '.join(found)}")
    entry, status = found[service]
    return status_json(status) | {"node": entry.node, "age_s": round(entry.age_s, 1), "lost": entry.lost}


def _brought(
    asking: Any, state: dict[str, Any], channel: str, layer: str, area: Any, out: Path, drawn: bool
) -> dict[str, Any]:
    """A part of the station's map, in a file. What is wrong with what was asked is said before anything comes."""
    from terrafuse.errors import InputError
    from terrafuse.export import export_map, format_of
    from terrafuse.export.files import final
    from terrafuse.services import fetch
    from terrafuse.views import chosen_layers

    whole = fetch.map_of(state, channel)
    (chosen,) = chosen_layers(whole, [layer])
    if drawn and format_of(out) != "png":
        raise InputError(f"--sketch --out {out}: a sketch is a picture; name it .png")
    if drawn:
        picture, area = fetch.sketch(asking, channel, layer, area)
        with final(out) as partial:
            partial.write_bytes(picture)
        return {"out": str(out), "layer": layer, "area": list(area), "tiles": 0, "bytes": len(picture)}
    format_of(out)
    came = fetch.fetch(asking, whole, channel, chosen, area)
    export_map(came.replica, out, layers=[layer], bounds=area)
    return {"out": str(out), "layer": layer, "area": list(came.area), "tiles": came.tiles, "bytes": came.nbytes}


def correct(
    robot: Annotated[str, typer.Argument(metavar="ROBOT", help="Whose poses they are.")],
    connect: Connect,
    shift_east: Annotated[float, typer.Option(metavar="METRES", help="Move them so far east,")] = 0.0,
    shift_north: Annotated[float, typer.Option(metavar="METRES", help="north,")] = 0.0,
    shift_up: Annotated[float, typer.Option(metavar="METRES", help="and up.")] = 0.0,
    turn_deg: Annotated[
        float, typer.Option(metavar="DEGREES", help="Turn them before that, counterclockwise, about --about.")
    ] = 0.0,
    about: Annotated[
        str | None,
        typer.Option(metavar="E,N", help="About which place, metres.  [default: the map's origin, of a local frame]"),
    ] = None,
    since: Annotated[
        str | None, typer.Option(metavar="TIME", help="From then on: seconds since 1970, or 2026-05-03T10:15:00.")
    ] = None,
    until: Annotated[str | None, typer.Option(metavar="TIME", help="Until then; that itself not.")] = None,
    id_: Annotated[
        str | None, typer.Option("--id", help="Takes the place of the correction of this name.  [default: a new one]")
    ] = None,
    station_name: StationName = "station",
    name: Annotated[str | None, typer.Option(help="Of this node; with --keys, the keys' own.")] = None,
    keys: Keys = None,
    insecure: Insecure = False,
    json: Json = False,
) -> None:
    """Correct a robot's poses: its station tells it, and it makes its map anew from its own log.

    Corrections add up, in the order in which they were given: look at the map, and correct what is still wrong. The
    station keeps them until the robot is there; the robot keeps them as long as its map.
    """
    import secrets

    from terrafuse.cli import correcting
    from terrafuse.errors import InputError
    from terrafuse.exchange.corrections import Correction

    from_ns, until_ns = _stamp("--since", since, 0), _stamp("--until", until, 2**63 - 1)
    if from_ns >= until_ns:
        raise InputError(f"--since {since} --until {until}: there is no time between them")
    how = correcting.checked(robot, (shift_east, shift_north, shift_up), turn_deg, about, id_)
    with operator_at(connect, station_name, name, keys, insecure) as asking:
        known = correcting.look_up(asking.fleet(), station_name, robot)
        motion = how.motion(known)
        one = Correction(id_ or secrets.token_hex(6), time.time_ns(), from_ns, until_ns, motion)
        holds = asking.correct(robot, [one])
    if known.warning:
        note(f"warning: {known.warning}")
    if json:
        say_json({"robot": robot, "id": one.id, "corrections": holds, "reached": known.reached})
    else:
        say(f"correction {one.id}{how.turned}: '{station_name}' has it, and {known.tells}; {holds} in all")


def _stamp(option: str, text: str | None, default: int) -> int:
    """A time as nanoseconds since 1970: no float could hold them."""
    from datetime import UTC, datetime, timedelta
    from decimal import Decimal

    from terrafuse.errors import InputError

    if text is None:
        return default
    try:
        stamp = int(Decimal(text) * 10**9)
    except (ArithmeticError, ValueError):
        try:
            when = datetime.fromisoformat(text)
        except ValueError:
            raise InputError(f"{option} {text}: give seconds since 1970, or a time like 2026-05-03T10:15:00") from None
        when = when if when.tzinfo else when.replace(tzinfo=UTC)
        stamp = (when - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(microseconds=1) * 1000
    if not 0 <= stamp < 2**63:
        raise InputError(f"{option} {text}: give a time after 1970 and before 2262")
    return stamp


# --- what was asked for -----------------------------------------------------------------------------------------------


def _map(model: str, resolution: float, tile: float | None, crs: str | None, factor: int, **more: Any) -> Any:
    from terrafuse.config import map_settings

    name, model_settings = arguments.model(model)
    return map_settings(
        model=name, model_settings=model_settings, resolution_m=arguments.positive("--resolution", resolution),
        tile_m=arguments.positive("--tile", tile), crs=crs, global_factor=factor, **more,
    )  # fmt: skip


def _link(kind: Callable[..., Any], keys: Path | None, **values: Any) -> Any:
    return kind(keys=None if keys is None else str(keys), **values)


def _path(store: str) -> Path:
    """`map.db`, or `sqlite:///map.db`; with a fourth slash the path is absolute."""
    from terrafuse.errors import InputError

    scheme, divider, path = store.partition(":///")
    if divider and scheme != "sqlite":
        raise InputError(f"--store {store}: stores are SQLite files; give a path, or sqlite:///PATH")
    return arguments.store_file(Path(path if divider else store))


def _settings(**parts: Any) -> FleetSettings:
    from terrafuse.services.settings import FleetSettings

    settings: FleetSettings = _checked_part(FleetSettings, **parts)
    return settings


def _checked_part(kind: Callable[..., Any], **values: Any) -> Any:
    from pydantic import ValidationError

    from terrafuse.errors import InputError
    from terrafuse.services.settings import words_of

    try:
        return kind(**values)
    except ValidationError as error:
        raise InputError(words_of(error)) from error
