"""Deltas as bytes, losslessly. The layout is fixed by golden bytes in the tests; docs/delta-format.md describes it.

    "TFD" · version · form · header length (uint32 LE) · header (msgpack) · body · CRC-32 (uint32 LE)

A delta whose cells a profile has rounded takes that profile's form: the body is its numbers, differences to neighbours
in short codes (`exchange.profiles`, `kernels.entropy`). Any other takes the form `exact`: a zstd frame a tile, of
columns. Which one is seen by the cells, so that who passes a delta on needs no knowledge of how it was made.

A decoder trusts no length: everything is bounded before memory is taken, and any fault rejects the whole message.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from functools import lru_cache
from itertools import accumulate, pairwise
from math import gcd
from typing import Any, NamedTuple

import msgspec
import numpy as np
import zstandard

from terrafuse.errors import CodecError, DeltaError, LatticeError
from terrafuse.exchange.delta import MAX_REVISION, Delta, MapId, TileCells, check_content, check_outline
from terrafuse.exchange.profiles import CODES, EXACT, PROFILES, Profile
from terrafuse.kernels import columns, content, entropy
from terrafuse.tile import opaque
from terrafuse.types import Array, TileKey

MAGIC = b"TFD"
VERSION = 4
ZSTD_LEVEL = 3
MAX_MESSAGE = 1 << 30
MAX_CELLS = 1 << 24
"""In one message: 1.4 GB of elevation cells. What is larger travels as several deltas."""
START = struct.Struct("<3sBBI")
"""Magic, version, form, length of the header."""
TABLE_ROWS, LOW = 3, 2**32 - 1
"""Of stamps and revisions, the newest first: by how many revisions it is older than the one before, and by how many
units, folded, in two words."""
MOST_DIGITS = 9
SAMPLE = 16
"""Cells that most often tell that a profile has not rounded them."""
FORMS = {code: name for name, code in CODES.items()}


class _Tile(msgspec.Struct, array_like=True, forbid_unknown_fields=True):
    x: int
    y: int
    level: int
    count: int


class _Header(msgspec.Struct, array_like=True, forbid_unknown_fields=True):
    model: str
    resolution_m: float
    tile_m: float
    crs: str | None
    robot: str
    revision: int
    span: int
    """How far back `since` lies: most often little."""
    stamp_ns: int

    @property
    def since(self) -> int:
        return self.revision - self.span


class _Exact(_Header):
    tiles: list[_Tile]
    fields: list[tuple[str, str]]
    """Name and NumPy type (little endian) of each field of a cell."""
    sizes: list[int]
    """Bytes of each tile's frame."""

    @property
    def size(self) -> tuple[int, int]:
        """Tiles and cells."""
        return len(self.tiles), sum(tile.count for tile in self.tiles)


class _Rounded(_Header):
    tiles: int
    cells: int
    pairs: int
    """Distinct stamps and revisions of cells."""
    digits: int
    """Stamps are a whole number of 10^digits ns away from `stamp_ns`."""

    @property
    def size(self) -> tuple[int, int]:
        return self.tiles, self.cells


_encode_header = msgspec.msgpack.Encoder().encode
_read_exact = msgspec.msgpack.Decoder(_Exact).decode
_read_rounded = msgspec.msgpack.Decoder(_Rounded).decode


class Heading(NamedTuple):
    """What a delta says of itself before its cells."""

    map: MapId
    form: str
    robot: str
    since: int
    revision: int
    stamp_ns: int
    tiles: int
    cells: int


def encode(delta: Delta) -> bytes:
    """The delta as bytes; equal deltas give equal bytes."""
    for name, profile in PROFILES.get(delta.map.model, {}).items():
        if (message := _encode_rounded(delta, name, profile)) is not None:
            return message
    return _encode_exact(delta)


def decode(message: bytes, cell: np.dtype[np.void], most_cells: int = MAX_CELLS) -> Delta:
    """Bytes → delta of records of the dtype `cell`. Raises CodecError for anything but a whole, well-formed message of
    at most so many cells."""
    form, header, body = _opened(message)
    if header.size[1] > most_cells:
        raise CodecError(f"more than {most_cells} cells in one message")
    map_ = _map(header)
    read = _rounded_tiles if isinstance(header, _Rounded) else _exact_tiles
    tiles = read(form, header, body, map_.lattice.tile_cells, cell)
    delta = Delta(map_, header.robot, header.since, header.revision, header.stamp_ns, tiles)
    try:
        # A rounded form can't say what is wrong with cells: they were checked as they were read.
        (check_outline if isinstance(header, _Rounded) else check_content)(delta)
    except DeltaError as error:
        raise CodecError(str(error)) from error
    return delta


def heading(message: bytes) -> Heading:
    """What a delta's header says; its cells stay packed. Raises CodecError for bytes without a readable one."""
    form, header, _ = _opened(message)
    return Heading(_map(header), form, header.robot, header.since, header.revision, header.stamp_ns, *header.size)


