"""The one way in which YAML that people write is read: sensors, robots, ROS maps, scenarios.

Stricter than YAML, so that a slip is an error with its line and not another meaning: a key that is given twice, an
anchor, an alias, a tag, a second document, and nesting without end are refused. Plain values are those of YAML 1.2:
true, false, null, decimal numbers (1e-2 is one) and text; `yes`, `1:30`, `1_000` and `2001-01-01` are text.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from terrafuse.errors import InputError, shown

MAX_BYTES = 1 << 18
"""The parser takes seconds for these."""
MAX_DEPTH = 32
WORDS: dict[str, Any] = dict.fromkeys(("", "~", "null", "Null", "NULL")) | {
    form: value for word, value in (("true", True), ("false", False)) for form in (word, word.title(), word.upper())
}
INTEGER = re.compile(r"[-+]?[0-9]+")
FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")


@dataclass(frozen=True, eq=False)
class Document:
    """`value` is plain: dict, list, str, int, float, bool, None. `where` is what errors call the file."""

    value: Any
    where: str
    lines: Mapping[tuple[str, ...], int]
    """Of each key and each list's element, by the way to it: keys and numbers (from 0), all as text."""

    def line(self, path: Sequence[Any] = ()) -> int:
        """The line, from 1, of the deepest part of this path that the file has."""
        parts = tuple(map(str, path))
        return next((self.lines[parts[:n]] for n in range(len(parts), -1, -1) if parts[:n] in self.lines), 1)

    def within(self, path: Sequence[Any]) -> Document:
        """A part of it, as a document of its own with the lines of the whole."""
        parts, value = tuple(map(str, path)), self.value
        for step in path:
            value = value[step]
        depth = len(parts)
        inside = {way[depth:]: line for way, line in self.lines.items() if way[:depth] == parts}
        return Document(value, self.where, {(): self.line(path)} | inside)

    def error(self, path: Sequence[Any], message: str) -> InputError:
        """To raise: `file.yaml:12: message`, with the line of this path."""
        return InputError(f"{self.where}:{self.line(path)}: {message}")


def load(path: Path | str) -> Document:
    """The file's only document. Raises InputError that names file and line."""
    file = Path(path)
    try:
        if not file.is_file():
            why = "it is no regular file" if file.exists() else "there is no such file"
            raise InputError(f"{shown(str(path))}: can't be read as text: {why}; give a YAML file")
        with file.open("rb") as opened:
            content = opened.read(MAX_BYTES + 1)
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line, byte = content[: error.start].count(b"\n") + 1, content[error.start]
        raise InputError(f"{path}:{line}: can't be read as text (byte 0x{byte:02x}); save it as UTF-8") from error
    except (OSError, ValueError) as error:
        raise InputError(f"{shown(str(path))}: can't be read as text ({error}); give a YAML file") from error
    return parse(text, str(path))


def parse(text: str, where: str) -> Document:
    """The only document of a text; `where` is what errors call it. Raises InputError that names it and the line."""
    if len(text) > MAX_BYTES:
        raise InputError(f"{where}: is larger than {MAX_BYTES >> 10} KB; give the YAML file that people write")
    try:
        parser = yaml.SafeLoader(text)
    except yaml.reader.ReaderError as error:
        line = text[: error.position].count("\n") + 1
        raise InputError(f"{where}:{line}: not YAML ({error.reason})") from error
    reader = _Reader(parser, where)
    try:
        return Document(reader.document(), where, reader.lines)
    except (yaml.YAMLError, ValueError, OverflowError) as error:  # "\UFFFFFFFF" is an OverflowError
        raise InputError(f"{where}:{_line_of(error, parser)}: not YAML ({_problem(error)})") from error


