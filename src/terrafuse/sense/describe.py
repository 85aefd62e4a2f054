"""Descriptions that people write → `Sensor`: YAML in, checked here once, trusted afterwards.

Every angle can be given in degrees or in radians, by the key's ending. Errors name file, line, key, value and remedy.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from importlib import resources
from pathlib import Path
from typing import Any, Literal, Self

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from terrafuse.errors import InputError
from terrafuse.sense.sensor import Beams, Mounting, Ring, Sensor

MAX_BEAMS = 10_000_000
SUFFIX = ".yaml"


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
    count: int = Field(gt=0, le=MAX_BEAMS)
    first_deg: float | None = None
    first_rad: float | None = None
    step_deg: float | None = Field(None, gt=0)
    step_rad: float | None = Field(None, gt=0)
    counting: Literal["clockwise", "anticlockwise"] = "anticlockwise"
    radius_m: float = Field(0.0, ge=0)
    elevations_deg: tuple[float, ...] | None = Field(None, min_length=1)
    elevations_rad: tuple[float, ...] | None = Field(None, min_length=1)

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
    azimuths_deg: tuple[float, ...] | None = Field(None, min_length=1)
    azimuths_rad: tuple[float, ...] | None = Field(None, min_length=1)
    elevations_deg: tuple[float, ...] | None = None
    elevations_rad: tuple[float, ...] | None = None
    radius_m: float = Field(0.0, ge=0)

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
    x_m: float = 0.0
    y_m: float = 0.0
    z_m: float = 0.0
    roll_deg: float | None = None
    roll_rad: float | None = None
    pitch_deg: float | None = None
    pitch_rad: float | None = None
    yaw_deg: float | None = None
    yaw_rad: float | None = None

    def value(self) -> Mounting:
        return Mounting(self.x_m, self.y_m, self.z_m, self.rad("roll"), self.rad("pitch"), self.rad("yaw"))


class _Sensor(_Description):
    name: str = Field(min_length=1, max_length=200)
    max_range_m: float = Field(gt=0)
    min_range_m: float = Field(0.0, ge=0)
    no_return: Literal["clear", "ignore"] = "ignore"
    sentinels_m: dict[float, Literal["clear", "ignore"]] = Field(default_factory=dict)
    ring: _Ring | None = None
    beams: _Beams | None = None
    origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    cone_half_angle_deg: float | None = Field(None, ge=0)
    cone_half_angle_rad: float | None = Field(None, ge=0)
    range_error_m: float = Field(0.0, ge=0)
    noise_sigma_m: float = Field(0.0, ge=0)
    reliability: float = Field(1.0, gt=0, le=1)
    firing_period_s: float = Field(0.0, ge=0)
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
    path = Path(given)
    if not path.exists():
        raise InputError(
            f"sensor '{given}': neither a file nor a preset; give a YAML file, or one of {', '.join(preset_names())}"
        )
    try:
        return read_sensor(path.read_text(encoding="utf-8"), str(path))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: can't be read as text ({error}); give a YAML file") from error


def read_sensor(text: str, where: str) -> Sensor:
    """The sensor that this YAML describes; `where` is what errors call it. Raises InputError."""
    try:
        tree = yaml.compose(text, Loader=yaml.SafeLoader)
        values = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError) as error:  # safe_load lets the ValueError of 2001-99-99 through
        mark = getattr(error, "problem_mark", None)
        line = f":{mark.line + 1}" if mark else ""
        problem = getattr(error, "problem", None) or str(error)
        raise InputError(f"{where}{line}: not YAML ({problem}); give keys as in docs/sensors.md") from error
    if not isinstance(values, dict):
        raise InputError(f"{where}: holds no keys, but a sensor is described by them: name, max_range_m, …")
    _refuse_repeats(tree, where)
    try:
        return _Sensor.model_validate(values).value()
    except ValidationError as error:
        raise InputError(_complaint(error, tree, where)) from error


def content(sensor: Sensor) -> dict[str, Any]:
    """The whole description as plain JSON: what makes two sensors equal."""
    return dict(json.loads(json.dumps(asdict(sensor))))


def _complaint(error: ValidationError, tree: Any, where: str) -> str:
    """The first fault in one line: file, line, key, value, remedy."""
    first = error.errors()[0]
    keys = [key for key in first["loc"] if key != "[key]"]
    place = f"{where}:{_line(tree, keys)}: " + (".".join(map(str, keys)) or "the description")
    if first["type"] == "extra_forbidden":
        known = ", ".join(_known_keys(keys[:-1]))
        return f"{place}: there is no such key; known here: {known}"
    if first["type"] == "missing":
        return f"{place}: is missing; add it"
    message = str(first.get("ctx", {}).get("error", first["msg"]))
    if not keys:
        return f"{where}: {message}"
    return f"{place} = {first['input']!r}: {message[0].lower()}{message[1:]}"


def _known_keys(path: list[Any]) -> list[str]:
    model: Any = _Sensor
    for key in path:
        model = {"ring": _Ring, "beams": _Beams, "mounting": _Mounting}.get(str(key), model)
    return list(model.model_fields)


def _line(node: Any, keys: Sequence[Any]) -> int:
    """The line of the deepest of these keys that the file has."""
    line = int(node.start_mark.line) + 1
    for key in keys:
        if isinstance(node, yaml.MappingNode):
            found = [(k, v) for k, v in node.value if _same(k, key)]
        elif isinstance(node, yaml.SequenceNode) and isinstance(key, int) and key < len(node.value):
            found = [(node.value[key], node.value[key])]
        else:
            found = []
        if not found:
            return line
        line, node = int(found[0][0].start_mark.line) + 1, found[0][1]
    return line


def _same(node: Any, key: Any) -> bool:
    """Whether a key of the file is the one that a complaint is about; numbers may be written in several ways."""
    return bool(node.value == str(key) or yaml.safe_load(node.value) == key) if node.id == "scalar" else False


def _refuse_repeats(tree: Any, where: str) -> None:
    """A key given twice: YAML would take the last one and say nothing."""
    parts = [value for _, value in tree.value if isinstance(value, yaml.MappingNode)]
    for part in (tree, *parts):
        keys = [key for key, _ in part.value]
        for number, key in enumerate(keys):
            if any(key.value == earlier.value for earlier in keys[:number]):
                raise InputError(f"{where}:{key.start_mark.line + 1}: '{key.value}' is given twice; keep one")
