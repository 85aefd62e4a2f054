"""PCL's PCD, version 0.7: ascii, binary and binary_compressed.

VIEWPOINT is not applied: PCL's own tools store points both before and after it, so the points are taken as
they stand.
"""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from terrafuse.errors import LogError
from terrafuse.logs.points.columns import need_xyz, xyz_of
from terrafuse.logs.points.lzf import decompress
from terrafuse.types import Array

KINDS = {"F": "f", "I": "i", "U": "u"}


@dataclass(frozen=True)
class Header:
    """`formats` has one NumPy format a field, as `<f4` or `4u1`."""

    names: list[str]
    formats: list[Any]
    points: int
    encoding: str


def read_pcd(path: Path) -> Array:
    """Raises LogError naming the file for a broken header, a truncated body, or fields without x, y, z."""
    with path.open("rb") as file:
        header = _header(file, path)
        need_xyz(header.names, path)
        body = file.read()
    try:
        return BODIES[header.encoding](body, header)
    except KeyError:
        raise LogError(f"{path}: DATA {header.encoding} is none of {', '.join(BODIES)}") from None
    except (ValueError, IndexError) as error:
        raise LogError(f"{path}: {error}: truncated, or not the {header.points} points of the header") from None


def _header(file: BinaryIO, path: Path) -> Header:
    entries: dict[str, list[str]] = {}
    for raw in file:
        words = raw.decode("ascii", "replace").split()
        if words and not words[0].startswith("#"):
            entries[words[0].upper()] = words[1:]
        if "DATA" in entries:
            break
    try:
        return _parsed_header(entries)
    except (KeyError, IndexError, ValueError) as error:
        raise LogError(f"{path}: not a PCD header ({type(error).__name__}: {error})") from None


def _parsed_header(entries: dict[str, list[str]]) -> Header:
    names = entries["FIELDS"]
    counts = [int(count) for count in entries.get("COUNT", ["1"] * len(names))]
    formats = [
        (f"<{KINDS[kind]}{size}", (count,)) if count != 1 else f"<{KINDS[kind]}{size}"
        for kind, size, count in zip(entries["TYPE"], entries["SIZE"], counts, strict=True)
    ]
    points = int(entries["POINTS"][0]) if "POINTS" in entries else int(entries["WIDTH"][0]) * int(entries["HEIGHT"][0])
    # PCL writes padding as several fields named "_", which a NumPy dtype does not take
    unique = [f"_{i}" if name == "_" else name for i, name in enumerate(names)]
    return Header(unique, formats, points, entries["DATA"][0].lower())


def _ascii(body: bytes, header: Header) -> Array:
    widths = [format[1][0] if isinstance(format, tuple) else 1 for format in header.formats]
    starts = np.concatenate([[0], np.cumsum(widths)])
    columns = [int(starts[header.names.index(name)]) for name in "xyz"]
    if not header.points:
        return np.empty((0, 3), np.float32)
    values = np.loadtxt(BytesIO(body), usecols=columns, ndmin=2)
    if len(values) != header.points:
        raise ValueError(f"{len(values)} rows")
    single = all(header.formats[header.names.index(name)] == "<f4" for name in "xyz")
    return values.astype(np.float32) if single else values


def _binary(body: bytes, header: Header) -> Array:
    layout = np.dtype({"names": header.names, "formats": header.formats})
    return xyz_of(np.frombuffer(body, layout, header.points))


def _compressed(body: bytes, header: Header) -> Array:
    """LZF of the fields one after the other, each with all its points."""
    packed, size = np.frombuffer(body, "<u4", 2).tolist()
    if len(body) < 8 + packed:
        raise ValueError(f"{len(body) - 8} of {packed} compressed bytes")
    data = decompress(body[8 : 8 + packed], size)
    at, fields = 0, {}
    for name, format in zip(header.names, header.formats, strict=True):
        layout = np.dtype(format)
        fields[name] = np.frombuffer(data, layout.base, header.points * layout.itemsize // layout.base.itemsize, at)
        at += header.points * layout.itemsize
    records = np.empty(header.points, [(name, fields[name].dtype) for name in "xyz"])
    for name in "xyz":
        records[name] = fields[name]
    return xyz_of(records)


BODIES = {"ascii": _ascii, "binary": _binary, "binary_compressed": _compressed}