class _Reader:
    """Goes through the parser's events once; never deeper than MAX_DEPTH."""

    def __init__(self, parser: Any, where: str) -> None:
        self._events: Iterator[Any] = iter(parser.get_event, None)
        self._where = where
        self.lines: dict[tuple[str, ...], int] = {}

    def document(self) -> Any:
        next(self._events)  # the stream's start
        first = next(self._events)
        if isinstance(first, yaml.StreamEndEvent):
            return None
        node = next(self._events)
        self.lines[()] = _line(node)
        value = self._value(node, ())
        next(self._events)  # the document's end
        after = next(self._events)
        if not isinstance(after, yaml.StreamEndEvent):
            raise self._error(after, "a second document begins; keep one")
        return value

    def _value(self, event: Any, path: tuple[str, ...]) -> Any:
        self._check(event)
        if isinstance(event, yaml.ScalarEvent):
            return self._scalar(event)
        if len(path) == MAX_DEPTH:
            raise self._error(event, f"nests deeper than {MAX_DEPTH} levels")
        return self._mapping(path) if isinstance(event, yaml.MappingStartEvent) else self._sequence(path)

    def _check(self, event: Any) -> None:
        if isinstance(event, yaml.AliasEvent):
            raise self._error(event, f"the alias *{shown(event.anchor)}; write out what it stands for")
        if event.anchor is not None:
            raise self._error(event, f"the anchor &{shown(event.anchor)}; leave it out and write each value out")
        if event.tag is not None:
            raise self._error(event, f"the tag {shown(event.tag)}; leave it out, values are numbers, text and words")

    def _mapping(self, path: tuple[str, ...]) -> dict[Any, Any]:
        out: dict[Any, Any] = {}
        while not isinstance(event := next(self._events), yaml.MappingEndEvent):
            key = self._key(event)
            if key in out:
                raise self._error(event, f"'{shown(event.value)}' is given twice; keep one")
            inside = (*path, str(key))
            self.lines[inside] = _line(event)
            out[key] = self._value(next(self._events), inside)
        return out

    def _key(self, event: Any) -> Any:
        self._check(event)
        key = self._scalar(event) if isinstance(event, yaml.ScalarEvent) else None
        if key is None or key != key:
            raise self._error(event, "not a key; keys are text or numbers")
        return key

    def _sequence(self, path: tuple[str, ...]) -> list[Any]:
        out: list[Any] = []
        while not isinstance(event := next(self._events), yaml.SequenceEndEvent):
            inside = (*path, str(len(out)))
            self.lines[inside] = _line(event)
            out.append(self._value(event, inside))
        return out

    def _scalar(self, event: Any) -> Any:
        text = event.value
        if event.style:
            return self._text(text, event)
        if text in WORDS:
            return WORDS[text]
        if INTEGER.fullmatch(text):
            return self._integer(text, event)
        if FLOAT.fullmatch(text):
            return self._float(text, event)
        return float(text.replace(".", "")) if NOT_FINITE.fullmatch(text) else self._text(text, event)

    def _text(self, text: str, event: Any) -> str:
        if "\0" in text or any("\ud800" <= letter <= "\udfff" for letter in text):
            raise self._error(event, "holds a letter that no text has (NUL or half of a pair); take it out")
        return str(text)

    def _integer(self, text: str, event: Any) -> int:
        if len(text) > 20 or abs(int(text)) >= 2**63:
            raise self._error(event, f"{shown(text)} is too large; whole numbers have up to 18 digits")
        return int(text)

    def _float(self, text: str, event: Any) -> float:
        if not math.isfinite(float(text)):
            raise self._error(event, f"{shown(text)} is too large for a number")
        return float(text)

    def _error(self, event: Any, message: str) -> InputError:
        return InputError(f"{self._where}:{_line(event)}: {message}")


def _line(event: Any) -> int:
    return int(event.start_mark.line) + 1


def _line_of(error: Exception, parser: Any) -> int:
    mark = getattr(error, "problem_mark", None)
    return int(parser.line if mark is None else mark.line) + 1


def _problem(error: Exception) -> str:
    return shown(str(getattr(error, "problem", None) or error))
