"""Deltas as bytes: lossless, bounded, and the same tomorrow."""

from __future__ import annotations

import struct
import zlib

import msgspec
import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st

from terrafuse.errors import CodecError
from terrafuse.exchange.codec import START, VERSION, decode, encode, heading, pack_cells, unpack_cells
from terrafuse.exchange.delta import Delta, check_content
from terrafuse.models import make_model
from terrafuse.testing.deltas import deltas_of, random_scans
from terrafuse.testing.stores import LATTICE, MODEL
from tests.exchange.golden import GOLDEN
from tests.exchange.make_golden import MODELS, NAMES, golden_delta, parts

CELL = make_model("elevation").cell

EXACT = GOLDEN["elevation exact"]


def assert_equal(one: Delta, other: Delta) -> None:
    assert (one.map, one.robot, one.since, one.revision, one.stamp_ns) == (
        other.map,
        other.robot,
        other.since,
        other.revision,
        other.stamp_ns,
    )
    assert [tile.key for tile in one.tiles] == [tile.key for tile in other.tiles]
    for a, b in zip(one.tiles, other.tiles, strict=True):
        np.testing.assert_array_equal(a.at, b.at)
        np.testing.assert_array_equal(a.cells, b.cells)


@pytest.mark.parametrize("name", NAMES)
def test_golden_bytes_are_read(name: str) -> None:
    model, form = name.split()
    assert heading(GOLDEN[name]).form == form
    assert_equal(decode(GOLDEN[name], MODELS[model].cell), golden_delta(name))


def test_golden_bytes_hold_what_was_seen() -> None:
    delta = decode(EXACT, CELL)
    assert delta.robot == "r1"
    assert [tuple(tile.key) for tile in delta.tiles] == [(-1, 0, 0), (0, 0, 0)]
    np.testing.assert_array_equal(delta.tiles[1].at, [0, 6])
    np.testing.assert_array_equal(delta.tiles[1].cells["n"], [2, 1])
    np.testing.assert_array_equal(delta.tiles[1].cells["z_max"], [1_040_000, 400_000])
    np.testing.assert_array_equal(delta.tiles[1].cells["ground_z_max"], [206_000, 0])
    np.testing.assert_array_equal(delta.tiles[1].cells["changes"], [1, 0])
    lean = decode(GOLDEN["elevation lean"], CELL)
    # 5.0 and 5.2 m have a mean of 5.10 m; -1.0 and -1.4 one of -1.20 m; 2 points each.
    np.testing.assert_array_equal(lean.tiles[1].cells["z_sum"], [2 * 1_020_000, 400_000])
    np.testing.assert_array_equal(lean.tiles[0].cells["z_sum"], [2 * -240_000])


@pytest.mark.parametrize("name", NAMES)
def test_golden_bytes_are_written(name: str) -> None:
    """All but the frames of the exact form, whose bytes are the compressor's business; their content is compared."""
    message, golden = encode(golden_delta(name)), GOLDEN[name]
    if not name.endswith("exact"):
        assert message == golden
        return
    written, known = dict(parts(message)), dict(parts(golden))
    assert _content(written["body"]) == _content(known["body"])
    heads = [msgspec.msgpack.decode(side["header, msgpack"]) for side in (written, known)]
    assert heads[0][:-1] == heads[1][:-1]  # last are the frames' sizes
    assert message[:5] == golden[:5] == b"TFD\x04\x00"


def _content(frames: bytes) -> bytes:
    return zstandard.ZstdDecompressor().stream_reader(frames, read_across_frames=True).read()


@given(seed=st.integers(0, 2**32), scans=st.integers(1, 6), static=st.booleans())
@settings(max_examples=30)
def test_round_trip(seed: int, scans: int, static: bool) -> None:
    for delta in deltas_of("robot ä", random_scans(seed, scans), LATTICE, make_model("elevation", {"static": static})):
        message = encode(delta)
        assert_equal(decode(message, CELL), delta)
        assert encode(decode(message, CELL)) == message


@given(st.data())
@settings(max_examples=50)
def test_any_record_survives(data: st.DataObject) -> None:
    count = data.draw(st.integers(1, 64))
    raw = data.draw(st.binary(min_size=count * CELL.itemsize, max_size=count * CELL.itemsize))
    positions = np.array(sorted(data.draw(st.permutations(range(64)))[:count]), np.int32)
    cells = np.frombuffer(raw, CELL)
    back_at, back = unpack_cells(pack_cells(positions, cells), count, CELL, 8)
    np.testing.assert_array_equal(back_at, positions)
    assert back.tobytes() == cells.tobytes()


