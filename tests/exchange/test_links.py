"""Links: what each keeps, and that misbehaving ones misbehave as told."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from hashlib import blake2b
from itertools import pairwise
from math import inf

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from terrafuse.errors import InputError
from terrafuse.exchange.links import Cut, Faults, Link, MemoryHub, MisbehavingLink
from terrafuse.exchange.links.faults import Queue, disturbed, flipped
from terrafuse.testing.links import LinkTests

SECOND_NS = 1_000_000_000
MS = 1_000_000


class TestMemoryLink(LinkTests):
    @pytest.fixture
    def join(self) -> Callable[[str], Link]:
        return MemoryHub(max_frame_bytes=2300).link


class TestMisbehavingLinkWithoutFaults(LinkTests):
    @pytest.fixture
    def join(self) -> Callable[[str], Link]:
        hub = MemoryHub(max_frame_bytes=2300)
        return lambda node: MisbehavingLink(hub.link(node))


class TestMisbehavingLinkTwice(LinkTests):
    """Wrappers nest."""

    @pytest.fixture
    def join(self) -> Callable[[str], Link]:
        hub = MemoryHub(max_frame_bytes=2300)
        return lambda node: MisbehavingLink(MisbehavingLink(hub.link(node)))


def pair(faults: Faults, seed: int = 0) -> tuple[MisbehavingLink, Link]:
    """A sender that misbehaves, and one who listens to all it sends on 'x'."""
    hub = MemoryHub()
    sender, receiver = MisbehavingLink(hub.link("a"), faults, seed), hub.link("b")
    receiver.listen("x")
    return sender, receiver


def arrivals(
    faults: Faults, sends: list[tuple[int, bytes]], seed: int = 0, step_ns: int = MS
) -> list[tuple[int, bytes]]:
    """(time in ns, payload) of what arrives of these sends, looked at every `step_ns` until a second after the last."""
    sender, receiver = pair(faults, seed)
    waiting, out = list(sends), []
    for now_ns in range(0, sends[-1][0] + 2 * SECOND_NS, step_ns):
        while waiting and waiting[0][0] <= now_ns:
            sender.send("x", waiting.pop(0)[1], now_ns)
        sender.receive(now_ns)
        out += [(now_ns, frame.payload) for frame in receiver.receive(now_ns)]
    return out


def numbered(count: int, every_ns: int = 10 * MS) -> list[tuple[int, bytes]]:
    """So unlike each other that none, damaged, is another."""
    return [(k * every_ns, blake2b(k.to_bytes(4, "big"), digest_size=16).digest()) for k in range(count)]


@given(st.lists(st.tuples(st.integers(0, 50 * MS), st.binary(max_size=300)), min_size=1, max_size=30))
def test_without_faults_all_arrives_in_order_at_once(gaps: list[tuple[int, bytes]]) -> None:
    times = np.cumsum([gap // MS * MS for gap, _ in gaps]).tolist()
    sends = [(now_ns, payload) for now_ns, (_, payload) in zip(times, gaps, strict=True)]
    assert arrivals(Faults(), sends) == sends


def test_delay_and_rate_by_hand() -> None:
    """100 + 20 bytes at 1000 bytes/s take 120 ms; then 50 ms of delay. The second frame waits for the first."""
    faults = Faults(delay_s=0.05, bytes_per_s=1000, overhead_bytes=20)
    got = arrivals(faults, [(0, bytes(100)), (10 * MS, bytes(80)), (SECOND_NS, b"")])
    # 0.120 + 0.050; 0.120 + 0.100 + 0.050; 1 + 0.020 + 0.050
    assert [now_ns for now_ns, _ in got] == [170 * MS, 270 * MS, 1070 * MS]


def test_a_queue_takes_what_fits_and_loses_the_rest() -> None:
    """At 100 bytes/s, 250 bytes may wait: of four frames of 100 bytes at once, two are taken; after 1 s, one more."""
    queue, faults = Queue(), Faults(bytes_per_s=100, queue_bytes=250)
    assert [queue.leaves_ns(bytes(100), faults, 0) for _ in range(4)] == [SECOND_NS, 2 * SECOND_NS, None, None]
    assert queue.leaves_ns(bytes(100), faults, SECOND_NS) == 3 * SECOND_NS


def test_a_cut_by_hand() -> None:
    """Cut from 20 to 50 ms, sent every 10 ms: the frames of 20, 30, 40 ms are lost, in both directions."""
    assert [now_ns // MS for now_ns, _ in arrivals(Faults(cuts=(Cut(0.02, 0.05),)), numbered(8))] == [0, 10, 50, 60, 70]
    hub = MemoryHub()
    sender, receiver = hub.link("a"), MisbehavingLink(hub.link("b"), Faults(cuts=(Cut(0.02, 0.05), Cut(0.07))))
    receiver.listen("x")
    got = []
    for now_ns, payload in numbered(9):
        sender.send("x", payload, now_ns)
        got += [now_ns // MS for _ in receiver.receive(now_ns)]
    assert got == [0, 10, 50, 60]
    assert receiver.counts["cut"] == 5


def test_what_leaves_the_queue_in_a_cut_is_lost() -> None:
    """Two frames of 1 s each: the first leaves at 1 s, before the cut, the second at 2 s, within it."""
    faults = Faults(bytes_per_s=100, cuts=(Cut(1.5, 2.5),))
    assert len(arrivals(faults, [(0, bytes(100)), (0, bytes(100))])) == 1


def test_one_copy_is_held_and_overtaken() -> None:
    """By hand: fates of loss, doubling, damage, bit, then jitter and holding back of each copy."""
    faults = Faults(duplication=0.5, corruption=0.5, reordering=0.5, held_s=0.3, delay_s=0.1, jitter_s=0.2)
    counts: Counter[str] = Counter()
    fate = np.array([0.0, 0.4, 0.4, 0.5, 0.25, 0.6, 0.5, 0.4])
    # Doubled and damaged: bit 0.5·16 = 8 is the lowest of byte 1. Copy 1: 0.1 + 0.2·0.25 = 0.15 s; copy 2:
    # 0.1 + 0.2·0.5 + 0.3 = 0.5 s.
    assert disturbed(b"\x10\x20", faults, fate, counts) == [(150 * MS, b"\x10\x21"), (500 * MS, b"\x10\x21")]
    assert counts == {"corrupted": 1, "duplicated": 1, "reordered": 1}


@given(st.binary(min_size=1, max_size=50), st.data())
def test_a_flipped_bit_is_one_bit(payload: bytes, data: st.DataObject) -> None:
    bit = data.draw(st.integers(0, 8 * len(payload) - 1))
    damaged = flipped(payload, bit)
    assert sum((one ^ two).bit_count() for one, two in zip(payload, damaged, strict=True)) == 1
    assert flipped(damaged, bit) == payload


def within(count: int, of: int, chance: float) -> bool:
    """Whether a count agrees with its chance: within five standard deviations of a binomial's mean."""
    return abs(count - of * chance) <= 5 * (of * chance * (1 - chance)) ** 0.5


