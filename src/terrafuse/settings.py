"""Settings of a model as people write them, `terrain?half_life_s=60` → values of the types that the model declares.

What may be set are the parameters of whatever makes the model, with their annotations: for a dataclass, its fields.
"""

from __future__ import annotations

import ast
import inspect
import math
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from inspect import Parameter, signature
from itertools import pairwise
from numbers import Integral, Real
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from terrafuse.errors import InputError

WORDS = {"true": True, "false": False}
NONE = "none"


@dataclass(frozen=True)
class Setting:
    """`kind` is its annotation, `default` None also where there is none, `about` what stands below it in the source."""

    name: str
    kind: Any
    default: Any
    about: str

    @property
    def takes(self) -> str:
        """What may be given, in words."""
        return " or ".join(_words(kind) for kind in _kinds(self.kind))


def settings_of(make: Callable[..., Any]) -> dict[str, Setting]:
    """By name, in the order of the source."""
    kinds, abouts = _hints(make), _abouts(make)
    return {
        name: Setting(name, kinds.get(name, Any), None if it.default is Parameter.empty else it.default,
                      abouts.get(name, ""))
        for name, it in signature(make).parameters.items()
        if it.kind not in (Parameter.VAR_KEYWORD, Parameter.VAR_POSITIONAL)
    }  # fmt: skip


def takes_any(make: Callable[..., Any]) -> bool:
    """Whether it takes settings that it does not name."""
    return any(it.kind is Parameter.VAR_KEYWORD for it in signature(make).parameters.values())


def typed_settings(name: str, make: Callable[..., Any], texts: Mapping[str, str]) -> dict[str, Any]:
    """The values that these texts mean. Raises InputError for a setting that there is none of, or a wrong value."""
    known = settings_of(make)
    return {key: _value(name, _setting(name, make, known, key), text) for key, text in texts.items()}


def misfit(make: Callable[..., Any], values: Mapping[str, Any]) -> str | None:
    """What is wrong with the type of one of these values for the setting of its name, or None."""
    kinds = _hints(make)
    for key, value in values.items():
        allowed = _kinds(kinds.get(key, Any))
        if not any(_is(kind, value) for kind in allowed):
            return f"{key} {value!r}: give {' or '.join(_words(kind) for kind in allowed)}"
    return None


def _is(kind: Any, value: Any) -> bool:
    if kind in (int, float):
        return isinstance(value, Integral if kind is int else Real) and not isinstance(value, bool)
    if get_origin(kind) is Literal:
        return any(isinstance(value, type(one)) for one in get_args(kind))  # which ones, the model says
    return not isinstance(kind, type) or isinstance(value, kind)


def _setting(name: str, make: Callable[..., Any], known: Mapping[str, Setting], key: str) -> Setting:
    if key in known:
        return known[key]
    if takes_any(make):
        return Setting(key, Any, None, "")
    raise InputError(f"the model '{name}' has no setting '{key}'; it has: {', '.join(known) or 'none'}")


def _value(name: str, setting: Setting, text: str) -> Any:
    for kind in _kinds(setting.kind):
        try:
            return _read(kind, text)
        except ValueError:
            continue
    raise InputError(f"the model '{name}': {setting.name}={text}: give {setting.takes}")


def _read(kind: Any, text: str) -> Any:
    """Raises ValueError."""
    if kind is NoneType:
        return None if text.lower() == NONE else _refuse()
    if kind is bool:
        return WORDS[text.lower()] if text.lower() in WORDS else _refuse()
    if kind is int:
        return int(text)
    if kind is float:
        return float(text) if math.isfinite(float(text)) else _refuse()
    if get_origin(kind) is Literal:
        return text if text in get_args(kind) else _refuse()
    return text if kind is str else _guess(text)


def _refuse() -> Any:
    raise ValueError


def _guess(text: str) -> Any:
    """Of a setting without a type: what it looks like."""
    for kind in (NoneType, bool, int, float):
        try:
            return _read(kind, text)
        except ValueError:
            continue
    return text


def _kinds(kind: Any) -> tuple[Any, ...]:
    return get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)


def _words(kind: Any) -> str:
    if get_origin(kind) is Literal:
        return " or ".join(map(str, get_args(kind)))
    names = {bool: "true or false", int: "a whole number", float: "a number", NoneType: NONE, str: "text"}
    return names.get(kind, "a value")


def _hints(make: Callable[..., Any]) -> dict[str, Any]:
    """A class has them as fields or in its __init__."""
    try:
        inner = get_type_hints(make.__init__) if inspect.isclass(make) else {}
        return {**get_type_hints(make), **inner}
    except (NameError, TypeError):  # names that are imported for type checkers only
        return {}


def _abouts(make: Callable[..., Any]) -> dict[str, str]:
    """The text below each field of a class."""
    try:
        (tree,) = ast.parse(textwrap.dedent(inspect.getsource(make))).body
    except (OSError, TypeError, ValueError, SyntaxError):
        return {}
    body = tree.body if isinstance(tree, ast.ClassDef) else []
    return {
        field.target.id: " ".join(text.value.value.split())
        for field, text in pairwise(body)
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)
        and isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant) and isinstance(text.value.value, str)
    }  # fmt: skip


def shown(value: Any) -> str:
    """A value as it may be written after the `?`."""
    if isinstance(value, bool) or value is None:
        return str(value).lower()
    return f"{value:.6g}" if isinstance(value, float) else str(value)
