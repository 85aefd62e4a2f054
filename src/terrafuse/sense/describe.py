"""Descriptions that people write → `Sensor`: YAML in, checked here once, trusted afterwards.

Every angle can be given in degrees or in radians, by the key's ending. Errors name file, line, key, value and remedy.
"""

from __future__ import annotations

import difflib
import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from terrafuse import strict_yaml
from terrafuse.errors import InputError, shown
from terrafuse.sense.sensor import Beams, Mounting, Ring, Sensor
from terrafuse.strict_yaml import Document

MAX_BEAMS = 10_000_000
SUFFIX = ".yaml"
Number = Annotated[float, Field(strict=True)]
"""True and "1" are none."""


FARTHEST_M = 1e6
Offset = Annotated[Number, Field(ge=-1000, le=1000)]
"""Metres from the robot's base, or from the sensor's own origin."""


class _Description(BaseModel):
    """Angles are fields in pairs, x_deg and x_rad, of which a file gives one."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, frozen=True)

    @model_validator(mode="after")
    def _has_a_value(self) -> Self:
        self.value()  # so that what is wrong with it is said of this part of the file
        return self

    def value(self) -> Any:
        """What is described. Raises ValueError."""
        raise NotImplementedError

    def rad(self, name: str, default: float = 0.0) -> float:
        """The angle in radians. Raises ValueError where both units are given."""
        (angle,) = self.rads(name, (default,))
        return angle

    def rads(self, name: str, default: Sequence[float]) -> tuple[float, ...]:
        degrees, radians = getattr(self, f"{name}_deg"), getattr(self, f"{name}_rad")
        if degrees is not None and radians is not None:
            raise ValueError(f"{name}_deg and {name}_rad are both given; keep one")
        given = radians if degrees is None else degrees
        if given is None:
            return tuple(default)
        angles = tuple(given) if isinstance(given, tuple) else (given,)
        turns = math.tau if degrees is None else 360.0
        for angle in angles:
            if abs(angle) > turns:
                hint = f"in degrees it is {name}_deg" if degrees is None else "give it between -360 and 360"
                raise ValueError(f"{name} of {angle:g} is more than a whole turn; {hint}")
        return angles if degrees is None else tuple(math.radians(angle) for angle in angles)


def _check_elevations(elevations: Sequence[float]) -> None:
    for angle in elevations:
        if abs(angle) > math.pi / 2 + 1e-9:
            raise ValueError(f"elevation {math.degrees(angle):g}°; give it between -90° and 90°")


class _Ring(_Description):
    count: int = Field(strict=True, gt=0, le=MAX_BEAMS)
    first_deg: Number | None = None
    first_rad: Number | None = None
    step_deg: Number | None = Field(None, gt=0)
    step_rad: Number | None = Field(None, gt=0)
    counting: Literal["clockwise", "anticlockwise"] = "anticlockwise"
    radius_m: Number = Field(0.0, ge=0, le=1000)
    elevations_deg: tuple[Number, ...] | None = Field(None, min_length=1)
    elevations_rad: tuple[Number, ...] | None = Field(None, min_length=1)

    def value(self) -> Ring:
        step = self.rad("step", math.tau / self.count)
        if step * (self.count - 1) > math.tau * (1 + 1e-9):
            raise ValueError(
                f"{self.count} beams, one each {math.degrees(step):g}°, go round more than once; check step and count"
            )
        elevations = self.rads("elevations", (0.0,))
        _check_elevations(elevations)
        if self.count * len(elevations) > MAX_BEAMS:
            raise ValueError(f"{self.count} × {len(elevations)} beams are more than {MAX_BEAMS}")
        return Ring(self.count, self.rad("first"), step, self.counting == "clockwise", self.radius_m, elevations)


class _Beams(_Description):
    azimuths_deg: tuple[Number, ...] | None = Field(None, min_length=1)
    azimuths_rad: tuple[Number, ...] | None = Field(None, min_length=1)
    elevations_deg: tuple[Number, ...] | None = None
    elevations_rad: tuple[Number, ...] | None = None
    radius_m: Number = Field(0.0, ge=0, le=1000)

    def value(self) -> Beams:
        azimuths = self.rads("azimuths", ())
        if not azimuths:
            raise ValueError("no azimuths; give azimuths_deg, one a beam")
        elevations = self.rads("elevations", (0.0,) * len(azimuths))
        if len(elevations) != len(azimuths):
            raise ValueError(f"{len(azimuths)} azimuths and {len(elevations)} elevations; give one of each a beam")
        _check_elevations(elevations)
        return Beams(azimuths, elevations, self.radius_m)


class _Mounting(_Description):
    x_m: Offset = 0.0
    y_m: Offset = 0.0
    z_m: Offset = 0.0
    roll_deg: Number | None = None
    roll_rad: Number | None = None
    pitch_deg: Number | None = None
    pitch_rad: Number | None = None
    yaw_deg: Number | None = None
    yaw_rad: Number | None = None

    def value(self) -> Mounting:
        return Mounting(self.x_m, self.y_m, self.z_m, self.rad("roll"), self.rad("pitch"), self.rad("yaw"))


class _Sensor(_Description):
    name: str = Field(min_length=1, max_length=200)
    max_range_m: Number = Field(gt=0, le=FARTHEST_M)
    min_range_m: Number = Field(0.0, ge=0)
    no_return: Literal["clear", "ignore"] = "ignore"
    sentinels_m: dict[Number, Literal["clear", "ignore"]] = Field(default_factory=dict)
    ring: _Ring | None = None
    beams: _Beams | None = None
    origin_m: tuple[Offset, Offset, Offset] = (0.0, 0.0, 0.0)
    cone_half_angle_deg: Number | None = Field(None, ge=0)
    cone_half_angle_rad: Number | None = Field(None, ge=0)
    range_error_m: Number = Field(0.0, ge=0, le=FARTHEST_M)
    noise_sigma_m: Number = Field(0.0, ge=0, le=FARTHEST_M)
    reliability: Number = Field(1.0, gt=0, le=1)
    firing_period_s: Number = Field(0.0, ge=0, le=3600)
    mounting: _Mounting = Field(default_factory=_Mounting)

    def value(self) -> Sensor:
        if self.min_range_m >= self.max_range_m:
            raise ValueError(f"min_range_m {self.min_range_m:g} is not below max_range_m {self.max_range_m:g}")
        cone = self.rad("cone_half_angle")
        if cone >= math.pi / 2:
            raise ValueError(f"cone_half_angle of {math.degrees(cone):g}°; give it below 90°: half of the opening")
        if cone and not self.range_error_m:
            raise ValueError("a cone needs a range_error_m over 0: how thick the arc is in which the echo may lie")
        if self.ring and self.beams:
            raise ValueError("both 'ring' and 'beams' are given; keep the one that describes the sensor")
        beams = self.ring or self.beams
        return Sensor(
            name=self.name,
            max_range_m=self.max_range_m,
            min_range_m=self.min_range_m,
            no_return=self.no_return,
            sentinels_m=tuple(sorted(self.sentinels_m.items())),
            beams=beams.value() if beams else None,
            origin_m=self.origin_m,
            cone_half_angle_rad=cone,
            range_error_m=self.range_error_m,
            noise_sigma_m=self.noise_sigma_m,
            reliability=self.reliability,
            firing_period_s=self.firing_period_s,
            mounting=self.mounting.value(),
        )


def preset_names() -> list[str]:
    """The sensors that the package describes."""
    folder = resources.files("terrafuse.sense") / "presets"
    return sorted(file.name.removesuffix(SUFFIX) for file in folder.iterdir() if file.name.endswith(SUFFIX))


def load_sensor(given: str | Path) -> Sensor:
    """The sensor of a preset's name, or of a YAML file. Raises InputError."""
    if str(given) in preset_names():
        file = resources.files("terrafuse.sense") / "presets" / f"{given}{SUFFIX}"
        return read_sensor(file.read_text(encoding="utf-8"), f"{given}{SUFFIX}")
    if not _exists(given):
        raise InputError(
            f"sensor '{shown(str(given))}': neither a file nor a preset; "
            f"give a YAML file, or one of {', '.join(preset_names())}"
        )
    return described(strict_yaml.load(given))