@pytest.mark.parametrize("seed", range(3))
def test_faults_are_as_frequent_as_told(seed: int) -> None:
    """Of 4000 frames 30 % are lost; of the others 10 % doubled, 5 % damaged; of copies 20 % held back."""
    faults = Faults(loss=0.3, duplication=0.1, corruption=0.05, reordering=0.2, held_s=0.025)
    sent = numbered(4000)
    got = arrivals(faults, sent, seed, step_ns=5 * MS)
    copies = Counter(payload for _, payload in got)
    assert within(len(copies), 4000, 0.7)
    assert within(sum(count == 2 for count in copies.values()), len(copies), 0.1)
    assert within(len(copies.keys() - {payload for _, payload in sent}), len(copies), 0.05)
    left_at = dict(map(reversed, sent))
    delays = [now_ns - left_at[payload] for now_ns, payload in got if payload in left_at]
    assert set(delays) == {0, 25 * MS}
    assert within(delays.count(25 * MS), len(delays), 0.2)


def test_what_is_held_back_is_overtaken() -> None:
    got = arrivals(Faults(reordering=0.2, held_s=0.025), numbered(100))
    place = {payload: k for k, (_, payload) in enumerate(numbered(100))}
    order = [place[payload] for _, payload in got]
    assert sorted(order) == list(range(100))
    assert any(one > two for one, two in pairwise(order))