@given(st.data())
@settings(max_examples=300)
def test_a_flipped_byte_is_rejected(data: st.DataObject) -> None:
    message = bytearray(GOLDEN[data.draw(st.sampled_from(["elevation exact", "elevation lean"]))])
    place = data.draw(st.integers(0, len(message) - 1))
    message[place] ^= data.draw(st.integers(1, 255))
    with pytest.raises(CodecError):
        decode(bytes(message), CELL)


@pytest.mark.parametrize("name", ["elevation exact", "elevation lean"])
def test_a_cut_message_is_rejected(name: str) -> None:
    for length in range(len(GOLDEN[name])):
        with pytest.raises(CodecError):
            decode(GOLDEN[name][:length], CELL)


@given(st.binary(max_size=400))
@settings(max_examples=300)
def test_noise_is_rejected(noise: bytes) -> None:
    with pytest.raises(CodecError):
        decode(noise, CELL)


def sealed(name: str, body: bytes | None = None, **changes: object) -> bytes:
    """A golden message with other fields in its header, and a right checksum."""
    golden = dict(parts(GOLDEN[name]))
    fields = msgspec.msgpack.decode(golden["header, msgpack"])
    known = COMMON + (EXACTLY if name.endswith("exact") else ROUNDED)
    values = dict(zip(known, fields, strict=True)) | changes
    head = msgspec.msgpack.encode(list(values.values()))
    start = START.pack(b"TFD", VERSION, golden["form"][0], len(head))
    whole = start + head + (golden["body"] if body is None else body)
    return whole + struct.pack("<I", zlib.crc32(whole))


COMMON = ["model", "resolution_m", "tile_m", "crs", "robot", "revision", "span", "stamp_ns"]
EXACTLY, ROUNDED = ["tiles", "fields", "sizes"], ["tiles", "cells", "pairs", "digits"]
FRAMES = dict(parts(EXACT))["body"]
FIRST = msgspec.msgpack.decode(dict(parts(EXACT))["header, msgpack"])[-1][0]
SIZES = [FIRST, len(FRAMES) - FIRST]
BOTH = [
    ({"resolution_m": 1e-300, "tile_m": 1e300}, "impossible lattice"),
    ({"resolution_m": float("nan")}, "impossible lattice"),
    ({"resolution_m": 1e-9}, "impossible lattice"),
    ({"resolution_m": 0.3}, "impossible lattice"),
    ({"robot": "a\nb"}, "printable"),
    ({"robot": ""}, "name"),
    ({"robot": "x" * 201}, "name"),
    ({"robot": 7}, "can't be read"),
    ({"surprise": 1}, "can't be read"),
    ({"span": -1}, "impossible revisions"),
    ({"span": 3}, "impossible revisions"),
    ({"revision": 2**40}, "impossible revisions"),
    ({"revision": 1, "span": 0}, "newer than the delta"),
]


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        *BOTH,
        ({"stamp_ns": -1}, "impossible revisions"),
        ({"tiles": [[0, 0, 0, 17]], "sizes": [len(FRAMES)]}, "can't hold"),
        ({"tiles": [[0, 0, 0, 2**40]], "sizes": [len(FRAMES)]}, "more than"),
        ({"tiles": [[2**62, 0, 0, 1], [2**62 + 1, 0, 0, 2]]}, "not on the lattice"),
        ({"tiles": [[-1, 0, 3, 1], [0, 0, 3, 2]]}, "not on the lattice"),
        ({"tiles": [[0, 0, 0, 1], [0, 0, 0, 2]]}, "tiles that do not rise"),
        ({"tiles": [[0, 0, 0, 0]], "sizes": [len(FRAMES)]}, "can't hold"),
        ({"tiles": [[0, 0, 0, -1]], "sizes": [len(FRAMES)]}, "can't hold"),
        ({"sizes": [FIRST, 10**9]}, "do not fill"),
        ({"sizes": [-5, len(FRAMES) + 5]}, "do not fill"),
        ({"sizes": [len(FRAMES)]}, "do not fill"),
        ({"tiles": [[0, 0, 0, 16]], "sizes": [len(FRAMES)]}, "does not hold 16"),
        ({"fields": [["n", "<u4"]]}, "fields"),
    ],
)
def test_lies_with_a_right_checksum_are_rejected(changes: dict[str, object], reason: str) -> None:
    assert decode(sealed("elevation exact"), CELL).cell_count == 3
    with pytest.raises(CodecError, match=reason):
        decode(sealed("elevation exact", **changes), CELL)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        *BOTH,
        ({"stamp_ns": -(10**10)}, "before 1970"),
        ({"stamp_ns": 2**63}, "beyond 63 bits"),
        ({"digits": 10}, r"10\^10 ns"),
        ({"digits": -1}, r"10\^-1 ns"),
        ({"model": "mine"}, "form 'lean', which"),
        ({"model": "grey"}, "fields|does not hold"),
        ({"tiles": 0, "cells": 0}, "can't hold 0"),
        ({"tiles": -1}, "-1 tiles"),
        ({"tiles": 4, "cells": 3}, "can't hold"),
        ({"cells": 2**40}, "more than"),
        ({"cells": 33}, "can't hold 33"),
        ({"cells": 4}, "does not hold"),
        ({"cells": 2}, "does not hold"),
        ({"tiles": 1}, "does not hold"),
        ({"tiles": 3}, "does not hold"),
        ({"pairs": 1}, "does not hold"),
        ({"pairs": 3}, "does not hold"),
        ({"pairs": 0}, "0 stamps"),
        ({"pairs": 4}, "4 stamps"),
    ],
)
def test_lies_about_rounded_cells_are_rejected(changes: dict[str, object], reason: str) -> None:
    with pytest.raises(CodecError, match=reason):
        decode(sealed("elevation lean", **changes), CELL)


