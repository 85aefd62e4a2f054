"""Scenario files → `Loaded`: YAML in, every value checked, errors with file, line, value and remedy."""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from terrafuse import strict_yaml
from terrafuse.errors import InputError, TerrafuseError, shown
from terrafuse.simulate.scenario.model import RobotsPart, Scenario, WorldPart
from terrafuse.simulate.world import World
from terrafuse.simulate.worlds import WORLDS
from terrafuse.strict_yaml import Document

SUFFIX = ".yaml"
AnyPart = TypeVar("AnyPart", bound=BaseModel)


@dataclass(frozen=True, eq=False)
class Loaded:
    """A scenario, and where it was read from, for errors that name the line."""

    name: str
    scenario: Scenario
    document: Document
    folder: Path

    def error(self, path: Sequence[Any], message: str) -> InputError:
        return self.document.error(path, message)

    @cached_property
    def world(self) -> World:
        """The place. Raises InputError with the line."""
        part = self.scenario.world
        generator = WORLDS.get(part.kind)
        if generator is None:
            raise self.error(("world", "kind"), f"world '{part.kind}'; there are {', '.join(WORLDS)}")
        arguments = dict(part.model_extra or {})
        takes = arguments_of(generator)
        for key in arguments:
            if key not in takes:
                raise self.error(("world", key), _unknown(key, ["kind", *takes]))
        if "file" in arguments:
            arguments["file"] = str(self.folder / str(arguments["file"]))
        if "seed" in takes:
            arguments.setdefault("seed", self.scenario.seed)
        try:
            return generator(**arguments)
        except TypeError as error:
            raise self.error(("world",), f"world {part.kind} of {arguments}: {error}") from error
        except TerrafuseError as error:
            raise self.error(("world",), str(error)) from error


def arguments_of(function: Callable[..., Any]) -> list[str]:
    return list(inspect.signature(function).parameters)


def scenario_names() -> list[str]:
    """The scenarios that the package ships."""
    files = (resources.files("terrafuse.simulate.scenario") / "library").iterdir()
    return sorted(file.name.removesuffix(SUFFIX) for file in files if file.name.endswith(SUFFIX))


def load_scenario(given: str | Path) -> Loaded:
    """The scenario of a name in the package, or of a YAML file. Raises InputError."""
    if str(given) in scenario_names():
        file = resources.files("terrafuse.simulate.scenario") / "library" / f"{given}{SUFFIX}"
        return read_scenario(file.read_text(encoding="utf-8"), f"{given}{SUFFIX}", str(given), Path())
    path = Path(given)
    if not path.is_file():
        raise InputError(
            f"scenario '{given}': neither a file nor one of {', '.join(scenario_names())}; give a YAML file or a name"
        )
    document = strict_yaml.load(path)
    return Loaded(path.stem, checked(document, Scenario), document, path.parent)


def read_scenario(text: str, where: str, name: str, folder: Path) -> Loaded:
    """The scenario that this YAML describes; `where` is what errors call it. Raises InputError."""
    document = strict_yaml.parse(text, where)
    return Loaded(name, checked(document, Scenario), document, folder)


def with_robots(loaded: Loaded, count: int) -> Loaded:
    """The same with so many robots of its first kind. Raises InputError for none."""
    first, *others = loaded.scenario.robots
    if not 1 <= count <= 1000:
        raise InputError(f"{count} robots: give 1 to 1000")
    robots = (first.model_copy(update={"count": count}), *others)
    return replace(loaded, scenario=loaded.scenario.model_copy(update={"robots": robots}))


def changed(loaded: Loaded, **values: Any) -> Loaded:
    """The same with some values of its own that are not None, such as `seed`. Raises InputError."""
    given = {name: value for name, value in values.items() if value is not None}
    plain = loaded.scenario.model_dump() | given
    try:
        return replace(loaded, scenario=Scenario(**plain))
    except ValidationError as error:
        first: Any = error.errors()[0]
        raise InputError(f"{first['loc'][0]} = {first['input']!r}: {_lower(first['msg'])}") from error


def checked(
    document: Document, kind: type[AnyPart], path: tuple[Any, ...] = (), leaving_out: Collection[str] = ()
) -> AnyPart:
    """A part of a document as its model. Raises InputError that names line, key, value and what is known."""
    value = document.value
    for step in path:
        value = value[step]
    if not isinstance(value, Mapping):
        raise document.error(path, f"holds no keys; give {', '.join(kind.model_fields)}; see docs/scenarios.md")
    try:
        return kind.model_validate({key: item for key, item in value.items() if key not in leaving_out})
    except ValidationError as error:
        first = _first(error)
        raise document.error((*path, *first["loc"]), _complaint(first, kind)) from error


def _first(error: ValidationError) -> Any:
    """The fault to tell: an unknown key before one that is missing, which it may have been meant for."""
    faults = error.errors()
    return next((fault for fault in faults if fault["type"] == "extra_forbidden"), faults[0])


def _complaint(first: Mapping[str, Any], kind: type[BaseModel]) -> str:
    key = str(first["loc"][-1]) if first["loc"] else ""
    where = ".".join(map(str, first["loc"]))
    if first["type"] == "extra_forbidden":
        return _unknown(key, list(_fields(kind, first["loc"][:-1])))
    if first["type"] == "missing":
        return f"'{where}' is missing; give it"
    return f"{where} = {shown(first['input'])}: {_lower(first['msg'])}"


def _unknown(key: str, known: Sequence[str]) -> str:
    near = difflib.get_close_matches(key, known, 1)
    hint = f"did you mean '{near[0]}'? " if near else ""
    return f"there is no key '{key}' here; {hint}known are {', '.join(known)}"


def _fields(kind: Any, path: Sequence[Any]) -> list[str]:
    """The keys of the part at a path."""
    for step in path:
        if isinstance(step, str):
            kind = _inner(kind.model_fields[step].annotation)
    return list(kind.model_fields)


def _inner(annotation: Any) -> Any:
    """The model in Annotated[tuple[Model, ...], …] and the like."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next(found for part in getattr(annotation, "__args__", ()) if (found := _inner(part)) is not None)


def _lower(message: str) -> str:
    return message[:1].lower() + message[1:]


__all__ = ["Loaded", "RobotsPart", "WorldPart", "arguments_of", "changed", "checked", "load_scenario", "with_robots"]
