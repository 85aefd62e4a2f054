"""Nodes, put together: which services a robot and a station consist of."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path

from terrafuse.errors import StoreMismatch
from terrafuse.exchange.channel import unheard
from terrafuse.exchange.courier import Channel, CourierSettings
from terrafuse.exchange.delta import map_id
from terrafuse.exchange.globals import GlobalMap
from terrafuse.exchange.links import Link
from terrafuse.lattice import Lattice
from terrafuse.mapping import open_partial, plan, tile_for
from terrafuse.models import make_model
from terrafuse.models.base import Model
from terrafuse.replica import Replica
from terrafuse.services.answers import Answers
from terrafuse.services.carriers import Carrier
from terrafuse.services.directory import DIRECTORY, Directory
from terrafuse.services.exchange import EXCHANGE, MAP_MANAGER, About, Exchange, Told
from terrafuse.services.gate import Gate, Roll
from terrafuse.services.held import Held
from terrafuse.services.lock import alone
from terrafuse.services.mapping import Mapping as MappingService
from terrafuse.services.places import Place
from terrafuse.services.ports import Handover, Letterbox, ScanPort
from terrafuse.services.precision import keep_to, projection
from terrafuse.services.service import DONE, Message, Status
from terrafuse.services.settings import FleetSettings, QuotasPart, RobotPart, StationPart
from terrafuse.services.simulated import source_text
from terrafuse.services.source import Source
from terrafuse.services.supervise import Orchestration, Restarts, Spec, Supervisor
from terrafuse.store.base import Store
from terrafuse.store.memory import MemoryStore
from terrafuse.store.sqlite import SqliteStore, removed_if_empty
from terrafuse.types import Bounds

ALWAYS = Restarts(most=None)
ORCHESTRATION = "orchestration"
FINE, COARSE, GLOBAL = "fine", "coarse", "global"
MESSAGE_S, CELL_BYTES = 0.5, 10
"""What a message may take of a link, and a cell about takes of a message."""
LEAST_CELLS, MOST_CELLS = 2048, 1 << 16
FRAMES_SHARE = 0.97
"""Of the budget; signs of life, and what confirms others' segments, take less than the rest. It also keeps a link that
is just as fast as the budget from filling up, where nothing urgent could overtake."""


@dataclass(eq=False)
class Node:
    """A node with its services, and the stores that it holds open; `close` once the services have left."""

    name: str
    supervisor: Supervisor
    ends_with: str | None
    """The service with which the node's work is done; None: it never is."""
    files: ExitStack = field(default_factory=ExitStack)

    @property
    def statuses(self) -> dict[str, Status]:
        return {status.name: status for status in self.supervisor.statuses}

    @property
    def done(self) -> bool:
        return self.ends_with is not None and self.statuses[self.ends_with].health == DONE

    def close(self) -> None:
        self.files.close()


def make_node(settings: FleetSettings, name: str, carrier: Carrier, upstream: Callable[[], Link] | None = None) -> Node:
    """A node of these settings by its name. Raises InputError and its kin before anything runs.

    `upstream` makes the station's link to the one above it, if there is one.
    """
    with ExitStack() as files:
        if settings.station is not None and name == settings.station.name:
            node = _station(settings, settings.station, carrier, upstream, files)
        else:
            node = _robot(settings, name, carrier, files)
        node.files = files.pop_all()
    return node


def _station(
    settings: FleetSettings,
    part: StationPart,
    carrier: Carrier,
    upstream: Callable[[], Link] | None,
    files: ExitStack,
) -> Node:
    """Map manager, directory, and the mapping orchestration over them; with a station above it, an exchange with it."""
    files.enter_context(alone(Path(part.store)))
    store = files.enter_context(open_map(Path(part.store), settings))
    factor = settings.map.global_factor
    coarse = _coarse_file(files, Path(part.store), store, factor) if factor > 1 else None
    letters = Letterbox()
    pace = _pace(part.bytes_per_s)
    about = About(store.map.lattice, store.model, factor)

    maps = {FINE: store} if coarse is None else {COARSE: coarse, FINE: store}
    keys = None if settings.link.keys is None else settings.link.keys.replace("{node}", part.name)
    gate = Gate(list(maps.values()), part.quotas, keys, part.relays)

    replicas = {name: Replica(store=map_) for name, map_ in maps.items()}
    folded = GlobalMap(part.name, replicas[FINE])

    def channels() -> Sequence[Channel]:
        heard = {FINE: folded.changed}
        some = [gate.channel(name, k, map_, heard.get(name, unheard)) for k, (name, map_) in enumerate(maps.items())]
        return [*some, Channel(GLOBAL, own=folded, near=True)]

    link = carrier(part.name)
    specs = [
        Spec(
            MAP_MANAGER,
            lambda: Exchange(
                MAP_MANAGER,
                about,
                link,
                channels,
                pace,
                letters,
                supervisor.send,
                hear=gate.hear,
                fold=folded.update,
                answers=Answers(part.name, replicas),
                book=Path(part.store).with_suffix(".corrections"),
                may_correct=gate.may_correct,
                grant=gate.grant,
                within=gate.within,
            ),
            restarts=ALWAYS,
        ),
    ]
    above: tuple[str, ...] = ()
    written = letters  # the map manager takes from `letters`, which therefore stays what it is
    if upstream is not None:
        outgoing, above = Letterbox(), (part.upstream_name,)
        specs.append(_uplink(part, about, upstream, maps, files, pace, outgoing, lambda: supervisor))
        written = letters.forked(part.upstream_name, outgoing)
    specs += _common("terrafuse/mapping-orchestration", lambda: supervisor, part.name, written, above, pace.bytes_per_s)
    supervisor = Supervisor(specs)
    return Node(part.name, supervisor, None)