def _exists(path: str | Path) -> bool:
    try:
        return Path(path).exists()
    except (OSError, ValueError):  # too long a name for a file, or none
        return False


def read_sensor(text: str, where: str) -> Sensor:
    """The sensor that this YAML describes; `where` is what errors call it. Raises InputError."""
    return described(strict_yaml.parse(text, where))


def described(document: Document) -> Sensor:
    """The sensor of a document that is read already. Raises InputError."""
    if not isinstance(document.value, dict):
        raise InputError(f"{document.where}: holds no keys, but a sensor is described by them: name, max_range_m, …")
    try:
        return _Sensor.model_validate(document.value).value()
    except ValidationError as error:
        raise _complaint(error, document) from error


def content(sensor: Sensor) -> dict[str, Any]:
    """The whole description as plain JSON: what makes two sensors equal."""
    return dict(json.loads(json.dumps(asdict(sensor))))


def _complaint(error: ValidationError, document: Document) -> InputError:
    """The first fault: file, line, key, value, remedy."""
    faults = error.errors()
    first = next((fault for fault in faults if fault["type"] in ("extra_forbidden", "invalid_key")), faults[0])
    keys = [key for key in first["loc"] if key != "[key]"]
    name = shown(".".join(map(str, keys)))
    if first["type"] in ("extra_forbidden", "invalid_key"):
        return document.error(keys, f"{name}: there is no such key; {_meant(keys)}")
    if first["type"] == "missing":
        return document.error(keys, f"{name}: is missing; add it")
    message = str(first.get("ctx", {}).get("error", first["msg"]))
    if not keys:
        return document.error((), message)
    return document.error(keys, f"{name} = {shown(repr(first['input']))}: {message[0].lower()}{message[1:]}")


def _meant(keys: list[Any]) -> str:
    known = _known_keys(keys[:-1])
    near = difflib.get_close_matches(str(keys[-1]), known, 1)
    return f"known here: {', '.join(known)}" + (f"; did you mean {near[0]}?" if near else "")


def _known_keys(path: list[Any]) -> list[str]:
    model: Any = _Sensor
    for key in path:
        model = {"ring": _Ring, "beams": _Beams, "mounting": _Mounting}.get(str(key), model)
    return list(model.model_fields)
