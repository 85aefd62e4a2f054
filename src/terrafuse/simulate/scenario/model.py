"""What a scenario says: the place, the map, the robots, the radio. Frozen, and checked piece by piece.

`read.py` makes these of YAML. What several parts say together is checked in mission/check.py, what only the world
can tell (a robot in a wall) where the mission is set up.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from terrafuse.simulate.quantities import (
    Coordinate,
    Count,
    Delay,
    Error,
    Flag,
    Height,
    Length,
    Number,
    Period,
    Place,
    Rate,
    Resolution,
    Seed,
    Share,
)

WRONG = "wrong_together"


def _described(value: Any) -> Any:
    if not isinstance(value, str | dict):
        raise ValueError("give a preset's name, a YAML file, or the keys of a description")
    return value


Start = tuple[Coordinate, Coordinate, Annotated[Number, Field(ge=-360, le=360)]]
"""East and north, metres; yaw, degrees."""
Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,39}$")]
Description = Annotated[Any, AfterValidator(_described)]


class Part(BaseModel):
    """A part of a scenario: no unknown keys, no infinities."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def wrong(message: str, *path: str | int) -> PydanticCustomError:
    """To raise in a validator of a whole part: the fault of what it has at this path."""
    return PydanticCustomError(WRONG, "{message}", {"path": path, "message": message})


class WorldPart(Part):
    """A generator of `WORLDS` by name; what else is given are its arguments."""

    model_config = ConfigDict(frozen=True, extra="allow", allow_inf_nan=False)

    kind: str


class MapPart(Part):
    """What every robot's mapper is made with; robots share one lattice."""

    model: str = "elevation"
    settings: dict[str, Any] = Field(default_factory=dict)
    """Of the model."""
    resolution_m: Resolution = 0.1
    tile_m: Length | None = None
    window: str = "tiles3x3"
    global_factor: Annotated[Count, Field(ge=1, le=4096)] = 1
    """Cells along the side of a cell of the global map, which robots and station exchange."""
    prior_building_height_m: Annotated[Number, Field(gt=0, le=1000)] | None = None
    """Before the mission, this is known of every building."""


class SensorPart(Part):
    """A sensor on the robot."""

    kind: Literal["lidar", "sonar"]
    description: Description
    """A preset's name, a YAML file beside the scenario, or the description itself."""
    rate_hz: Rate | None = None
    """None: sonars that fire in turn do so at their own pace; all else once a tick."""
    dropout: Share = 0.0
    """Of a lidar's beams."""
    specular_limit_deg: Annotated[Number, Field(gt=0, le=90)] = 20.0
    """Of a sonar: how far off a surface's normal there is still an echo."""
    crosstalk: Literal["off", "uncoded", "coded"] = "off"
    """Whether sonars hear other robots' pings: never; take each for their own; or tell them apart by their codes."""
    pulses: Literal["aligned", "random"] = "random"
    """Whether robots ping at the same instant, or each at one of its own."""


class OdometryPart(Part):
    """Standard deviations of what odometry gets wrong; see docs/navigation.md."""

    forward_m: Error = 0.02
    up_m: Error = 0.01
    turn_rad: Error = 0.005
    """After a metre."""
    turn_share: Error = 0.02
    """After turning 1 rad."""
    scale: Error = 0.01
    bias_rad_per_m: Error = 0.0005


class PosePart(Part):
    """How a robot knows where it is."""

    kind: Literal["true", "odometry", "filtered"] = "true"
    """The truth; odometry from a true start; odometry and GNSS in a filter."""
    gnss_hz: Rate = 5.0
    odometry: OdometryPart = OdometryPart()
    tilt_sigma_rad: Error = 0.002
    """Of roll and pitch, which an inclinometer measures."""


class BehaviourPart(Part):
    """A behaviour by name; what else is given are its own settings."""

    model_config = ConfigDict(frozen=True, extra="allow", allow_inf_nan=False)

    kind: str