@lru_cache(maxsize=1)  # who asks for the heading, often wants the cells, too
def _opened(message: bytes) -> tuple[str, _Exact | _Rounded, memoryview]:
    """(form, header, body) of bytes that are whole."""
    if len(message) < START.size + 4 or len(message) > MAX_MESSAGE or message[:3] != MAGIC:
        raise CodecError("not a terrafuse delta")
    _, version, form, length = START.unpack_from(message)
    if version != VERSION:
        raise CodecError(f"a delta of format version {version}; this terrafuse reads version {VERSION}")
    view = memoryview(message)
    if zlib.crc32(view[:-4]) != struct.unpack("<I", view[-4:])[0]:
        raise CodecError("a damaged delta: its checksum is wrong")
    if START.size + length > len(message) - 4:
        raise CodecError("a header longer than its message")
    if form not in FORMS:
        raise CodecError(f"a delta of form {form}; this terrafuse reads {', '.join(map(str, FORMS))}")
    try:
        read = _read_rounded if form else _read_exact
        return FORMS[form], read(view[START.size : START.size + length]), view[START.size + length : -4]
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise CodecError(f"a header that can't be read: {error}") from error


def _map(header: _Header) -> MapId:
    return _map_of(header.model, header.resolution_m, header.tile_m, header.crs)


@lru_cache(64)
def _map_of(model: str, resolution_m: float, tile_m: float, crs: str | None) -> MapId:
    try:
        map_ = MapId(model, resolution_m, tile_m, crs)
        map_.lattice  # noqa: B018, it is checked when it is made
    except LatticeError as error:
        raise CodecError(f"an impossible lattice: {error}") from error
    return map_


def _sealed(form: str, header: _Header, bodies: Sequence[bytes]) -> bytes:
    head = _encode_header(header)
    body = b"".join([START.pack(MAGIC, VERSION, CODES[form], len(head)), head, *bodies])
    return body + struct.pack("<I", zlib.crc32(body))


def _common(delta: Delta) -> dict[str, Any]:
    return {
        "model": delta.map.model,
        "resolution_m": _short(delta.map.resolution_m),
        "tile_m": _short(delta.map.tile_m),
        "crs": delta.map.crs,
        "robot": delta.robot,
        "revision": delta.revision,
        "span": delta.revision - delta.since,
        "stamp_ns": delta.stamp_ns,
    }


def _short(number: float) -> float:
    """Whole numbers as such: eight bytes less."""
    return int(number) if number == int(number) else number


# --- exact ------------------------------------------------------------------------------------------------------------


def fields_of(dtype: np.dtype[np.void]) -> list[tuple[str, str]]:
    return [(name, dtype[name].str) for name in dtype.names or ()]


def _encode_exact(delta: Delta) -> bytes:
    frames = [pack_cells(tile.at, tile.cells) for tile in delta.tiles]
    fields = fields_of(delta.tiles[0].cells.dtype) if delta.tiles else []
    tiles = [_Tile(*tile.key, len(tile.at)) for tile in delta.tiles]
    header = _Exact(**_common(delta), tiles=tiles, fields=fields, sizes=[len(frame) for frame in frames])
    return _sealed(EXACT, header, frames)


def _exact_tiles(form: str, header: Any, body: memoryview, side: int, cell: np.dtype[np.void]) -> tuple[TileCells, ...]:
    if header.tiles and header.fields != fields_of(cell):
        raise CodecError(f"cells of '{header.model}' with fields {header.fields}, not {fields_of(cell)}")
    if (
        len(header.sizes) != len(header.tiles)
        or sum(header.sizes) != len(body)
        or any(size < 0 for size in header.sizes)
    ):
        raise CodecError("frames that do not fill the message")
    ends = accumulate(header.sizes)
    return tuple(
        TileCells(TileKey(tile.x, tile.y, tile.level), *unpack_cells(body[end - size : end], tile.count, cell, side))
        for tile, size, end in zip(header.tiles, header.sizes, ends, strict=True)
    )


def pack_cells(at: Array, cells: Array) -> bytes:
    """Positions (K,) and records (K,) → one zstd frame."""
    raw = _columns(at.astype("<u4")) + _columns(np.ascontiguousarray(cells))
    return zstandard.ZstdCompressor(level=ZSTD_LEVEL).compress(raw)


def unpack_cells(
    frame: bytes | memoryview, count: int, dtype: np.dtype[np.void], tile_cells: int
) -> tuple[Array, Array]:
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


# --- rounded ----------------------------------------------------------------------------------------------------------


