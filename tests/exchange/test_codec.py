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
from terrafuse.exchange.codec import decode, encode, pack_cells, unpack_cells
from terrafuse.exchange.delta import Delta
from terrafuse.models import make_model
from terrafuse.testing.deltas import deltas_of, random_scans
from terrafuse.testing.stores import LATTICE, MODEL
from tests.exchange.make_golden import golden_delta, parts

CELL = make_model("elevation").cell

GOLDEN = bytes.fromhex(
    # magic
    "544644"
    # format version
    "01"
    # header length
    "59010000"
    # header, msgpack
    "8aa56d6f64656ca9656c65766174696f6eac7265736f6c7574696f6e5f6dcb3ff0000000000000a674696c655f6dcb40"
    "10000000000000a3637273c0a5726f626f74a27231a573696e636500a87265766973696f6e02a87374616d705f6e73ce"
    "77359400a66669656c6473dc001092a16ea33c753492a57a5f6d696ea33c693492a57a5f6d6178a33c693492a573715f"
    "6869a33c753492a57a5f73756da33c693892a573715f6c6fa33c753892a57374616d70a33c693892a87265766973696f"
    "6ea33c753492a76368616e676573a33c753492a66d6572676573a33c753492a867726f756e645f6ea33c753492ac6772"
    "6f756e645f7a5f6d696ea33c693492ac67726f756e645f7a5f6d6178a33c693492ac67726f756e645f73715f6869a33c"
    "753492ac67726f756e645f7a5f73756da33c693892ac67726f756e645f73715f6c6fa33c7538a574696c65739295ff00"
    "00013495000000025e"
    # frames, zstd, one a tile
    "28b52ffd20585d0100b00300000001000000c0f2fcff0000902f5009ca9a3b00080020941586a50ca8d8a0698ab3f192"
    "77cb250128b52ffd20b0ad020034030006000100404042d80ff600ff00001030a519d46ce83c9436356577c4020140c0"
    "0df203fc90702fd050af09f600ff00ff00ff0d0060c34e861517b0b2d5cc7a4d3936d483339fe4b4b5b38b15c2c1e00b"
    "0c01"
    # CRC-32 of all before
    "888b145e"
)
"""Made by tests/exchange/make_golden.py. Bytes that were once written must be read for ever."""


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


def test_golden_bytes_are_read() -> None:
    delta = decode(GOLDEN, CELL)
    assert_equal(delta, golden_delta())
    assert delta.robot == "r1"
    assert [tuple(tile.key) for tile in delta.tiles] == [(-1, 0, 0), (0, 0, 0)]
    np.testing.assert_array_equal(delta.tiles[1].at, [0, 6])
    np.testing.assert_array_equal(delta.tiles[1].cells["n"], [1, 1])
    np.testing.assert_array_equal(delta.tiles[1].cells["z_max"], [1_000_000, 400_000])
    np.testing.assert_array_equal(delta.tiles[1].cells["ground_z_max"], [200_000, 0])
    np.testing.assert_array_equal(delta.tiles[1].cells["changes"], [1, 0])


def test_golden_bytes_are_written() -> None:
    """All but the frames, whose bytes are the compressor's business; their content is compared."""
    written, golden = dict(parts(encode(golden_delta()))), dict(parts(GOLDEN))
    frames = "frames, zstd, one a tile"
    assert _content(written.pop(frames)) == _content(golden.pop(frames))
    header = [msgspec.msgpack.decode(side.pop("header, msgpack")) for side in (written, golden)]
    for head in header:
        for tile in head["tiles"]:
            del tile[-1]  # the frame's size
    assert header[0] == header[1]
    assert written["magic"] == golden["magic"] == b"TFD"
    assert written["format version"] == golden["format version"] == bytes([1])


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
    message = bytearray(GOLDEN)
    place = data.draw(st.integers(0, len(message) - 1))
    message[place] ^= data.draw(st.integers(1, 255))
    with pytest.raises(CodecError):
        decode(bytes(message), CELL)


@given(st.integers(0, len(GOLDEN) - 1))
def test_a_cut_message_is_rejected(length: int) -> None:
    with pytest.raises(CodecError):
        decode(GOLDEN[:length], CELL)


@given(st.binary(max_size=400))
@settings(max_examples=300)
def test_noise_is_rejected(noise: bytes) -> None:
    with pytest.raises(CodecError):
        decode(noise, CELL)


