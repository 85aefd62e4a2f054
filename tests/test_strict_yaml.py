"""The one YAML reader: what it takes, what it refuses, and that nothing but InputError leaves it."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from terrafuse.errors import InputError, shown
from terrafuse.strict_yaml import MAX_BYTES, MAX_DEPTH, load, parse

SCENARIO = """\
# two robots
name: yard
robots:
  - name: r1
    start: [1, 2.5]

  - name: r2
    sensor: {max_range_m: 30, 5.00: clear}
"""


def test_values_and_lines() -> None:
    document = parse(SCENARIO, "yard.yaml")
    assert document.value == {
        "name": "yard",
        "robots": [{"name": "r1", "start": [1, 2.5]}, {"name": "r2", "sensor": {"max_range_m": 30, 5.0: "clear"}}],
    }
    lines: dict[tuple[Any, ...], int] = {
        (): 2,
        ("name",): 2,
        ("robots",): 3,
        ("robots", 0): 4,
        ("robots", 0, "start"): 5,
        ("robots", 0, "start", 1): 5,
        ("robots", 1): 7,
        ("robots", 1, "sensor"): 8,
        ("robots", 1, "sensor", 5.0): 8,
        ("robots", 1, "sensor", "5.0"): 8,
    }
    assert {path: document.line(path) for path in lines} == lines


def test_what_a_file_does_not_have_is_said_of_what_holds_it() -> None:
    document = parse(SCENARIO, "yard.yaml")
    assert document.line(("robots", 1, "sensor", "colour", "red")) == 8
    assert document.line(("weather",)) == 2
    assert str(document.error(("robots", 1, "start"), "is missing")) == "yard.yaml:7: is missing"


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("", None), ("# nothing", None), ("~", None), ("null", None), ("--- 1", 1), ("true", True), ("FALSE", False),
        ("7", 7), ("-007", -7), ("+1", 1), ("1.", 1.0), (".5", 0.5), ("1e-2", 0.01), ("1E3", 1000.0),
        ("-.inf", -math.inf), ("9223372036854775807", 2**63 - 1), ("yes", "yes"), ("off", "off"), ("1:30", "1:30"),
        ("1_000", "1_000"), ("0x10", "0x10"), ("2001-99-99", "2001-99-99"), ("=", "="), ("<<", "<<"), ("'1'", "1"),
        ('"~"', "~"), ("|\n  a\n  b\n", "a\nb\n"), ("{on: 1}", {"on": 1}),
        ("{1: a, 1.5: b}", {1: "a", 1.5: "b"}), ("[]", []),
        ("\ufeffa: 1", {"a": 1}), ("a: \U0001f916", {"a": "\U0001f916"}),
    ],
)  # fmt: skip
def test_plain_values_are_those_of_yaml_1_2(text: str, value: Any) -> None:
    got = parse(text, "f").value
    assert (got, type(got)) == (value, type(value))


def test_nan_can_be_said() -> None:
    assert math.isnan(parse(".nan", "f").value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: 1\nb:\n  c: 1\n  c: 2", "f:4: 'c' is given twice; keep one"),
        ("{1.0: a,\n1.00: b}", "f:2: '1.00' is given twice"),
        ("a: 1\n'a': 2", "f:2: 'a' is given twice"),
        ("\n[1]: 2", "f:2: not a key"),
        ("? {a: 1}\n: 2", "f:1: not a key"),
        ("~: 2", "f:1: not a key"),
        (".nan: 2", "f:1: not a key"),
        ("a: &x 1\nb: *x", "f:1: the anchor &x"),
        ("&k a: 1", "f:1: the anchor &k"),
        ("a: &x [*x]", "f:1: the anchor &x"),
        ("a: 1\nb: *x", "f:2: the alias *x"),
        ("<<: *x", "f:1: the alias *x"),
        ("a: !!python/object:os.system x", "f:1: the tag tag:yaml.org,2002:python/object:os.system; leave it out"),
        ("a: !!str 1", "f:1: the tag"),
        ("a: 1\n---\nb: 2", "f:2: a second document begins"),
        ("a: 1\n...\n---\nb: 2", "f:3: a second document begins"),
        ("\nname: s\n  max: [\n", "f:3: not YAML (mapping values are not allowed here)"),
        ("a: [1", "f:1: not YAML"),
        ("a: b\n\tc: d", "f:2: not YAML"),
        ("a\n\x01", "f:2: not YAML (special characters are not allowed)"),
        ('a:\n  "\\UFFFFFFFF"', "f:2: not YAML"),
        ("%YAML " + "9" * 5000 + ".1\n---\na", "f:1: not YAML"),
        ('a: "\\0"', "f:1: holds a letter that no text has"),
        ('a: "\\ud800"', "f:1: holds a letter that no text has"),
        ("a: " + "9" * 400, "f:1: 9999"),
        ("9223372036854775808", "f:1: 9223372036854775808 is too large"),
        ("a: 1e400", "f:1: 1e400 is too large for a number"),
        ("[" * 5000, f"f:1: nests deeper than {MAX_DEPTH} levels"),
        ("- " * 5000, "f:1: nests deeper"),
        ("{a: " * 5000, "f:1: nests deeper"),
        ("\n".join(" " * i + "a:" for i in range(500)), f"f:{MAX_DEPTH + 1}: nests deeper"),
        ("#" * (MAX_BYTES + 1), "f: is larger than 256 KB"),
    ],
)  # fmt: skip
def test_refused_with_a_line(text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        parse(text, "f")
    assert message in str(caught.value)
    assert len(str(caught.value)) < 300


def test_as_deep_as_may_be() -> None:
    assert parse("[" * MAX_DEPTH + "]" * MAX_DEPTH, "f").value
    with pytest.raises(InputError, match="nests deeper"):
        parse("[" * (MAX_DEPTH + 1) + "]" * (MAX_DEPTH + 1), "f")


def test_files(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_bytes(b"\xef\xbb\xbfa: 1\n")
    assert load(path).value == load(str(path)).value == {"a": 1}
    path.write_text("a: 1\na: 1\n")
    with pytest.raises(InputError, match=f"{path}:2: 'a' is given twice"):
        load(path)
    path.write_bytes(b"a: 1\nb: caf\xe9\n")
    with pytest.raises(InputError, match=rf"{path}:2: can't be read as text \(byte 0xe9\); save it as UTF-8"):
        load(path)
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for odd in (tmp_path, tmp_path / "none.yaml", pipe):
        with pytest.raises(InputError, match=r"can't be read as text: .* file; give a YAML file"):
            load(odd)
    for odd in ("a" * 5000, "a\0b"):
        with pytest.raises(InputError, match="can't be read as text"):
            load(odd)


def test_large_files_are_not_read(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    with path.open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(InputError, match="is larger than"):
        load(path)


def test_long_values_are_cut() -> None:
    assert shown("a" * 100) == "a" * 80 + "…"
    assert shown("a\nb") == "'a\\nb'"
    assert shown([1]) == "[1]"


LETTERS = st.text(st.characters(categories=["L", "N", "P", "S", "Zs"]), max_size=6)
JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63) + 1, 2**63 - 1) | st.floats(allow_nan=False, allow_infinity=False)
    | LETTERS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(LETTERS, inner, max_size=4),
    max_leaves=20,
)  # fmt: skip


@given(JSON)
def test_json_is_yaml(value: Any) -> None:
    assert parse(json.dumps(value, ensure_ascii=False), "f").value == value


def complaint(text: str) -> str:
    """What is said of a text; "f:" if nothing. What is no InputError leaves."""
    try:
        parse(text, "f")
    except InputError as error:
        return str(error)
    return "f:"


@given(st.text(max_size=60) | st.text("[]{}:-?,&*!|>'\"%#a1 \n\t\\", max_size=60))
def test_nothing_but_input_errors_leaves(text: str) -> None:
    assert complaint(text).startswith("f:")


@given(st.binary(max_size=80), st.integers(0, len(SCENARIO)))
def test_damaged_scenarios(damage: bytes, at: int) -> None:
    damaged = SCENARIO.encode()[:at] + damage + SCENARIO.encode()[at + len(damage) :]
    assert complaint(damaged.decode(errors="replace")).startswith("f:")
