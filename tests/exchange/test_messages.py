"""Summaries and posts as bytes."""

from __future__ import annotations

from contextlib import suppress

import msgspec
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from terrafuse.errors import CodecError
from terrafuse.exchange.contents import Digests, decode_digests, encode_digests
from terrafuse.exchange.known import Claim
from terrafuse.exchange.piece import Piece, decode_piece, encode_piece, unpack_claim
from terrafuse.exchange.posts import MOST_KINDS, Inbox, Post, decode_post, encode_post
from terrafuse.exchange.summary import MOST_GAPS, VERSION, OtherVersion, State, Summary, pack, unpack
from terrafuse.types import TileKey
from tests.exchange.make_golden_exchange import (
    DIGESTS,
    HEAD,
    PIECE,
    POST,
    STATE,
    digests_parts,
    golden_summary,
    piece_parts,
    post_parts,
    summary_parts,
)

GOLDEN_POST = bytes.fromhex(
    # array of 4
    "94"
    # born_ns
    "cf000000012a05f200"
    # number
    "02"
    # kind
    "a5726f757465"
    # payload
    "c4020102"
)
GOLDEN_SUMMARY = bytes.fromhex(
    # array of 10
    "9a"
    # version
    "01"
    # born_ns
    "cf000000012a05f200"
    # said_ns
    "cf0000000165a0bc00"
    # robots: map of 1: of fine, 2
    "81a466696e6502"
    # held: map of 1: of fine, map of 2
    "81a466696e6582"
    # r1, 70000
    "a27231ce00011170"
    # r2, 3
    "a2723203"
    # missing: array of 1: array of 2
    "9192"
    # an id
    "c4076d657373616765"
    # parts 0 to 3, and 9
    "9400030909"
    # finished: array of 1
    "91"
    # an id
    "c407616e6f74686572"
    # ahead: map of 1: of fine, map of 1
    "81a466696e6581"
    # r2, array of 3: tile (-1, 2), 2 beyond
    "a2723293ff0202"
    # roots: map of 1: of fine, map of 1
    "81a466696e6581"
    # r1, 258
    "a27231cd0102"
    # area: array of 4: west, south, east, north
    "94cb0000000000000000cb3ff8000000000000cb4044000000000000cb4054000000000000"
)
GOLDEN_PIECE = bytes.fromhex(
    # array of 5
    "95"
    # until
    "07"
    # sinces: array of 2
    "920305"
    # claim: array of 3: since, until
    "930307"
    # array of 3: tile (-1, 2), 1 back
    "93ff0201"
    # again
    "c2"
    # the delta
    "c403544644"
)
GOLDEN_DIGESTS = bytes.fromhex(
    # array of 3
    "93"
    # robot
    "a27231"
    # base
    "07"
    # array of 1: array of 3: tile (-1, 2), 258
    "9193ff02cd0102"
)
"""All made by tests/exchange/make_golden_exchange.py. Bytes that were once written must be read for ever."""

IDS = st.binary(min_size=7, max_size=7)


def test_golden_bytes() -> None:
    assert encode_post(POST) == GOLDEN_POST
    assert decode_post(GOLDEN_POST) == POST
    assert golden_summary() == GOLDEN_SUMMARY
    assert b"".join(part for _, part in post_parts(GOLDEN_POST)) == GOLDEN_POST
    assert b"".join(part for _, part in summary_parts(GOLDEN_SUMMARY)) == GOLDEN_SUMMARY
    whole = unpack(GOLDEN_SUMMARY)
    assert (whole.held, dict(whole.missing), whole.finished) == (STATE.held, STATE.missing, STATE.finished)
    assert (whole.ahead, whole.roots, whole.area) == ({"fine": {"r2": [-1, 2, 2]}}, STATE.roots, HEAD.area)
    assert encode_piece(PIECE) == GOLDEN_PIECE
    assert decode_piece(GOLDEN_PIECE) == PIECE
    assert PIECE.claim is not None
    assert unpack_claim(*PIECE.claim) == Claim(3, 7, ((TileKey(-1, 2), 6),))
    assert encode_digests(DIGESTS) == GOLDEN_DIGESTS
    assert decode_digests(GOLDEN_DIGESTS) == DIGESTS
    assert b"".join(part for _, part in piece_parts(GOLDEN_PIECE)) == GOLDEN_PIECE
    assert b"".join(part for _, part in digests_parts(GOLDEN_DIGESTS)) == GOLDEN_DIGESTS
    assert (whole.version, whole.born_ns, whole.said_ns, whole.robots) == (1, 5 * 10**9, 6 * 10**9, {"fine": 2})