def _encode_rounded(delta: Delta, name: str, profile: Profile) -> bytes | None:
    """None for cells that this profile has not rounded."""
    if not delta.tiles or any(tile.key.level for tile in delta.tiles):
        return None
    cells = np.concatenate([tile.cells for tile in delta.tiles])
    if _numbers_of(cells[:SAMPLE], profile) is None or (numbers := _numbers_of(cells, profile)) is None:
        return None
    stamps, revisions, seen = _pairs(cells)
    backs = [one - own for one, own in pairwise([delta.revision, *revisions])]
    ages = [one - own for one, own in pairwise([delta.stamp_ns, *stamps])]
    counts, digits = [len(tile.at) for tile in delta.tiles], _digits(gcd(*ages))
    header = _Rounded(**_common(delta), tiles=len(counts), cells=sum(counts), pairs=len(ages), digits=digits)
    folded = [_folded(age // 10**digits) for age in ages]
    whole = entropy.Unpacked(
        np.array([(tile.key.x, tile.key.y) for tile in delta.tiles], np.int64),
        np.cumsum([0, *counts]),
        np.array([backs, [age & LOW for age in folded], [age >> 32 for age in folded]], np.int64),
        np.concatenate([tile.at for tile in delta.tiles]).astype(np.int64),
        np.vstack([seen, numbers]),
    )
    return _sealed(name, header, [entropy.packed(whole, delta.map.lattice.tile_cells, profile.plan)])


def _numbers_of(cells: Array, profile: Profile) -> Array | None:
    numbers = profile.numbers(cells)
    again = profile.cells(numbers)
    again["stamp"], again["revision"] = cells["stamp"], cells["revision"]
    return numbers if profile.holds(numbers) and (opaque(again) == opaque(cells)).all() else None


def _digits(number: int) -> int:
    """How many zeros it ends in."""
    return next(digits for digits in reversed(range(MOST_DIGITS + 1)) if number % 10**digits == 0)


def _folded(number: int) -> int:
    return 2 * number if number >= 0 else -2 * number - 1


def _unfolded(number: int) -> int:
    return -(number + 1) // 2 if number & 1 else number // 2


def _pairs(cells: Array) -> tuple[list[int], list[int], Array]:
    """Stamps and revisions of the distinct pairs of both, the newest first; each cell's number among these."""
    stamps, stamp_of = np.unique(cells["stamp"], return_inverse=True)
    revisions, revision_of = np.unique(cells["revision"], return_inverse=True)
    pairs, seen = np.unique(revision_of * len(stamps) + stamp_of, return_inverse=True)
    which_revision, which_stamp = np.divmod(pairs[::-1], len(stamps))
    return stamps[which_stamp].tolist(), revisions[which_revision].tolist(), len(pairs) - 1 - seen


def _rounded_tiles(
    form: str, header: Any, body: memoryview, side: int, cell: np.dtype[np.void]
) -> tuple[TileCells, ...]:
    profile = PROFILES.get(header.model, {}).get(form)
    if profile is None:
        raise CodecError(f"cells of '{header.model}' in the form '{form}', which this terrafuse does not know")
    if not 0 < header.tiles <= header.cells <= header.tiles * side * side:
        raise CodecError(f"{header.tiles} tiles of {side}×{side} cells can't hold {header.cells}")
    if not 0 < header.pairs <= header.cells:
        raise CodecError(f"{header.pairs} stamps and revisions for {header.cells} cells")
    table = TABLE_ROWS, header.pairs
    found = entropy.unpacked(np.frombuffer(body, np.uint8), header.tiles, header.cells, table, side, profile.plan)
    if found is None:
        raise CodecError("a body that does not hold the cells that its header tells of")
    stamps, revisions = _table(header, found.table)
    cells = profile.cells(found.numbers[1:])
    if cells.dtype != cell:
        raise CodecError(f"cells of '{header.model}' with fields {fields_of(cells.dtype)}, not {fields_of(cell)}")
    newest = np.empty((header.tiles, 2), np.int64)
    content.look_up(found.numbers[0], found.starts, revisions, stamps, cells["revision"], cells["stamp"], newest)
    edges = found.starts.tolist()
    return tuple(
        TileCells.with_newest(TileKey(x, y), found.places[first:end], cells[first:end], (revision, stamp_ns))
        for (x, y), first, end, (revision, stamp_ns) in zip(
            found.keys.tolist(), edges, edges[1:], newest.tolist(), strict=False
        )
    )


def _table(header: _Rounded, table: Array) -> tuple[Array, Array]:
    """Stamps and revisions of cells, by their numbers."""
    if not 0 <= header.digits <= MOST_DIGITS:
        raise CodecError(f"stamps in 10^{header.digits} ns")
    backs, lows, highs = table.tolist()
    ages = accumulate(_unfolded(high << 32 | low) for low, high in zip(lows, highs, strict=True))
    stamps = [header.stamp_ns - age * 10**header.digits for age in ages]
    if min(stamps) < 0 or max(stamps) >= 2**63 or max(lows) > LOW:
        raise CodecError("cells from before 1970, or from times beyond 63 bits")
    revisions = [header.revision - back for back in accumulate(backs)]
    if header.revision > MAX_REVISION:
        raise CodecError(f"impossible revisions up to {header.revision}")
    if revisions[-1] < 1:
        raise CodecError("cells of revisions newer than the delta, or none")
    return np.array(stamps, np.int64), np.array(revisions, np.uint32)
