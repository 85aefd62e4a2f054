"""PLY: ascii, binary_little_endian, binary_big_endian. Only the `vertex` element is read."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import BinaryIO

import numpy as np

from terrafuse.errors import LogError
from terrafuse.logs.points.columns import need_xyz, xyz_of
from terrafuse.types import Array

TYPES = {
    **{"char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2"},
    **{"ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4"},
    **{"float": "f4", "float32": "f4", "double": "f8", "float64": "f8"},
}
BYTE_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass
class Element:
    """`formats` has a NumPy type a property, None for a list, whose length differs from record to record."""

    name: str
    count: int
    names: list[str] = field(default_factory=list)
    formats: list[str | None] = field(default_factory=list)

    def layout(self, byte_order: str) -> np.dtype[np.void]:
        if None in self.formats:
            raise ValueError(f"element {self.name} has a list property before the points end")
        return np.dtype([(n, f"{byte_order}{f}") for n, f in zip(self.names, self.formats, strict=True)])


def read_ply(path: Path) -> Array:
    """Raises LogError naming the file for a broken header, a truncated body, or a vertex without x, y, z."""
    with path.open("rb") as file:
        try:
            encoding, elements = _header(file)
            vertex = next(element for element in elements if element.name == "vertex")
        except (ValueError, KeyError, IndexError, StopIteration) as error:
            raise LogError(f"{path}: not a PLY header with an element vertex ({error})") from None
        need_xyz(vertex.names, path)
        before = elements[: elements.index(vertex)]
        try:
            if encoding == "ascii":
                return _ascii(file, vertex, sum(element.count for element in before))
            return _binary(file, vertex, before, BYTE_ORDERS[encoding])
        except KeyError:
            raise LogError(f"{path}: format {encoding} is none of ascii, {', '.join(BYTE_ORDERS)}") from None
        except ValueError as error:
            raise LogError(f"{path}: {error}: truncated, or not the {vertex.count} points of the header") from None


def _header(file: BinaryIO) -> tuple[str, list[Element]]:
    if file.readline().strip() != b"ply":
        raise ValueError("the first line is not 'ply'")
    encoding, elements = "", list[Element]()
    for raw in file:
        words = raw.decode("ascii", "replace").split()
        match words:
            case ["end_header"]:
                return encoding, elements
            case ["format", encoding, *_]:
                pass
            case ["element", name, count]:
                elements.append(Element(name, int(count)))
            case ["property", "list", *_, name]:
                elements[-1].names.append(name)
                elements[-1].formats.append(None)
            case ["property", kind, name]:
                elements[-1].names.append(name)
                elements[-1].formats.append(TYPES[kind])
    raise ValueError("no end_header")


def _ascii(file: BinaryIO, vertex: Element, skip: int) -> Array:
    lines = list(islice(file, skip, skip + vertex.count))
    if len(lines) < vertex.count:
        raise ValueError(f"{len(lines)} rows")
    if not lines:
        return np.empty((0, 3), np.float32)
    columns = [vertex.names.index(name) for name in "xyz"]
    values = np.loadtxt(lines, usecols=columns, ndmin=2)
    single = all(vertex.formats[column] == "f4" for column in columns)
    return values.astype(np.float32) if single else values


def _binary(file: BinaryIO, vertex: Element, before: list[Element], byte_order: str) -> Array:
    file.seek(sum(element.count * element.layout(byte_order).itemsize for element in before), 1)
    layout = vertex.layout(byte_order)
    body = file.read(layout.itemsize * vertex.count)
    if len(body) < layout.itemsize * vertex.count:
        raise ValueError(f"{len(body)} of {layout.itemsize * vertex.count} bytes")
    return xyz_of(np.frombuffer(body, layout))
