"""What is wrong with a part of a scenario, in words: its key, its value, and what to give instead."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from pydantic import BaseModel, ValidationError

from terrafuse.errors import shown
from terrafuse.simulate.scenario.model import WRONG

Context = Mapping[str, Any]


def _at_least(context: Context) -> str:
    return f"give {context['min_length']} of them or more"


def _at_most(context: Context) -> str:
    return f"give {context['max_length']} of them at most"


REMEDIES: dict[str, Callable[[Context], str]] = {
    **dict.fromkeys(("float_type", "float_parsing", "int_type", "int_parsing"), lambda _: "give a number"),
    "bool_type": lambda _: "give true or false",
    "dict_type": lambda _: "give keys with their values",
    "finite_number": lambda _: "give a finite number",
    "greater_than": lambda context: f"give more than {context['gt']:g}",
    "greater_than_equal": lambda context: f"give {context['ge']:g} or more",
    "int_from_float": lambda _: "give a whole number",
    "less_than": lambda context: f"give less than {context['lt']:g}",
    "less_than_equal": lambda context: f"give {context['le']:g} or less",
    "literal_error": lambda context: f"give {context['expected']}",
    "string_pattern_mismatch": lambda _: "give a letter, and then up to 39 letters, digits, - and _",
    "string_type": lambda _: "give text",
    "too_long": _at_most,
    "too_short": _at_least,
    **dict.fromkeys(("tuple_type", "named_tuple_type"), lambda _: "give a list"),
    "value_error": lambda context: str(context["error"]),
}
"""By pydantic's name of the fault."""


def first_fault(error: ValidationError) -> Any:
    """The one to tell: an unknown key before one that is missing, which it may have been meant for."""
    faults = error.errors()
    return next((fault for fault in faults if fault["type"] in ("extra_forbidden", "invalid_key")), faults[0])


def place_of(fault: Mapping[str, Any]) -> tuple[Any, ...]:
    """The way to it, from the part that was checked."""
    return (*fault["loc"], *fault["ctx"]["path"]) if fault["type"] == WRONG else tuple(fault["loc"])


def told(fault: Mapping[str, Any], kind: type[BaseModel]) -> str:
    """The fault of a part of this kind in words."""
    place = place_of(fault)
    where = ".".join(map(str, place))
    if fault["type"] == "extra_forbidden":
        return unknown_key(str(place[-1]), list(_fields(kind, place[:-1])))
    if fault["type"] == WRONG:
        return f"{where}: {fault['ctx']['message']}"
    if fault["type"] == "missing" and isinstance(place[-1], int):
        return f"{'.'.join(map(str, place[:-1]))} has {place[-1]} values, too few of them; give the others"
    if fault["type"] == "missing":
        return f"'{where}' is missing; give it"
    if fault["type"] in ("model_type", "model_attributes_type"):
        remedy = f"give keys: {', '.join(_fields(kind, place))}"
    else:
        remedy = _remedy(fault)
    return f"{where} = {shown(repr(fault['input']))}: {remedy}"


def _remedy(fault: Mapping[str, Any]) -> str:
    words = REMEDIES.get(fault["type"])
    message = str(fault["msg"])
    return words(fault.get("ctx", {})) if words else message[:1].lower() + message[1:]


def unknown_key(key: str, known: Sequence[str]) -> str:
    near = difflib.get_close_matches(key, known, 1)
    hint = f"did you mean '{near[0]}'? " if near else ""
    return f"there is no key '{shown(key)}' here; {hint}known are {', '.join(known)}"


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