def sealed(header: dict[str, object], frames: bytes = b"") -> bytes:
    """A message with a right checksum, whatever it says."""
    head = msgspec.msgpack.encode(header)
    body = b"TFD" + bytes([1]) + struct.pack("<I", len(head)) + head + frames
    return body + struct.pack("<I", zlib.crc32(body))


def golden_header(**changes: object) -> dict[str, object]:
    (length,) = struct.unpack("<I", GOLDEN[4:8])
    return msgspec.msgpack.decode(GOLDEN[8 : 8 + length]) | changes


FRAMES = dict(parts(GOLDEN))["frames, zstd, one a tile"]
FIRST = golden_header()["tiles"][0][-1]  # bytes of the first frame


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"tiles": [[0, 0, 0, 17, len(FRAMES)]]}, "can't hold"),
        ({"tiles": [[0, 0, 0, 2**40, len(FRAMES)]]}, "more than"),
        ({"tiles": [[2**62, 0, 0, 1, FIRST], [2**62 + 1, 0, 0, 2, len(FRAMES) - FIRST]]}, "not on the lattice"),
        ({"tiles": [[-1, 0, 3, 1, FIRST], [0, 0, 3, 2, len(FRAMES) - FIRST]]}, "not on the lattice"),
        ({"tiles": [[0, 0, 0, 1, FIRST], [0, 0, 0, 2, len(FRAMES) - FIRST]]}, "tiles that do not rise"),
        ({"resolution_m": 1e-300, "tile_m": 1e300}, "impossible lattice"),
        ({"robot": "a\nb"}, "printable"),
        ({"tiles": [[0, 0, 0, 0, len(FRAMES)]]}, "can't hold"),
        ({"tiles": [[0, 0, 0, -1, len(FRAMES)]]}, "can't hold"),
        ({"tiles": [[0, 0, 0, 2, 10**9]]}, "do not fill"),
        ({"tiles": [[0, 0, 0, 2, -5], [0, 0, 0, 2, len(FRAMES) + 5]]}, "do not fill"),
        ({"tiles": [[0, 0, 0, 16, len(FRAMES)]]}, "does not hold 16"),
        ({"resolution_m": float("nan")}, "impossible lattice"),
        ({"resolution_m": 1e-9}, "impossible lattice"),
        ({"resolution_m": 0.3}, "impossible lattice"),
        ({"since": 5, "revision": 2}, "impossible revisions"),
        ({"revision": 2**40}, "impossible revisions"),
        ({"stamp_ns": -1}, "impossible revisions"),
        ({"revision": 1}, "newer than the delta"),
        ({"robot": ""}, "name"),
        ({"robot": "x" * 201}, "name"),
        ({"robot": 7}, "can't be read"),
        ({"surprise": 1}, "can't be read"),
        ({"fields": [["n", "<u4"]]}, "fields"),
    ],
)
def test_lies_with_a_right_checksum_are_rejected(changes: dict[str, object], reason: str) -> None:
    assert decode(sealed(golden_header(), FRAMES), CELL).cell_count == 3
    with pytest.raises(CodecError, match=reason):
        decode(sealed(golden_header(**changes), FRAMES), CELL)


def test_a_bomb_is_not_unpacked() -> None:
    bomb = zstandard.ZstdCompressor(write_content_size=False).compress(bytes(10**8))
    with pytest.raises(CodecError):
        decode(sealed(golden_header(tiles=[[0, 0, 0, 2, len(bomb)]]), bomb), CELL)


def test_positions_must_rise_within_the_tile() -> None:
    cells = np.zeros(2, CELL)
    for at in ([3, 3], [5, 2], [0, 16]):
        frame = pack_cells(np.array(at, np.int32), cells)
        with pytest.raises(CodecError, match="do not rise"):
            unpack_cells(frame, 2, CELL, 4)


def test_another_version_is_refused_clearly() -> None:
    message = GOLDEN[:3] + bytes([9]) + GOLDEN[4:]
    with pytest.raises(CodecError, match="format version 9; this terrafuse reads version 1"):
        decode(message, CELL)


def test_an_empty_delta_travels() -> None:
    (delta,) = deltas_of("r1", random_scans(1, 1), LATTICE, MODEL)
    empty = Delta(delta.map, "r1", 1, 1, delta.stamp_ns, ())
    assert_equal(decode(encode(empty), CELL), empty)


def test_bytes_after_a_frame_are_rejected() -> None:
    frame = pack_cells(np.array([1], np.int32), np.ones(1, CELL))
    unpack_cells(frame, 1, CELL, 4)
    with pytest.raises(CodecError):
        unpack_cells(frame + b"more", 1, CELL, 4)