@given(
    held=st.dictionaries(
        st.sampled_from(["fine", "coarse"]),
        st.dictionaries(st.text(min_size=1, max_size=30), st.integers(0, 2**32 - 1), min_size=1, max_size=60),
    ),
    missing=st.dictionaries(IDS, st.lists(st.integers(0, 2**16 - 1), max_size=10), max_size=10),
    finished=st.lists(IDS, unique=True, max_size=20),
    room=st.integers(300, 500),
)
def test_messages_of_a_summary_fit_and_hold_all_of_it(
    held: dict[str, dict[str, int]], missing: dict[bytes, list[int]], finished: list[bytes], room: int
) -> None:
    head = Summary(VERSION, 2**60, 2**60, {"fine": 2**16, "coarse": 2**16})
    messages = pack(head, State(held, missing, finished), room)
    assert all(len(message) <= room for message in messages)
    parts = [unpack(message) for message in messages]
    said: dict[str, dict[str, int]] = {}
    for part in parts:
        for channel, some in part.held.items():
            said.setdefault(channel, {}).update(some)
    assert said == held
    assert {id_: gaps for part in parts for id_, gaps in part.missing} == missing
    assert [id_ for part in parts for id_ in part.finished] == finished
    assert all((part.born_ns, part.said_ns, part.robots) == (2**60, 2**60, head.robots) for part in parts)


def test_a_summary_asks_for_so_many_gaps_at_most() -> None:
    (message,) = pack(HEAD, State(missing={b"message": list(range(1000))}), 1000)
    assert unpack(message).missing == [(b"message", list(range(MOST_GAPS)))]


@given(version=st.integers(0, 2**16 - 1), rest=st.lists(st.integers(-(2**63), 2**64 - 1) | st.text(), max_size=8))
def test_of_another_version_only_that_is_read(version: int, rest: list[object]) -> None:
    if version == VERSION:
        version = 2
    with pytest.raises(OtherVersion, match=f"version {version}; this terrafuse speaks version {VERSION}"):
        unpack(msgspec.msgpack.encode([version, *rest]))


@given(st.binary(max_size=60))
@example(b"\x93\xa1\x80")  # no UTF-8
def test_other_bytes_are_refused(message: bytes) -> None:
    readers = (unpack, Summary), (decode_post, Post), (decode_piece, Piece), (decode_digests, Digests)
    for read, kind in readers:
        with suppress(CodecError):
            assert isinstance(read(message), kind)


@given(cut=st.integers(0, 50))
def test_cut_messages_are_refused(cut: int) -> None:
    with pytest.raises(CodecError):
        unpack(GOLDEN_SUMMARY[:cut])
    with pytest.raises(CodecError):
        decode_post(GOLDEN_POST[: min(cut, len(GOLDEN_POST) - 1)])


def test_only_what_is_newer_is_new() -> None:
    inbox = Inbox()

    def is_new(sender: str, born_ns: int, number: int, kind: str = "x") -> bool:
        return inbox.is_new(sender, Post(born_ns, number, kind, b""))

    assert is_new("a", 5, 2)
    assert not is_new("a", 5, 2)
    assert not is_new("a", 5, 1)
    assert is_new("a", 5, 1, "y")
    assert is_new("b", 5, 1)
    assert is_new("a", 6, 1)  # a later life counts from 1 again
    assert not is_new("a", 5, 3)


def test_what_is_remembered_of_posts_is_bounded() -> None:
    inbox = Inbox()
    for k in range(MOST_KINDS + 1):
        inbox.is_new("a", Post(1, 1, str(k), b""))
    assert inbox.is_new("a", Post(1, 1, "0", b""))
    assert not inbox.is_new("a", Post(1, 1, str(MOST_KINDS), b""))
