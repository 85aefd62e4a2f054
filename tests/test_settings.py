"""A model's settings as text."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import pytest

from terrafuse.errors import InputError
from terrafuse.models import MODELS
from terrafuse.settings import settings_of, shown, takes_any, typed_settings


@dataclass(frozen=True)
class Mine:
    sure: bool = False
    count: int = 3
    """How many."""
    slope: float = 0.5
    life_s: float | None = None
    """Until it fades,
    in seconds."""
    mode: Literal["calm", "wild"] = "calm"
    label: str = "x"

    name = "mine"


def read(**texts: str) -> dict[str, Any]:
    return typed_settings("mine", Mine, texts)


def test_values_have_the_declared_type() -> None:
    got = read(sure="true", count="7", slope="2", life_s="1e3", mode="wild", label="7")
    assert got == {"sure": True, "count": 7, "slope": 2.0, "life_s": 1000.0, "mode": "wild", "label": "7"}
    assert [type(value) for value in got.values()] == [bool, int, float, float, str, str]
    assert read(life_s="none") == {"life_s": None}


@pytest.mark.parametrize(
    ("key", "text", "wanted"),
    [
        ("sure", "1", "true or false"),
        ("count", "3.0", "a whole number"),
        ("slope", "steep", "a number"),
        ("slope", "nan", "a number"),
        ("slope", "none", "a number"),
        ("life_s", "inf", "a number or none"),
        ("mode", "Calm", "calm or wild"),
        ("count", "", "a whole number"),
    ],
)
def test_other_values_are_refused(key: str, text: str, wanted: str) -> None:
    with pytest.raises(InputError) as caught:
        read(**{key: text})
    assert str(caught.value) == f"the model 'mine': {key}={text}: give {wanted}"


def test_an_unknown_setting_names_those_that_there_are() -> None:
    with pytest.raises(InputError, match="'mine' has no setting 'size'; it has: sure, count, slope, life_s, mode, lab"):
        read(size="1")


def test_what_is_listed() -> None:
    known = settings_of(Mine)
    assert list(known) == ["sure", "count", "slope", "life_s", "mode", "label"]
    assert (known["count"].default, known["count"].about) == (3, "How many.")
    assert (known["life_s"].about, known["slope"].about) == ("Until it fades, in seconds.", "")
    assert [shown(setting.default) for setting in known.values()] == ["false", "3", "0.5", "none", "calm", "x"]


def test_makers_that_declare_no_types() -> None:
    """A value is then what it looks like."""

    def make(size, *, quick=False, **more):  # type: ignore[no-untyped-def]
        raise NotImplementedError

    assert list(settings_of(make)) == ["size", "quick"]
    assert takes_any(make)
    texts = {"size": "4", "quick": "true", "other": "0.5", "word": "abc", "nothing": "none"}
    expected = {"size": 4, "quick": True, "other": 0.5, "word": "abc", "nothing": None}
    assert typed_settings("m", make, texts) == expected


@pytest.mark.parametrize("name", sorted(MODELS))
def test_the_defaults_of_every_model_can_be_written_and_read(name: str) -> None:
    make = MODELS[name]
    texts = {key: shown(setting.default) for key, setting in settings_of(make).items()}
    assert texts
    made = make(**typed_settings(name, make, texts)).settings()
    assert {key: shown(value) for key, value in made.items()} == texts
