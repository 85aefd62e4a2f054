"""Files of points: each format in each of its encodings, and each way to be broken."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from terrafuse.errors import LogError
from terrafuse.logs.points.lzf import decompress
from terrafuse.logs.points.pcd import read_pcd
from terrafuse.logs.points.ply import read_ply
from terrafuse.logs.points.raw import read_bin, read_npy
from terrafuse.logs.points.table import is_table, read_table
from terrafuse.types import Array

from .support import some_points

POINTS = some_points(11)
POINTS[3] = np.nan
DOUBLES = some_points(11, dtype=np.float64) * 1e5


def compress(data: bytes) -> bytes:
    """A plain LZF encoder, to test the decoder with: greedy, back references found through a dictionary."""
    out, literals, seen, at = bytearray(), bytearray(), dict[bytes, int](), 0

    def flush() -> None:
        for start in range(0, len(literals), 32):
            run = literals[start : start + 32]
            out.extend(bytes([len(run) - 1]) + run)
        literals.clear()

    while at < len(data):
        start = seen.get(data[at : at + 3], -1)
        length = 0
        if start >= 0 and at - start <= 8192 and at + 3 <= len(data):
            length = 3
            while at + length < len(data) and length < 264 and data[start + length] == data[at + length]:
                length += 1
        seen[data[at : at + 3]] = at
        if not length:
            literals.append(data[at])
            at += 1
            continue
        flush()
        offset, code = at - start - 1, length - 2
        head = [min(code, 7) << 5 | offset >> 8] + ([code - 7] if code >= 7 else [])
        out.extend(bytes([*head, offset & 255]))
        at += length
    flush()
    return bytes(out)


@given(st.one_of(st.binary(max_size=600), st.lists(st.sampled_from([b"abc", b"a", b"\0" * 40])).map(b"".join)))
def test_lzf_unpacks_what_was_packed(data: bytes) -> None:
    assert decompress(compress(data), len(data)) == data


def test_lzf_golden_bytes() -> None:
    packed = bytes(
        [
            0x02, *b"abc",  # three literals
            0x20, 0x02,  # length 1 + 2, offset 2 + 1: "abc" again
            0xE0, 0x01, 0x00,  # length 7 + 1 + 2, offset 0 + 1: the last byte, ten times
        ]
    )  # fmt: skip
    assert decompress(packed, 16) == b"abcabc" + b"c" * 10


@pytest.mark.parametrize(
    ("packed", "size", "why"),
    [(b"\x00", 1, "unpacks to 0 bytes"), (b"\x20\x05", 3, "before the start"), (b"\x00a", 2, "unpacks to 1 bytes")],
)
def test_lzf_refuses_what_is_broken(packed: bytes, size: int, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        decompress(packed, size)


# --- PCD ---

PCD_KINDS = {"f": "F", "i": "I", "u": "U"}


def pcd(path: Path, records: Any, encoding: str, points: int | None = None, comment: str = "# .PCD v0.7\n") -> Path:
    fields = {name: records.dtype.fields[name][0] for name in records.dtype.names}
    header = (
        f"{comment}VERSION 0.7\nFIELDS {' '.join('_' if name.startswith('_') else name for name in fields)}\n"
        f"SIZE {' '.join(str(kind.base.itemsize) for kind in fields.values())}\n"
        f"TYPE {' '.join(PCD_KINDS[kind.base.kind] for kind in fields.values())}\n"
        f"COUNT {' '.join(str(int(np.prod(kind.shape, dtype=int))) for kind in fields.values())}\n"
        f"WIDTH {len(records)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {points or len(records)}\nDATA {encoding}\n"
    )
    path.write_bytes(header.encode() + PCD_BODIES[encoding](records))
    return path


def pcd_ascii(records: Any) -> bytes:
    rows = [" ".join(str(v) for name in records.dtype.names for v in np.ravel(record[name])) for record in records]
    return ("\n".join(rows) + "\n").encode()


def pcd_compressed(records: Any) -> bytes:
    data = b"".join(np.ascontiguousarray(records[name]).tobytes() for name in records.dtype.names)
    packed = compress(data)
    return struct.pack("<II", len(packed), len(data)) + packed


PCD_BODIES: dict[str, Callable[[Any], bytes]] = {
    "ascii": pcd_ascii,
    "binary": lambda records: records.tobytes(),
    "binary_compressed": pcd_compressed,
}
LAYOUTS: dict[str, Any] = {
    "xyz": [("x", "f4"), ("y", "f4"), ("z", "f4")],
    "xyzi": [("x", "f4"), ("y", "f4"), ("z", "f4"), ("intensity", "u1")],
    "mixed": [("ring", "u2"), ("_1", "u1", (3,)), ("z", "f4"), ("t", "f8"), ("_2", "u1"), ("y", "f4"), ("x", "f4")],
    "doubles": [("x", "f8"), ("y", "f8"), ("z", "f8")],
}


def filled(layout: str, points: Array) -> Any:
    records = np.zeros(len(points), LAYOUTS[layout])
    for axis, name in enumerate("xyz"):
        records[name] = points[:, axis]
    return records


@pytest.mark.parametrize("encoding", PCD_BODIES)
@pytest.mark.parametrize("layout", LAYOUTS)
def test_pcd(tmp_path: Path, encoding: str, layout: str) -> None:
    points = DOUBLES if layout == "doubles" else POINTS
    found = read_pcd(pcd(tmp_path / "a.pcd", filled(layout, points), encoding))
    assert found.dtype == points.dtype
    assert np.array_equal(found, points, equal_nan=True)


@pytest.mark.parametrize("encoding", PCD_BODIES)
def test_an_empty_pcd(tmp_path: Path, encoding: str) -> None:
    assert read_pcd(pcd(tmp_path / "a.pcd", filled("xyz", POINTS[:0]), encoding)).shape == (0, 3)


@pytest.mark.parametrize("encoding", PCD_BODIES)
@pytest.mark.parametrize("cut", [4, 60, 131])
def test_a_cut_pcd(tmp_path: Path, encoding: str, cut: int) -> None:
    path = pcd(tmp_path / "a.pcd", filled("xyz", POINTS), encoding)
    if encoding == "ascii":
        cut = cut if cut > 60 else 40  # less leaves a shorter number, which no reader can notice
    path.write_bytes(path.read_bytes()[:-cut])
    with pytest.raises(LogError) as caught:
        read_pcd(path)
    assert str(path) in str(caught.value)
    assert "truncated, or not the 11 points of the header" in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        (b"FIELDS x y z", b"FIELDS x y intensity", "no columns x, y, z; it has x, y, intensity"),
        (b"FIELDS", b"FELDER", "not a PCD header"),
        (b"TYPE F F F", b"TYPE F F Q", "not a PCD header"),
        (b"SIZE 4 4 4", b"SIZE 4 4", "not a PCD header"),
        (b"DATA binary", b"DATA zipped", "DATA zipped is none of ascii, binary, binary_compressed"),
        (b"POINTS 11", b"POINTS x", "not a PCD header"),
    ],
)
def test_a_broken_pcd_header(tmp_path: Path, old: bytes, new: bytes, why: str) -> None:
    path = pcd(tmp_path / "a.pcd", filled("xyz", POINTS), "binary")
    path.write_bytes(path.read_bytes().replace(old, new))
    with pytest.raises(LogError, match=f"{path}: {why}"):
        read_pcd(path)


# --- PLY ---

PLY_TYPES = {"f4": "float", "f8": "double", "u1": "uchar", "u2": "ushort"}
PLY_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}


def ply(path: Path, records: Any, encoding: str, before: str = "", after: str = "", body: bytes = b"") -> Path:
    names = records.dtype.names
    properties = "".join(f"property {PLY_TYPES[records.dtype[name].str[1:]]} {name}\n" for name in names)
    header = (
        f"ply\nformat {encoding} 1.0\ncomment made here\n{before}element vertex {len(records)}\n{properties}{after}"
    )
    if encoding == "ascii":
        rows = "".join(" ".join(repr(value.item()) for value in record) + "\n" for record in records)
        data = rows.encode()
    else:
        order = PLY_ORDERS[encoding]
        data = records.astype([(name, order + records.dtype[name].str[1:]) for name in names]).tobytes()
    path.write_bytes(f"{header}end_header\n".encode() + body + data)
    return path


@pytest.mark.parametrize("encoding", ["ascii", *PLY_ORDERS])
@pytest.mark.parametrize("layout", ["xyz", "xyzi", "doubles"])
def test_ply(tmp_path: Path, encoding: str, layout: str) -> None:
    points = DOUBLES if layout == "doubles" else POINTS
    after = "element face 0\nproperty list uchar int vertex_indices\n"
    found = read_ply(ply(tmp_path / "a.ply", filled(layout, points), encoding, after=after))
    assert found.dtype == points.dtype
    assert np.array_equal(found, points, equal_nan=True)


@pytest.mark.parametrize("encoding", ["ascii", *PLY_ORDERS])
def test_elements_before_the_points_are_skipped(tmp_path: Path, encoding: str) -> None:
    before = "element camera 2\nproperty float fx\nproperty uchar id\n"
    body = b"1.0 2\n1.5 3\n" if encoding == "ascii" else bytes(10)
    found = read_ply(ply(tmp_path / "a.ply", filled("xyz", POINTS), encoding, before, body=body))
    assert np.array_equal(found, POINTS, equal_nan=True)


@pytest.mark.parametrize("encoding", ["ascii", *PLY_ORDERS])
def test_an_empty_and_a_cut_ply(tmp_path: Path, encoding: str) -> None:
    assert read_ply(ply(tmp_path / "a.ply", filled("xyz", POINTS[:0]), encoding)).shape == (0, 3)
    path = ply(tmp_path / "b.ply", filled("xyz", POINTS), encoding)
    path.write_bytes(path.read_bytes()[:-80])
    with pytest.raises(LogError, match=r"b\.ply: .*truncated, or not the 11 points of the header"):
        read_ply(path)


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        (b"property float z", b"property float w", "no columns x, y, z; it has x, y, w"),
        (b"binary_little_endian", b"packed", "format packed is none of ascii, binary_little_endian"),
        (b"ply\n", b"obj\n", "not a PLY header.*the first line is not 'ply'"),
        (b"element vertex", b"element point", "not a PLY header with an element vertex"),
        (b"end_header", b"head_end", "no end_header"),
        (b"property float x", b"property list uchar int x", "has a list property before the points end"),
        (b"property float x", b"property quad x", "not a PLY header"),
    ],
)
def test_a_broken_ply_header(tmp_path: Path, old: bytes, new: bytes, why: str) -> None:
    path = ply(tmp_path / "a.ply", filled("xyz", POINTS), "binary_little_endian")
    path.write_bytes(path.read_bytes().replace(old, new))
    with pytest.raises(LogError, match=f"{path}: .*{why}"):
        read_ply(path)


# --- text ---


@pytest.mark.parametrize(
    "text",
    [
        "1 2 3\n4 5 6\n",
        "1,2,3\n4,5,6",
        "  1.0e+00   2.0e+00   3.0e+00\n  4 5 6\n",
        "1;2;3;9\n4;5;6;9\n",
        "1\t2\t3\n4\t5\t6\n",
        "x,y,z,nx,ny,nz\n1 , 2 , 3 , 0,0,1\n4 , 5 , 6 , 0,0,1\n",
        "t Z Y X\n0 3 2 1\n0 6 5 4\n",
        '"x";"y";"z"\n1;2;3\n4;5;6\n',
        "//X,Y,Z\n1 2 3\n4 5 6\n",
        "# x y z\n1 2 3\n4 5 6\n",
        "# recorded by me\n\n1 2 3\n# half\n4 5 6\n",
        "\ufeffx,y,z\n1,2,3\n4,5,6\n",
    ],
)
def test_tables(tmp_path: Path, text: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text, encoding="utf-8")
    assert is_table(path)
    assert read_table(path).tolist() == [[1, 2, 3], [4, 5, 6]]


def test_a_table_keeps_doubles_and_nan(tmp_path: Path) -> None:
    path = tmp_path / "a.xyz"
    path.write_text("512700.123456789 5403547.987654321 nan\n")
    assert np.array_equal(read_table(path), [[512700.123456789, 5403547.987654321, np.nan]], equal_nan=True)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("1,2\n3,4\n", "2 columns; points need x, y, z"),
        ("range,bearing\n1,2\n", "no columns x, y, z; it has range, bearing"),
        ("# only\n# comments\n", "no line of numbers among the first 100"),
        ("", "no line of numbers"),
    ],
)
def test_what_is_no_table(tmp_path: Path, text: str, why: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text)
    assert not is_table(path)
    with pytest.raises(LogError, match=f"{path}: {why}"):
        read_table(path)


@pytest.mark.parametrize("bad", ["4 5", "4 5 six"])
def test_a_broken_row_of_a_table(tmp_path: Path, bad: str) -> None:
    path = tmp_path / "a.txt"
    path.write_text(f"1 2 3\n{bad}\n")
    with pytest.raises(LogError, match=f"{path}: .*each line needs the same columns of numbers"):
        read_table(path)


# --- arrays ---


@pytest.mark.parametrize(("dtype", "read"), [("f4", "f4"), ("f8", "f8"), ("f2", "f4"), ("i4", "f8"), (">f4", "f4")])
def test_npy(tmp_path: Path, dtype: str, read: str) -> None:
    values = np.arange(20).reshape(5, 4).astype(dtype)
    np.save(tmp_path / "a.npy", values)
    found = read_npy(tmp_path / "a.npy")
    assert found.dtype == read
    assert np.array_equal(found, values[:, :3])


@pytest.mark.parametrize("values", [np.zeros(3), np.zeros((4, 2)), np.zeros((2, 3, 3)), np.array([["a", "b", "c"]])])
def test_other_arrays_are_no_points(tmp_path: Path, values: Any) -> None:
    np.save(tmp_path / "a.npy", values)
    with pytest.raises(LogError, match=r"points are numbers in \(N, 3 or more\)"):
        read_npy(tmp_path / "a.npy")


def test_broken_npy(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", POINTS)
    path = tmp_path / "a.npy"
    whole = path.read_bytes()
    for broken in (whole[:-5], whole[:20], b"", b"hello"):
        path.write_bytes(broken)
        with pytest.raises(LogError, match=r"truncated, or not a plain \.npy array"):
            read_npy(path)
    np.save(path, np.array([object()]), allow_pickle=True)
    with pytest.raises(LogError, match=r"not a plain \.npy array"):
        read_npy(path)


@pytest.mark.parametrize("columns", [3, 4, 6])
def test_bin(tmp_path: Path, columns: int) -> None:
    values = np.arange(5 * columns, dtype="<f4").reshape(5, columns)
    values.tofile(tmp_path / "a.bin")
    assert np.array_equal(read_bin(tmp_path / "a.bin", columns), values[:, :3])
    (tmp_path / "a.bin").write_bytes(values.tobytes()[:-1])
    with pytest.raises(LogError, match=f"no whole number of points of {columns} float32"):
        read_bin(tmp_path / "a.bin", columns)


def test_the_encoder_of_these_tests_uses_back_references() -> None:
    noise = random.Random(0).randbytes(50)
    assert len(compress(noise * 20)) < 200
