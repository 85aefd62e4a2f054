"""Deltas as bytes, losslessly. The layout is fixed by golden bytes in the tests; docs/delta-format.md describes it.

    "TFD" · version (1 byte) · header length (uint32 LE) · header (msgpack) · one zstd frame a tile · CRC-32 (uint32 LE)

A tile's frame holds the positions' gaps, then each field of the cells as a column. Columns are coded as differences to
the cell before (modulo 2ᵏ, so exactly), their bytes transposed: neighbours on the ground are alike, and zstd finds it.
A decoder trusts no length: everything is bounded before memory is taken, and any fault rejects the whole message.
"""

from __future__ import annotations

import struct
import zlib
from typing import Any, NamedTuple

import msgspec
import numpy as np
import zstandard

from terrafuse.errors import CodecError, DeltaError, LatticeError
from terrafuse.exchange.delta import Delta, MapId, TileCells, check_content
from terrafuse.kernels import columns
from terrafuse.types import Array, TileKey

MAGIC = b"TFD"
VERSION = 1
ZSTD_LEVEL = 3
MAX_MESSAGE = 1 << 30
MAX_CELLS = 1 << 24
"""In one message: 1.4 GB of elevation cells. What is larger travels as several deltas."""


class _Tile(msgspec.Struct, array_like=True, forbid_unknown_fields=True):
    x: int
    y: int
    level: int
    count: int
    size: int
    """Bytes of its frame."""


class _Header(msgspec.Struct, forbid_unknown_fields=True):
    model: str
    resolution_m: float
    tile_m: float
    crs: str | None
    robot: str
    since: int
    revision: int
    stamp_ns: int
    fields: list[tuple[str, str]]
    """Name and NumPy type (little endian) of each field of a cell."""
    tiles: list[_Tile]


_encode_header = msgspec.msgpack.Encoder().encode
_decode_header = msgspec.msgpack.Decoder(_Header).decode


def fields_of(dtype: np.dtype[np.void]) -> list[tuple[str, str]]:
    return [(name, dtype[name].str) for name in dtype.names or ()]


def _columns(records: Array) -> bytes:
    fields = columns.fields_of(records.dtype)
    out = np.empty(len(records) * int(fields.sizes.sum()), np.uint8)
    columns.to_columns(_bytes(records), *fields, out)
    return out.tobytes()


def _records(raw: Array, count: int, dtype: np.dtype[Any]) -> Array:
    records = np.zeros(count, dtype)
    columns.from_columns(raw, *columns.fields_of(dtype), _bytes(records))
    return records


def _bytes(records: Array) -> Array:
    return records.view(np.uint8).reshape(len(records), records.dtype.itemsize)


def pack_cells(at: Array, cells: Array) -> bytes:
    """Positions (K,) and records (K,) → one zstd frame."""
    raw = _columns(at.astype("<u4")) + _columns(np.ascontiguousarray(cells))
    return zstandard.ZstdCompressor(level=ZSTD_LEVEL).compress(raw)


def unpack_cells(frame: bytes, count: int, dtype: np.dtype[np.void], tile_cells: int) -> tuple[Array, Array]:
    """The inverse of `pack_cells`; raises CodecError unless the frame holds exactly `count` cells of a tile."""
    if not 0 < count <= tile_cells * tile_cells:
        raise CodecError(f"a tile of {tile_cells}×{tile_cells} cells can't hold {count}")
    size = int(columns.fields_of(dtype).sizes.sum())
    try:
        if zstandard.frame_content_size(frame) != count * (4 + size):
            raise CodecError(f"a frame that does not hold {count} cells of {size} bytes")
        raw = zstandard.ZstdDecompressor().decompress(frame, max_output_size=count * (4 + size), allow_extra_data=False)
    except zstandard.ZstdError as error:
        raise CodecError(f"a damaged frame: {error}") from error
    whole = np.frombuffer(raw, np.uint8)
    at = _records(whole[: 4 * count], count, np.dtype("<u4")).astype(np.int64)
    if at[-1] >= tile_cells * tile_cells or (np.diff(at) <= 0).any():
        raise CodecError("positions that do not rise within their tile")
    return at.astype(np.int32), _records(whole[4 * count :], count, dtype)


