"""Frames: whole messages in any order, nothing of damaged ones, bounded memory, the same bytes tomorrow."""

from __future__ import annotations

import struct
import zlib
from hashlib import blake2b

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from terrafuse.errors import InputError
from terrafuse.exchange.framing import HEADER_BYTES, PART_COST, Limits, Reassembler, frames_of, gaps, message_id
from terrafuse.exchange.links import Frame
from terrafuse.exchange.links.faults import flipped
from tests.exchange.make_golden_exchange import TOPIC, frame_parts, golden_frame

GOLDEN = bytes.fromhex(
    # CRC-32 of the topic and of what follows
    "418a75e7"
    # version
    "01"
    # id of the message
    "9ab32777e5a2eb"
    # number of the part
    "0100"
    # parts
    "0300"
    # the part
    "02a5726f757465c40201"
)
"""Made by tests/exchange/make_golden_exchange.py. Bytes that were once written must be read for ever."""


def taken(frames: list[Frame], limits: Limits | None = None) -> tuple[list[bytes], Reassembler]:
    """(the messages that come of these frames, what put them together)."""
    reassembler = Reassembler(limits)
    got = [reassembler.take("a", frame, 0) for frame in frames]
    return [message for one in got if one is not None and (message := one[1]) is not None], reassembler


def test_golden_bytes() -> None:
    assert golden_frame() == GOLDEN
    assert b"".join(part for _, part in frame_parts(GOLDEN)) == GOLDEN


def test_a_frame_is_what_the_description_says() -> None:
    topic, message = "x/y", b"0123456789"
    id_ = blake2b(b"x/y\x00" + message, digest_size=7).digest()
    rest = struct.pack("<B7sHH", 1, id_, 2, 3) + b"89"
    expected = Frame(topic, struct.pack("<I", zlib.crc32(b"x/y" + rest)) + rest)
    assert frames_of(topic, message, HEADER_BYTES + 4)[2] == expected
    assert [len(frame.payload) for frame in frames_of(topic, message, HEADER_BYTES + 4)] == [20, 20, 18]


@given(messages=st.lists(st.binary(max_size=300), max_size=4), room=st.integers(1, 80), data=st.data())
def test_all_arrive_whatever_the_order_and_repetition(messages: list[bytes], room: int, data: st.DataObject) -> None:
    frames = [frame for message in messages for frame in frames_of("x", message, HEADER_BYTES + room)]
    assert all(len(frame.payload) <= HEADER_BYTES + room for frame in frames)
    several = data.draw(st.lists(st.sampled_from(frames), max_size=10)) if frames else []
    got, reassembler = taken(data.draw(st.permutations(frames + several)))
    assert set(got) == set(messages)
    assert reassembler.missing() == {}
    # Only messages of one frame are handed out again.
    assert all(got.count(message) == 1 for message in messages if len(message) > room)


@given(message=st.binary(max_size=100), bit=st.integers(min_value=0), number=st.integers(min_value=0))
def test_a_damaged_frame_is_counted_and_changes_nothing(message: bytes, bit: int, number: int) -> None:
    frames = frames_of("x", message, HEADER_BYTES + 16)
    good = frames[number % len(frames)]
    bad = Frame("x", flipped(good.payload, bit % (8 * len(good.payload))))
    got, reassembler = taken([bad])
    assert got == []
    assert reassembler.missing() == {}
    assert reassembler.counts == {"refused.checksum": 1}
    assert taken([bad, *frames])[0] == [message]


@given(payload=st.binary(max_size=60))
@settings(max_examples=300)
def test_foreign_bytes_are_counted(payload: bytes) -> None:
    got, reassembler = taken([Frame("x", payload)])
    assert got == []
    assert reassembler.counts.total() == 1


def signed(topic: str, rest: bytes) -> Frame:
    """A frame whose checksum is right."""
    return Frame(topic, struct.pack("<I", zlib.crc32(rest, zlib.crc32(topic.encode()))) + rest)


@pytest.mark.parametrize(
    ("reason", "rest"),
    [
        ("version", struct.pack("<B7sHH", 2, bytes(7), 0, 1)),
        ("impossible", struct.pack("<B7sHH", 1, bytes(7), 0, 0)),
        ("impossible", struct.pack("<B7sHH", 1, bytes(7), 5, 5)),
        ("impossible", struct.pack("<B7sHH", 1, bytes(7), 0, 60_000) + bytes(300)),  # 18 MB
        ("mixed", struct.pack("<B7sHH", 1, bytes(7), 0, 1) + b"not of this id"),
    ],
)
def test_what_no_sender_makes_is_refused_though_its_checksum_is_right(reason: str, rest: bytes) -> None:
    got, reassembler = taken([signed("x", rest)])
    assert got == []
    assert reassembler.counts == {f"refused.{reason}": 1}


def test_a_frame_of_another_topic_is_none_of_this_one() -> None:
    (frame,) = frames_of("x", b"1", 100)
    assert taken([Frame("y", frame.payload)])[1].counts == {"refused.checksum": 1}


def test_a_forged_part_spoils_a_message_but_not_its_repetition() -> None:
    frames = frames_of("x", b"0123456789", HEADER_BYTES + 5)
    forged = signed("x", frames[0].payload[4:HEADER_BYTES] + b"abcde")
    got, reassembler = taken([forged, *frames, *frames])
    assert got == [b"0123456789"]
    assert reassembler.counts == {"refused.mixed": 1}


def test_it_tells_what_lacks() -> None:
    frames = frames_of("x", bytes(range(10)), HEADER_BYTES + 1)
    _, reassembler = taken([frames[k] for k in (2, 3, 7)])
    assert reassembler.missing() == {message_id("x", bytes(range(10))): [0, 1, 4, 6, 8, 9]}