def _uplink(
    part: StationPart,
    about: About,
    link: Callable[[], Link],
    maps: Mapping[str, Store],
    files: ExitStack,
    pace: CourierSettings,
    letters: Letterbox,
    supervisor: Callable[[], Supervisor],
) -> Spec:
    """Passes on what the station holds to the one above it, and holds that one's map where it is asked to."""
    near = None if part.area_m is None else _beside(files, Path(part.store), GLOBAL, maps[FINE])

    def channels() -> Sequence[Channel]:
        told = [Channel(name, store, relay=True, deaf=True) for name, store in maps.items()]
        return told if near is None else [*told, Channel(GLOBAL, near, near=True)]

    return Spec(
        EXCHANGE,
        lambda: Exchange(
            EXCHANGE,
            about,
            link,
            channels,
            pace,
            letters,
            supervisor().send,
            peers=[part.upstream_name],
            joins=True,
            area=None if part.area_m is None else Bounds(*part.area_m),
        ),
        restarts=ALWAYS,
    )


def _robot(settings: FleetSettings, name: str, carrier: Carrier, files: ExitStack) -> Node:
    """Source, mapping, exchange, directory, and the robot orchestration over them.

    Two threads: `mapping` has the source and the mapper, `network` all else. They share the archive and the ports.
    """
    part = settings.robots[name]
    sensors = {} if part.sensor is None else {name: part.sensor}
    run = plan({name: source_text(part.source, name)}, settings.map.model_copy(update={"sensors": sensors}))
    files.enter_context(alone(Path(part.store)))
    archive = files.enter_context(open_partial(Path(part.store), run, afresh="choose another --store"))
    keep_to(part.precision, Path(part.store), archive)
    project = projection(part.precision, run.model)
    factor = settings.map.global_factor
    share = part.share or (COARSE if factor > 1 else FINE)
    port, handover, letters = ScanPort(), Handover(), Letterbox()
    told = Told(
        archive, handover, MemoryStore(run.lattice.coarser(factor), run.model) if factor > 1 else None,
        area=_area(part), among_robots=bool(part.peers),
    )  # fmt: skip
    near = _beside(files, Path(part.store), GLOBAL, archive) if part.area_m or part.area_radius_m else None
    replica = _beside(files, Path(part.store), "replica", archive) if share == FINE else None
    pace = _pace(part.bytes_per_s)
    reports_to = part.peers or settings.reported_to
    keys = None if settings.link.keys is None else settings.link.keys.replace("{node}", name)
    about = About(run.lattice, run.model, factor)
    whole = MemoryStore(run.lattice.coarser(factor), run.model) if share == COARSE and factor > 1 else None

    def among(channel: Channel) -> Channel:
        """Among robots alone, each passes on what it holds, and is guarded like a station. One that only connects has
        no list of who may report whom; the one that it connects to has, and lets through what that allows."""
        if not part.peers or channel.store is None:
            return channel
        listed = keys if keys is not None and Roll(Path(keys)).exists else None
        gate = Gate([channel.store], QuotasPart(), listed, part.peers if listed is None else ())
        return replace(gate.channel(channel.name, 0, channel.store), own=channel.own, project=channel.project)

    def channels() -> Sequence[Channel]:
        fine = among(Channel(FINE, replica, Held(archive, name, archive.unchanged), project=project))
        some = [fine] if near is None else [fine, Channel(GLOBAL, near, near=True)]
        if told.coarse is None:
            return some
        return [among(Channel(COARSE, whole, Held(told.coarse, name), project=project)), *some]

    shown = {FINE: archive, COARSE: told.coarse, GLOBAL: near}
    answers = Answers(name, {what: Replica(store=map_) for what, map_ in shown.items() if map_ is not None})
    link = carrier(name)
    specs = [
        Spec("source", lambda: Source(run, name, port, part.realtime, told.track), thread="mapping"),
        Spec(
            "mapping",
            lambda: MappingService(
                run,
                name,
                archive,
                port,
                handover,
                Path(part.store),
                lambda: supervisor.send("source", Message(Source.contract.id, "begin")),
            ),
            thread="mapping",
        ),
        Spec(
            EXCHANGE,
            lambda: Exchange(
                EXCHANGE,
                about,
                link,
                channels,
                pace,
                letters,
                supervisor.send,
                peers=reports_to,
                told=told,
                answers=answers,
                book=Path(part.store).with_suffix(".corrections"),
            ),
            restarts=ALWAYS,
        ),
        *_common("terrafuse/robot-orchestration", lambda: supervisor, name, letters, reports_to, pace.bytes_per_s),
    ]
    supervisor = Supervisor(specs)
    return Node(name, supervisor, EXCHANGE)