@given(
    st.builds(
        Faults,
        loss=st.floats(0, 1),
        duplication=st.floats(0, 1),
        corruption=st.floats(0, 1),
        reordering=st.floats(0, 1),
        delay_s=st.floats(0, 0.1),
        jitter_s=st.floats(0, 0.1),
        bytes_per_s=st.floats(100, 1e5),
        queue_bytes=st.floats(10, 1000),
    ),
    st.integers(0, 2**32),
)
def test_same_seed_same_behaviour_and_one_fault_more_leaves_the_others(faults: Faults, seed: int) -> None:
    got = arrivals(faults, numbered(20), seed, step_ns=20 * MS)
    assert arrivals(faults, numbered(20), seed, step_ns=20 * MS) == got
    alone = Faults(loss=faults.loss)
    survivors = {payload for _, payload in arrivals(alone, numbered(20), seed, step_ns=20 * MS)}
    unharmed = {payload for _, payload in got} & {payload for _, payload in numbered(20)}
    assert unharmed <= survivors


@given(
    st.lists(st.tuples(st.integers(0, 400 * MS), st.integers(0, 1500)), min_size=1, max_size=40),
    st.floats(500, 20_000),
)
def test_the_rate_is_kept_over_any_two_seconds(gaps: list[tuple[int, int]], rate: float) -> None:
    """What leaves within two seconds took no more than two seconds to send, but for what the first had sent before."""
    queue, faults = Queue(), Faults(bytes_per_s=rate)
    times = np.cumsum([gap for gap, _ in gaps]).tolist()
    left = [
        (queue.leaves_ns(bytes(size), faults, now_ns), size)
        for now_ns, (_, size) in zip(times, gaps, strict=True)
    ]  # fmt: skip
    for start, _ in left:
        window = [
            size for at, size in left if start is not None and at is not None and start <= at < start + 2 * SECOND_NS
        ]
        assert sum(window) - window[0] <= 2 * rate


def test_the_rate_is_used() -> None:
    """10 frames of 100 bytes at once, at 1000 bytes/s: the last leaves after exactly a second."""
    got = arrivals(Faults(bytes_per_s=1000), [(0, bytes(100))] * 10)
    assert [now_ns for now_ns, _ in got] == [100 * MS * k for k in range(1, 11)]


def test_a_clock_that_runs_backwards_is_refused() -> None:
    sender, _ = pair(Faults())
    sender.send("x", b"", 5)
    with pytest.raises(InputError, match="4 after 5"):
        sender.receive(4)


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"loss": 1.1}, "loss = 1.1"),
        ({"corruption": -0.1}, "corruption"),
        ({"delay_s": -1.0}, "delay_s"),
        ({"jitter_s": inf}, "jitter_s"),
        ({"bytes_per_s": 0.0}, "bytes_per_s"),
        ({"loss": float("nan")}, "loss"),
    ],
)
def test_impossible_faults_are_refused(settings: dict[str, float], says: str) -> None:
    with pytest.raises(InputError, match=says):
        Faults(**settings)  # type: ignore[arg-type]


def test_a_cut_that_ends_before_it_begins_is_refused() -> None:
    with pytest.raises(InputError, match="must end"):
        Cut(3.0, 2.0)