@given(st.binary(max_size=60), st.integers(1, 4), st.integers(1, 64))
@settings(max_examples=500)
def test_a_body_of_noise_is_rejected_or_keeps_the_laws(noise: bytes, tiles: int, cells: int) -> None:
    """A body may spell anything: what comes out is a delta that could be, or an error."""
    try:
        delta = decode(sealed("elevation lean", noise, tiles=tiles, cells=cells), CELL)
    except CodecError:
        return
    check_content(delta)


def test_more_cells_than_asked_for_are_refused() -> None:
    for name in ("elevation exact", "elevation lean"):
        assert decode(GOLDEN[name], CELL, most_cells=3).cell_count == 3
        with pytest.raises(CodecError, match="more than 2 cells"):
            decode(GOLDEN[name], CELL, most_cells=2)


def test_a_bomb_is_not_unpacked() -> None:
    bomb = zstandard.ZstdCompressor(write_content_size=False).compress(bytes(10**8))
    with pytest.raises(CodecError):
        decode(sealed("elevation exact", bomb, tiles=[[0, 0, 0, 2]], sizes=[len(bomb)]), CELL)


def test_positions_must_rise_within_the_tile() -> None:
    cells = np.zeros(2, CELL)
    for at in ([3, 3], [5, 2], [0, 16]):
        frame = pack_cells(np.array(at, np.int32), cells)
        with pytest.raises(CodecError, match="do not rise"):
            unpack_cells(frame, 2, CELL, 4)


def test_another_version_is_refused_clearly() -> None:
    for message in (EXACT[:3] + bytes([9]) + EXACT[4:], b"TFD\x01" + bytes(20)):
        version = message[3]
        with pytest.raises(CodecError, match=f"format version {version}; this terrafuse reads version 4"):
            decode(message, CELL)


def test_another_form_is_refused_clearly() -> None:
    body = EXACT[:4] + bytes([7]) + EXACT[5:-4]
    with pytest.raises(CodecError, match="form 7; this terrafuse reads 0, 1, 2"):
        decode(body + struct.pack("<I", zlib.crc32(body)), CELL)


def test_cells_of_another_kind_are_refused() -> None:
    for form in ("exact", "full", "lean"):
        with pytest.raises(CodecError, match="fields"):
            decode(GOLDEN[f"elevation {form}"], make_model("grey").cell)


def test_the_heading_says_what_is_inside() -> None:
    map_ = golden_delta().map
    for form in ("exact", "full", "lean"):
        assert heading(GOLDEN[f"elevation {form}"]) == (map_, form, "r1", 0, 2, 2_000_000_000, 2, 3)


def test_an_empty_delta_travels() -> None:
    (delta,) = deltas_of("r1", random_scans(1, 1), LATTICE, MODEL)
    empty = Delta(delta.map, "r1", 1, 1, delta.stamp_ns, ())
    assert_equal(decode(encode(empty), CELL), empty)


def test_bytes_after_a_frame_are_rejected() -> None:
    frame = pack_cells(np.array([1], np.int32), np.ones(1, CELL))
    unpack_cells(frame, 1, CELL, 4)
    with pytest.raises(CodecError):
        unpack_cells(frame + b"more", 1, CELL, 4)
