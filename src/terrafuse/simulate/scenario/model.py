"""What a scenario says: the place, the map, the robots, the radio. Frozen, and checked piece by piece.

`read.py` makes these of YAML; what only the world can tell (a robot in a wall) is checked in `check.py`.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field


def _number(value: Any) -> Any:
    """`true` and "5" are no numbers."""
    if isinstance(value, bool | str):
        raise ValueError("give a number")
    return value


Number = Annotated[float, BeforeValidator(_number)]
Count = Annotated[int, BeforeValidator(_number)]
Positive = Annotated[Number, Field(gt=0)]
NotNegative = Annotated[Number, Field(ge=0)]
Share = Annotated[Number, Field(ge=0, le=1)]
Place = tuple[Number, Number]
"""East and north, metres."""
Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,39}$")]


class Part(BaseModel):
    """A part of a scenario: no unknown keys, no infinities."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class WorldPart(Part):
    """A generator of `WORLDS` by name; what else is given are its arguments."""

    model_config = ConfigDict(frozen=True, extra="allow", allow_inf_nan=False)

    kind: str


class MapPart(Part):
    """What every robot's mapper is made with; robots share one lattice."""

    model: str = "elevation"
    settings: dict[str, Any] = Field(default_factory=dict)
    """Of the model."""
    resolution_m: Positive = 0.1
    tile_m: Positive | None = None
    window: str = "tiles3x3"
    global_factor: Annotated[Count, Field(ge=1)] = 1
    """Cells along the side of a cell of the global map, which robots and station exchange."""
    prior_building_height_m: Positive | None = None
    """Before the mission, this is known of every building."""


class SensorPart(Part):
    """A sensor on the robot."""

    kind: Literal["lidar", "sonar"]
    description: str | dict[str, Any]
    """A preset's name, a YAML file beside the scenario, or the description itself."""
    rate_hz: Positive | None = None
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

    forward_m: NotNegative = 0.02
    up_m: NotNegative = 0.01
    turn_rad: NotNegative = 0.005
    """After a metre."""
    turn_share: NotNegative = 0.02
    """After turning 1 rad."""
    scale: NotNegative = 0.01
    bias_rad_per_m: NotNegative = 0.0005


class PosePart(Part):
    """How a robot knows where it is."""

    kind: Literal["true", "odometry", "filtered"] = "true"
    """The truth; odometry from a true start; odometry and GNSS in a filter."""
    gnss_hz: Positive = 5.0
    odometry: OdometryPart = OdometryPart()
    tilt_sigma_rad: NotNegative = 0.002
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
    places: tuple[tuple[Number, Number, Number], ...] = ()
    """x, y (metres), yaw (degrees) of the first robots; the others start on the streets nearest to the station."""
    spread: bool = False
    """These start all over the streets instead."""
    sensors: Annotated[tuple[SensorPart, ...], Field(min_length=1)]
    pose: PosePart = PosePart()
    behaviour: BehaviourPart
    altitude_m: NotNegative = 0.0
    """Above ground, of what flies."""


class CutPart(Part):
    from_s: NotNegative
    to_s: Positive
    node: str | None = None
    """None: everybody."""
    other: str | None = None


class RadioPart(Part):
    range_m: Positive = 150.0
    behind_walls: Share = 0.3
    """Share of the range that is left out of sight."""
    loss: Share = 0.0
    latency_s: NotNegative = 0.002
    jitter_s: NotNegative = 0.0
    bytes_per_s: Positive = 250_000.0
    frame_bytes: Annotated[Count, Field(ge=64, le=65_000)] = 2312
    cuts: tuple[CutPart, ...] = ()
    share: Literal["all", "station"] = "all"
    """Who holds the global map: every robot, or the station alone."""
    report_s: Positive = 2.0
    """Time between a robot's reports of what changed in its map."""
    place_s: Positive | None = None
    """And of where it is; None: it does not say."""


class StationPart(Part):
    place: Place | None = None
    """None: at the street corner nearest to the middle of the world."""
    height_m: NotNegative = 4.0
    """Of its antenna."""


class Scenario(Part):
    """A whole scenario."""

    title: str = ""
    world: WorldPart
    map: MapPart = MapPart()
    robots: Annotated[tuple[RobotsPart, ...], Field(min_length=1)]
    station: StationPart = StationPart()
    radio: RadioPart = RadioPart()
    duration_s: Positive
    tick_s: Annotated[Number, Field(ge=0.01, le=1)] = 0.1
    seed: Annotated[Count, Field(ge=0)] = 0
    study: str = "map"
    """What is made of it beyond the map: a name of `STUDIES`."""
    stop_mapped_share: Share | None = None
    """End when so much of the streets is on the global map."""
    frame_s: Positive = 5.0
    """Simulated seconds between the animation's frames."""