class RobotsPart(Part):
    """Robots of one kind."""

    count: Annotated[Count, Field(ge=1, le=1000)] = 1
    name: Name = "r"
    """They are called so, with a number from 1 on."""
    body: str = "summit_xl"
    motion: Literal["kinematic", "physics"] = "kinematic"
    places: tuple[Start, ...] = ()
    """Of the first robots; the others start on the streets nearest to the station, or on free ground."""
    spread: Flag = False
    """These start all over the streets instead."""
    sensors: Annotated[tuple[SensorPart, ...], Field(min_length=1)]
    pose: PosePart = PosePart()
    behaviour: BehaviourPart
    altitude_m: Height = 0.0
    """Above ground, of what flies."""

    @model_validator(mode="after")
    def _has_robots_for_its_places(self) -> Self:
        if len(self.places) > self.count:
            raise wrong(f"{len(self.places)} places for {self.count} robots; give one a robot, or fewer", "places")
        return self


class CutPart(Part):
    from_s: Delay
    to_s: Delay
    node: str | None = None
    """None: everybody."""
    other: str | None = None

    @model_validator(mode="after")
    def _lasts(self) -> Self:
        if self.to_s <= self.from_s:
            raise wrong(f"a cut from {self.from_s:g} to {self.to_s:g} s; give a to_s beyond from_s", "to_s")
        return self


LEAST_FRAME = 76
"""Bytes: the exchange needs 64 beside the 12 of a frame's header."""


class RadioPart(Part):
    range_m: Length = 150.0
    behind_walls: Share = 0.3
    """Share of the range that is left out of sight."""
    loss: Share = 0.0
    latency_s: Delay = 0.002
    jitter_s: Delay = 0.0
    bytes_per_s: Annotated[Number, Field(ge=1, le=1e12)] = 250_000.0
    frame_bytes: Annotated[Count, Field(ge=LEAST_FRAME, le=65_000)] = 2312
    cuts: tuple[CutPart, ...] = ()
    share: Literal["all", "station"] = "all"
    """Who holds the global map: every robot, or the station alone."""
    report_s: Period = 2.0
    """Time between a robot's reports of what changed in its map."""
    place_s: Period | None = None
    """And of where it is; None: it does not say."""


class StationPart(Part):
    place: Place | None = None
    """None: at the street corner nearest to the middle of the world."""
    height_m: Height = 4.0
    """Of its antenna."""


class Scenario(Part):
    """A whole scenario."""

    title: str = ""
    world: WorldPart
    map: MapPart = MapPart()
    robots: Annotated[tuple[RobotsPart, ...], Field(min_length=1)]
    station: StationPart = StationPart()
    radio: RadioPart = RadioPart()
    duration_s: Annotated[Number, Field(ge=0.01, le=1e6)]
    tick_s: Annotated[Number, Field(ge=0.01, le=1)] = 0.1
    seed: Seed = 0
    study: str = "map"
    """What is made of it beyond the map: a name of `STUDIES`."""
    stop_mapped_share: Share | None = None
    """End when so much of the streets is on the global map."""
    frame_s: Period = 5.0
    """Simulated seconds between the animation's frames."""

    @model_validator(mode="after")
    def _lasts_a_tick(self) -> Self:
        if self.duration_s < self.tick_s:
            raise wrong(f"{self.duration_s:g} s are less than a tick; give {self.tick_s:g} or more", "duration_s")
        return self

    @model_validator(mode="after")
    def _cuts_what_there_is(self) -> Self:
        nodes = [f"{part.name}{number}" for part in self.robots for number in range(1, part.count + 1)] + ["station"]
        for k, cut in enumerate(self.radio.cuts):
            for key in ("node", "other"):
                name = getattr(cut, key)
                if name is not None and name not in nodes:
                    raise wrong(f"no node '{name}'; there are {', '.join(nodes)}", "radio", "cuts", k, key)
        return self