def _common(
    contract: str,
    supervisor: Callable[[], Supervisor],
    node: str,
    letters: Letterbox,
    report_to: Sequence[str],
    bytes_per_s: float,
) -> list[Spec]:
    """What every node has."""
    return [
        Spec(
            DIRECTORY,
            lambda: Directory(node, lambda: supervisor().statuses, letters, report_to, bytes_per_s),
            restarts=ALWAYS,
        ),
        Spec(ORCHESTRATION, lambda: Orchestration(contract, supervisor), restarts=ALWAYS),
    ]


def _pace(bytes_per_s: float | None) -> CourierSettings:
    """Messages wait for each other's acknowledgement: fast links take large ones."""
    if bytes_per_s is None:
        return CourierSettings(overhears=False, message_cells=MOST_CELLS)
    cells = min(max(round(bytes_per_s * MESSAGE_S / CELL_BYTES), LEAST_CELLS), MOST_CELLS)
    return CourierSettings(bytes_per_s=FRAMES_SHARE * bytes_per_s, overhears=False, message_cells=cells)


def open_map(path: Path, settings: FleetSettings) -> SqliteStore:
    """The station's store: new, or the one that is there, which must be of the map that the settings say, if it holds
    anything."""
    lattice, model = _map_of(settings)
    if not path.exists():
        return SqliteStore.create(path, lattice, model)
    store = SqliteStore.open(path)
    if (store.map.model, store.map.lattice, store.model.settings()) != (model.name, lattice, model.settings()):
        held = store.map
        if removed_if_empty(store):
            return open_map(path, settings)
        raise StoreMismatch(
            f"{path}: holds a map of {held.model}, cells of {held.resolution_m:g} m, tiles of {held.tile_m:g} m, "
            f"{held.crs or 'a local frame'}, or with other settings; ask for the same, or choose another store"
        )
    return store


def _map_of(settings: FleetSettings) -> tuple[Lattice, Model]:
    about = settings.map
    tile_m = about.tile_m or tile_for(about.resolution_m, about.global_factor)
    lattice = Lattice(about.resolution_m, tile_m, about.crs)
    lattice.coarser(about.global_factor)
    return lattice, make_model(about.model, about.model_settings)


def _coarse_file(files: ExitStack, path: Path, store: SqliteStore, factor: int) -> SqliteStore:
    beside = path.with_name(f"{path.stem}.coarse.db")
    return files.enter_context(_opened(beside, store.map.lattice.coarser(factor), store.model))


def _area(part: RobotPart) -> Callable[[Place | None], Bounds | None]:
    """Of interest, where the robot is there."""
    fixed, radius_m = None if part.area_m is None else Bounds(*part.area_m), part.area_radius_m

    def area(place: Place | None) -> Bounds | None:
        if radius_m is None or place is None:
            return fixed
        east, north = place.east_m, place.north_m
        about = Bounds(east - radius_m, north - radius_m, east + radius_m, north + radius_m)
        return about if fixed is None else about.union(fixed)

    return area


def _beside(files: ExitStack, path: Path, what: str, archive: Store) -> SqliteStore:
    """Another store of the same lattice, beside the node's own."""
    beside = path.with_name(f"{path.stem}.{what}.db")
    return files.enter_context(_opened(beside, archive.map.lattice, archive.model))


def _opened(path: Path, lattice: Lattice, model: Model) -> SqliteStore:
    """A store that only holds what can be had again from others."""
    if not path.exists():
        return SqliteStore.create(path, lattice, model)
    store = SqliteStore.open(path)
    if store.map != map_id(model.name, lattice):
        if removed_if_empty(store):
            return _opened(path, lattice, model)
        raise StoreMismatch(f"{path}: is of another map than asked for; delete it, what it held comes back from others")
    return store
