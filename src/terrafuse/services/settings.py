"""Which services run where, as settings: a map, how nodes reach each other, a station, robots.

A node is made of its part of these alone, so that the same file runs all in one process, a process a node, or spread
over hosts: only which nodes are asked for differs.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from terrafuse import strict_yaml
from terrafuse.config import MapSettings, map_settings
from terrafuse.errors import InputError
from terrafuse.strict_yaml import Document

NAME = r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$"
NAMES = "give 1 to 64 letters, digits, _ . or -, a letter or digit first"
STATION = "station"

LEAST_SIDE_M, MOST_SIDE_M, FARTHEST_M = 1.0, 100_000.0, 1e8
"""Of areas of interest. No projection leads farther than 40,000 km."""


def checked_area(area: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    """An area of interest: west, south, east, north. Raises ValueError for one that no robot can mean."""
    west, south, east, north = area
    near = all(abs(each) <= FARTHEST_M for each in area)
    if not (near and all(LEAST_SIDE_M <= side <= MOST_SIDE_M for side in (east - west, north - south))):
        raise ValueError(
            f"an area of interest of {east - west:g} m by {north - south:g} m from {west:g}, {south:g} on: give west, "
            f"south, east, north with sides of {LEAST_SIDE_M:g} m to {MOST_SIDE_M / 1000:g} km, within "
            f"{FARTHEST_M / 1000:g} km of the origin"
        )
    return area


Area = Annotated[tuple[float, float, float, float], AfterValidator(checked_area)]


def checked_name(name: str) -> str:
    """A node's name. Raises InputError for what none can have: names are parts of topics and of files' names."""
    if re.fullmatch(NAME, name) is None:
        raise InputError(f"'{name}' can't be a node's name: {NAMES}")
    return name


def words_of(error: ValidationError) -> str:
    """The first fault of a validation, without its library's own words where ours say it."""
    first = error.errors()[0]
    if first["type"] == "value_error":
        return str(first["ctx"]["error"])
    if first["type"] == "string_pattern_mismatch" and first["ctx"]["pattern"] == NAME:
        return f"{first['input']!r} can't be a node's name: {NAMES}"
    return f"{first['msg'][:1].lower()}{first['msg'][1:]}"


class Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class LinkPart(Part):
    """How nodes reach each other."""

    kind: Literal["memory", "zenoh"] = "zenoh"
    """`memory`: all nodes are in one process."""
    listen: tuple[str, ...] = ()
    """Where the station waits for the others, like tcp/0.0.0.0:7447."""
    connect: tuple[str, ...] = ()
    """Where the others find it; the first that answers."""
    keys: str | None = None
    """A folder of keys; {node} in it is the node's name."""
    insecure: bool = False
    """No encryption, no identity."""


class QuotasPart(Part):
    """What a station takes of a robot at most; see docs/services.md."""

    bytes_per_s: float = Field(default=5e6, gt=0)
    """Of reports, over half a minute."""
    tiles: int = Field(default=20_000, gt=0)
    """Altogether."""
    area_tiles: int = Field(default=1024, gt=0)
    """Of its area of interest, of which the station keeps the map,"""
    all_area_tiles: int = Field(default=8192, gt=0)
    """and of all robots' areas."""
    distance_m: float | None = Field(default=None, gt=0)
    """From where the robot says it was to the near edge of a tile; None: anywhere."""


class StationPart(Part):
    name: str = Field(STATION, pattern=NAME)
    store: str
    """The file of its map."""
    bytes_per_s: float | None = Field(None, gt=0)
    """On each of its links."""
    quotas: QuotasPart = QuotasPart()
    relays: tuple[str, ...] = ()
    """Without keys: nodes that may pass on what any robot reports, such as stations below this one."""
    upstream: tuple[str, ...] = ()
    """Where it finds the station above it; the first that answers."""
    upstream_name: str = Field(STATION, pattern=NAME)
    area_m: Area | None = None
    """West, south, east, north: where it holds the map of the station above."""

    @model_validator(mode="after")
    def _is_not_above_itself(self) -> StationPart:
        if self.upstream and self.upstream_name == self.name:
            raise ValueError(f"this station and the one above it are both called '{self.name}'; names must differ")
        if self.area_m is not None and not self.upstream:
            raise ValueError("an area of interest is for the map of a station above: give its address (upstream), too")
        return self


