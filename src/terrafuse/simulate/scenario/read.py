"""Scenario files → `Loaded`: YAML in, every value checked, errors with file, line, value and remedy."""

from __future__ import annotations

import inspect
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache, cached_property
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError, create_model

from terrafuse import strict_yaml
from terrafuse.errors import InputError, MissingExtra, OutputError, StoreError, TerrafuseError, shown
from terrafuse.simulate.scenario.faults import first_fault, place_of, told
from terrafuse.simulate.scenario.model import Part, RobotsPart, Scenario, WorldPart
from terrafuse.simulate.world import World
from terrafuse.simulate.worlds import WORLDS
from terrafuse.strict_yaml import Document

SUFFIX = ".yaml"
AnyPart = TypeVar("AnyPart", bound=BaseModel)
SAID_ALREADY = (MissingExtra, OutputError, StoreError)
"""Errors that are no fault of the scenario's."""


@dataclass(frozen=True, eq=False)
class Loaded:
    """A scenario, and where it was read from, for errors that name the line."""

    name: str
    scenario: Scenario
    document: Document
    folder: Path

    def error(self, path: Sequence[Any], message: str) -> InputError:
        return self.document.error(path, message)

    @contextmanager
    def at(self, *path: Any) -> Iterator[None]:
        """What can't be done in the block with what the scenario has at this path is an error that names its line:
        the one of `error` itself, if that names one."""
        try:
            yield
        except SAID_ALREADY:
            raise
        except MemoryError as error:
            raise self.error(path, "takes more memory than there is; give a smaller world or larger cells") from error
        except (TerrafuseError, ValueError, ArithmeticError) as error:
            if isinstance(error, InputError) and str(error).startswith(f"{self.document.where}:"):
                raise
            raise self.error(path, str(error)) from error

    def beside(self, file: str) -> Path:
        """A file that the scenario names: beside its own, unless the path is a whole one."""
        return self.folder / file

    @cached_property
    def world(self) -> World:
        """The place. Raises InputError with the line."""
        kind = self.scenario.world.kind
        if kind not in WORLDS:
            raise self.error(("world", "kind"), f"world '{kind}'; there are {', '.join(WORLDS)}")
        plain = {"kind": kind} | (self.scenario.world.model_extra or {})
        part = valid(self.document, arguments_of(kind), plain, ("world",))
        given = {name: getattr(part, name) for name in part.model_fields_set if name != "kind"}
        if "seed" in type(part).model_fields:
            given.setdefault("seed", self.scenario.seed)
        if "file" in given:
            given["file"] = self._world_file(given["file"])
        with self.at("world"):
            return WORLDS[kind](**given)

    def _world_file(self, name: str) -> str:
        file = self.beside(name)
        if not file.is_file():
            raise self.error(("world", "file"), f"{file}: there is no such file; give its path from {self.folder}")
        return str(file)


@cache
def arguments_of(kind: str) -> type[Part]:
    """What a world's generator takes, as a part of a scenario."""
    parameters = inspect.signature(WORLDS[kind], eval_str=True).parameters.values()
    fields: dict[str, Any] = {
        one.name: (one.annotation, ... if one.default is one.empty else one.default) for one in parameters
    }
    return create_model(f"{kind}_world", __base__=Part, kind=(str, ...), **fields)


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
            f"scenario '{shown(str(given))}': neither a file nor one of {', '.join(scenario_names())}; "
            "give a YAML file or a name"
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
    robots = (first.model_copy(update={"count": count, "places": first.places[:count]}), *others)
    return replace(loaded, scenario=loaded.scenario.model_copy(update={"robots": robots}))


def changed(loaded: Loaded, **values: Any) -> Loaded:
    """The same with some values of its own that are not None, such as `seed`. Raises InputError."""
    given = {name: value for name, value in values.items() if value is not None}
    plain = loaded.scenario.model_dump() | given
    try:
        return replace(loaded, scenario=Scenario(**plain))
    except ValidationError as error:
        raise InputError(told(first_fault(error), Scenario)) from error


def checked(
    document: Document, kind: type[AnyPart], path: tuple[Any, ...] = (), leaving_out: Collection[str] = ()
) -> AnyPart:
    """A part of a document as its model. Raises InputError that names line, key, value and what is known."""
    value = document.value
    for step in path:
        value = value[step]
    if not isinstance(value, Mapping):
        raise document.error(path, f"holds no keys; give {', '.join(kind.model_fields)}; see docs/scenarios.md")
    return valid(document, kind, {key: item for key, item in value.items() if key not in leaving_out}, path)


def valid(document: Document, kind: type[AnyPart], value: Mapping[Any, Any], path: Sequence[Any]) -> AnyPart:
    """The model of a value that the document has at this path. Raises InputError likewise."""
    try:
        return kind.model_validate(value)
    except ValidationError as error:
        first = first_fault(error)
        raise document.error((*path, *place_of(first)), told(first, kind)) from error


__all__ = ["Loaded", "RobotsPart", "WorldPart", "arguments_of", "changed", "checked", "load_scenario", "with_robots"]