@given(held=st.sets(st.integers(0, 20)), parts=st.integers(1, 21))
def test_gaps_are_what_is_not_held(held: set[int], parts: int) -> None:
    held = {number for number in held if number < parts}
    ranges = gaps(held, parts)
    pairs = list(zip(ranges[::2], ranges[1::2], strict=True))
    assert [part for first, last in pairs for part in range(first, last + 1)] == sorted(set(range(parts)) - held)
    assert all(first <= last for first, last in pairs)


def test_late_frames_of_a_finished_message_begin_nothing_until_it_is_forgotten() -> None:
    frames = frames_of("x", b"0123456789", HEADER_BYTES + 5)
    id_ = message_id("x", b"0123456789")
    got, reassembler = taken([*frames, frames[0]])
    assert got == [b"0123456789"]
    assert reassembler.finished("a", id_)
    assert reassembler.missing() == {}
    reassembler.forget("a", id_)
    assert reassembler.take("a", frames[0], 0) == (id_, None)
    assert reassembler.take("a", frames[1], 0) == (id_, b"0123456789")


def test_senders_do_not_share_parts() -> None:
    first, second = frames_of("x", b"0123456789", HEADER_BYTES + 5)
    reassembler = Reassembler()
    for sender, frame in (("a", first), ("b", second)):
        taken = reassembler.take(sender, frame, 0)
        assert taken is not None
        assert taken[1] is None


def test_memory_is_bounded_and_the_longest_idle_goes_first() -> None:
    begun = [frames_of("x", bytes([k]) * 30, HEADER_BYTES + 10) for k in range(6)]
    # Each part costs 10 bytes and PART_COST: three fit, a fourth makes the first go.
    limits = Limits(bytes=3 * (10 + PART_COST))
    got, reassembler = taken([frames[0] for frames in begun[:4]], limits)
    assert list(reassembler.missing()) == [message_id("x", bytes([k]) * 30) for k in (1, 2, 3)]
    assert reassembler.counts == {"messages_forgotten": 1}
    # Two at most: of 1, 2, 3 the first is heard of again, so 2 goes.
    _, reassembler = taken([begun[k][part] for k, part in ((1, 0), (2, 0), (1, 1), (3, 0))], Limits(unfinished=2))
    assert list(reassembler.missing()) == [message_id("x", bytes([k]) * 30) for k in (1, 3)]
    assert got == []


@pytest.mark.parametrize("count", [300, 1000, 4096])
def test_messages_of_many_senders_at_once_are_all_completed(count: int) -> None:
    """Part by part in turn, as over a station's link."""
    messages = {f"r{k}": str(k).encode() * 30 for k in range(count)}
    frames = {sender: frames_of(sender, message, HEADER_BYTES + 10) for sender, message in messages.items()}
    reassembler, got = Reassembler(), {}
    for part in range(max(map(len, frames.values()))):
        for sender in frames:
            if part < len(frames[sender]):
                taken = reassembler.take(sender, frames[sender][part], part)
                if taken is not None and taken[1] is not None:
                    got[sender] = taken[1]
    assert got == messages
    assert reassembler.counts == {}


def test_senders_are_bounded_and_what_goes_with_them_is_counted() -> None:
    first, second = frames_of("x", b"0123456789", HEADER_BYTES + 5)
    reassembler = Reassembler(Limits(senders=2))
    for sender in "abc":
        reassembler.take(sender, first, 0)
    assert reassembler.counts == {"messages_forgotten": 1}
    assert reassembler.take("b", second, 0) == (message_id("x", b"0123456789"), b"0123456789")
    # Of b nothing is unfinished any more: it goes before c, heard of for longer.
    reassembler.take("d", first, 0)
    assert reassembler.take("c", second, 0) == (message_id("x", b"0123456789"), b"0123456789")
    assert reassembler.counts == {"messages_forgotten": 1}


def test_who_floods_displaces_only_its_own() -> None:
    """Ten parts fit in all; two senders hold one each, and a third sends the first parts of a hundred messages."""
    limits = Limits(all_bytes=10 * (10 + PART_COST))
    begun = [frames_of("x", bytes([k]) * 20, HEADER_BYTES + 10) for k in range(102)]
    reassembler = Reassembler(limits)
    for sender, k in (("a", 0), ("b", 1), *(("flood", k) for k in range(2, 102))):
        reassembler.take(sender, begun[k][0], k)
    assert reassembler.counts == {"messages_forgotten": 92}  # 8 are left of 100
    assert [reassembler.take(sender, begun[k][1], 102) for sender, k in (("a", 0), ("b", 1), ("flood", 94))] == [
        (message_id("x", bytes([k]) * 20), bytes([k]) * 20) for k in (0, 1, 94)
    ]


def test_what_stays_unfinished_is_forgotten_with_time() -> None:
    old, new = (frames_of("x", bytes([k]) * 10, HEADER_BYTES + 5) for k in range(2))
    reassembler = Reassembler(Limits(idle_s=60.0))
    reassembler.take("a", old[0], 0)
    reassembler.take("a", new[0], 60_000_000_000)
    assert len(reassembler.missing()) == 2
    reassembler.take("a", new[0], 60_000_000_001)
    assert list(reassembler.missing()) == [message_id("x", bytes([1]) * 10)]


def test_a_message_that_frames_can_not_carry_is_refused() -> None:
    with pytest.raises(InputError, match="frames of 16"):
        frames_of("x", b"1", 16)
    with pytest.raises(InputError, match="65535 parts"):
        frames_of("x", bytes(2**16), HEADER_BYTES + 1)
    assert len(frames_of(TOPIC, bytes(2**16 - 1), HEADER_BYTES + 1)) == 2**16 - 1