def encode(delta: Delta) -> bytes:
    """The delta as bytes; equal deltas give equal bytes."""
    frames = [pack_cells(tile.at, tile.cells) for tile in delta.tiles]
    header = _Header(
        **{name: getattr(delta.map, name) for name in ("model", "resolution_m", "tile_m", "crs")},
        robot=delta.robot,
        since=delta.since,
        revision=delta.revision,
        stamp_ns=delta.stamp_ns,
        fields=fields_of(delta.tiles[0].cells.dtype) if delta.tiles else [],
        tiles=[_Tile(*tile.key, len(tile.at), len(frame)) for tile, frame in zip(delta.tiles, frames, strict=True)],
    )
    head = _encode_header(header)
    body = b"".join([MAGIC, bytes([VERSION]), struct.pack("<I", len(head)), head, *frames])
    return body + struct.pack("<I", zlib.crc32(body))


def decode(message: bytes, cell: np.dtype[np.void]) -> Delta:
    """Bytes → delta of records of the dtype `cell`. Raises CodecError for anything but a whole, well-formed message."""
    header, body_at = _head(message)
    if header.tiles and header.fields != fields_of(cell):
        raise CodecError(f"cells of '{header.model}' with fields {header.fields}, not {fields_of(cell)}")
    try:
        map_ = MapId(header.model, header.resolution_m, header.tile_m, header.crs)
        side = map_.lattice.tile_cells
    except LatticeError as error:
        raise CodecError(f"an impossible lattice: {error}") from error
    if sum(tile.size for tile in header.tiles) != len(message) - 4 - body_at or any(t.size < 0 for t in header.tiles):
        raise CodecError("frames that do not fill the message")
    if sum(tile.count for tile in header.tiles) > MAX_CELLS:
        raise CodecError(f"more than {MAX_CELLS} cells in one message")
    tiles = []
    for tile in header.tiles:
        frame = message[body_at : body_at + tile.size]
        body_at += tile.size
        at, cells = unpack_cells(frame, tile.count, cell, side)
        tiles.append(TileCells(TileKey(tile.x, tile.y, tile.level), at, cells))
    delta = Delta(map_, header.robot, header.since, header.revision, header.stamp_ns, tuple(tiles))
    try:
        check_content(delta)
    except DeltaError as error:
        raise CodecError(str(error)) from error
    return delta


class Heading(NamedTuple):
    """Whose delta it is, and from which revision to which."""

    robot: str
    since: int
    revision: int


def heading(message: bytes) -> Heading:
    """What a delta's header says; its cells stay packed. Raises CodecError for bytes without a readable one."""
    header, _ = _head(message)
    return Heading(header.robot, header.since, header.revision)


def _head(message: bytes) -> tuple[_Header, int]:
    """The checked header, and where the frames begin."""
    if len(message) < 12 or len(message) > MAX_MESSAGE or message[:3] != MAGIC:
        raise CodecError("not a terrafuse delta")
    if message[3] != VERSION:
        raise CodecError(f"a delta of format version {message[3]}; this terrafuse reads version {VERSION}")
    if zlib.crc32(message[:-4]) != struct.unpack("<I", message[-4:])[0]:
        raise CodecError("a damaged delta: its checksum is wrong")
    (length,) = struct.unpack("<I", message[4:8])
    if 8 + length > len(message) - 4:
        raise CodecError("a header longer than its message")
    try:
        header = _decode_header(message[8 : 8 + length])
    except (msgspec.DecodeError, msgspec.ValidationError) as error:
        raise CodecError(f"a header that can't be read: {error}") from error
    return header, 8 + length
