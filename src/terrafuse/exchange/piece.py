"""What travels on a delta's topic: some tiles of one robot, and what who takes them in then holds.

A message is msgpack, an array of

    until       int: of each of its tiles, all that the robot changed up to this revision is in it or was there before:
    sinces      array of int: up to these; one for each tile in the delta's order, or one for all
    claim       nil, or [since, until, [x, y, back, x, y, back, ...]]: who holds all up to `since`, the tiles of this
                message, and each tile (x, y) up to revision `until - back`, holds all up to `until`
    again       bool: to be taken whatever is held; the sender found that contents differ
    delta       bin, as `exchange.codec` has it; its tiles rise
"""

from __future__ import annotations

import re

import msgspec

from terrafuse.errors import CodecError
from terrafuse.exchange.delta import MAX_REVISION
from terrafuse.exchange.known import Claim
from terrafuse.types import TileKey

MOST_NEEDS = 1 << 16
NOT_IN_TOPICS = re.compile(r"[/*$#?+\x00-\x1f\x7f]")


def in_topic(robot: str) -> str:
    return NOT_IN_TOPICS.sub("_", robot)


class Piece(msgspec.Struct, array_like=True, forbid_unknown_fields=True):
    """Fields as in the module's text."""

    until: int
    sinces: list[int]
    claim: tuple[int, int, list[int]] | None
    again: bool
    delta: bytes


encode_piece = msgspec.msgpack.Encoder().encode
_decode = msgspec.msgpack.Decoder(Piece).decode


def decode_piece(message: bytes) -> Piece:
    """Bytes → piece. Raises CodecError for anything else; the delta stays packed."""
    try:
        piece = _decode(message)
    except ValueError as error:
        raise CodecError(f"a piece that can't be read: {error}") from error
    if piece.claim is not None:
        _check_claim(*piece.claim)
    if not 0 <= piece.until <= MAX_REVISION:
        raise CodecError(f"a piece up to revision {piece.until}")
    return piece


def _check_claim(since: int, until: int, needs: list[int]) -> None:
    if not 0 <= since <= until <= MAX_REVISION or len(needs) % 3 or len(needs) > 3 * MOST_NEEDS:
        raise CodecError(f"an impossible claim from {since} to {until}, of {len(needs)} numbers")


def pack_claim(claim: Claim) -> tuple[int, int, list[int]]:
    flat = (number for key, revision in claim.needs for number in (key.x, key.y, claim.until - revision))
    return claim.since, claim.until, list(flat)


def unpack_claim(since: int, until: int, needs: list[int]) -> Claim:
    numbers = iter(needs)
    tiles = zip(numbers, numbers, numbers, strict=True)
    return Claim(since, until, tuple((TileKey(x, y), until - back) for x, y, back in tiles))