class RobotPart(Part):
    source: str
    """A log, or SCENARIO/ROBOT."""
    store: str
    """The file of its own map, which is its outbox, too."""
    sensor: str | None = None
    realtime: bool = False
    share: Literal["coarse", "fine", "none"] | None = None
    """Which map of the whole fleet the robot holds; None: the coarse one, where there is one, else the fine one."""
    area_m: Area | None = None
    """West, south, east, north: of interest. The robot then holds the fleet's map there."""
    area_radius_m: float | None = Field(default=None, gt=0, le=MOST_SIDE_M / 2)
    """The same about where it is by now."""
    listen: tuple[str, ...] = ()
    """Where other robots find it."""
    peers: tuple[str, ...] = ()
    """Robots with which it exchanges maps, instead of a station."""
    precision: Literal["exact", "full", "lean"] = "exact"
    """Of what it reports: docs/delta-format.md."""
    bytes_per_s: float | None = Field(None, gt=0)


class FleetSettings(Part):
    """The whole. `map` is what `terrafuse map` is told, too."""

    map: MapSettings = Field(default_factory=map_settings)
    link: LinkPart = LinkPart()
    station: StationPart | None = None
    stations: tuple[str, ...] = (STATION,)
    """Whom robots report to, where no station is described here."""
    robots: dict[str, RobotPart] = {}

    @model_validator(mode="after")
    def _names_differ(self) -> FleetSettings:
        if self.station is not None and self.station.name in self.robots:
            raise ValueError(f"the station and a robot are both called '{self.station.name}'; names must differ")
        for name, robot in self.robots.items():
            if re.fullmatch(NAME, name) is None:
                raise ValueError(f"'{name}' can't be a node's name: {NAMES}")
            if name in robot.peers:
                raise ValueError(f"'{name}' is its own peer; name the other robots")
        return self

    @property
    def nodes(self) -> list[str]:
        return [*([self.station.name] if self.station else []), *self.robots]

    @property
    def reported_to(self) -> tuple[str, ...]:
        return (self.station.name,) if self.station else self.stations


def load_fleet(path: Path | str) -> FleetSettings:
    """Settings from a YAML file; files in it are relative to its folder. Raises InputError with the line."""
    document = strict_yaml.load(path)
    settings = _checked(document)
    folder = Path(path).parent
    station = settings.station and settings.station.model_copy(update={"store": _under(folder, settings.station.store)})
    keys = settings.link.keys and _under(folder, settings.link.keys)
    robots = {
        name: robot.model_copy(
            update={"store": _under(folder, robot.store), "source": _under(folder, robot.source, only_there=True)}
        )
        for name, robot in settings.robots.items()
    }
    link = settings.link.model_copy(update={"keys": keys})
    return settings.model_copy(update={"station": station, "robots": robots, "link": link})


def _checked(document: Document) -> FleetSettings:
    if not isinstance(document.value, dict):
        raise document.error((), f"holds no keys; give {', '.join(FleetSettings.model_fields)}; see docs/services.md")
    try:
        return FleetSettings.model_validate(document.value)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the file"
        raise document.error(first["loc"], f"{where}: {words_of(error)}") from error


def _under(folder: Path, text: str, only_there: bool = False) -> str:
    """The path seen from the file's folder; of sources, which may be names of scenarios, only where that is there."""
    path = folder / text
    return text if only_there and not (folder / text.partition("?")[0]).exists() else str(path)


def chosen(settings: FleetSettings, nodes: Sequence[str]) -> list[str]:
    """The nodes to run here: those asked for, or all. Raises InputError for one that there is none of."""
    for name in nodes:
        if name not in settings.nodes:
            raise InputError(f"no node '{name}'; there are {', '.join(settings.nodes)}")
    if settings.link.kind == "memory" and nodes and set(nodes) != set(settings.nodes):
        raise InputError("link kind 'memory' is for all nodes in one process; make it 'zenoh' to run some elsewhere")
    return list(nodes) or settings.nodes
