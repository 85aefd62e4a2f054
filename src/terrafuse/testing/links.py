"""What every link must do, and the wrapper that makes any link misbehave."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from terrafuse.errors import InputError
from terrafuse.exchange.links import Cut, Faults, Link, MisbehavingLink

__all__ = ["Cut", "Faults", "LinkTests", "MisbehavingLink"]

LATER_NS = 60_000_000_000
"""By then, whatever was sent at 0 has arrived."""


class LinkTests:
    """Subclass, and define the fixture `join`: what gives the link of a new node, all on one carrier that is in order.

    A carrier that needs time of its own, or loses what it was sent too early, has its say in the fixture.
    """

    @pytest.fixture
    def join(self) -> Callable[[str], Link]:
        raise NotImplementedError

    def test_all_that_is_sent_arrives_in_order_once_and_whole(self, join: Callable[[str], Link]) -> None:
        sender, receiver = join("a"), join("b")
        receiver.listen("delta")
        payloads = [b"", b"\x00" * sender.max_frame_bytes, *(bytes([k]) * k for k in range(1, 100))]
        for payload in payloads:
            sender.send("delta/a", payload, 0)
        received = receiver.receive(LATER_NS)
        assert [frame.payload for frame in received] == payloads
        assert {frame.topic for frame in received} == {"delta/a"}
        assert receiver.receive(LATER_NS) == []

    def test_a_frame_comes_to_all_who_listen_to_its_topic_or_above_but_not_back(
        self, join: Callable[[str], Link]
    ) -> None:
        nodes = {name: join(name) for name in "abcde"}
        for name, topics in {"a": ["x"], "b": ["x"], "c": ["x/y", "x/y/z", "x"], "d": ["x/y/z/w", "x/yy"]}.items():
            for topic in topics:
                nodes[name].listen(topic)
        nodes["a"].send("x/y/z", b"1", 0)
        got = {name: [frame.payload for frame in node.receive(LATER_NS)] for name, node in nodes.items()}
        assert got == {"a": [], "b": [b"1"], "c": [b"1"], "d": [], "e": []}

    def test_a_part_may_be_any(self, join: Callable[[str], Link]) -> None:
        sender, some, all_ = join("a"), join("b"), join("c")
        some.listen("delta/*/a")
        for topic in ("delta/*/b", "delta", "delta/*/a"):
            all_.listen(topic)
        sent = [f"delta/{robot}/{node}" for robot in ("@x", "y") for node in ("a", "b")] + ["delta/a", "delta/y/a/z"]
        for topic in sent:
            sender.send(topic, b"1", 0)
        assert [frame.topic for frame in some.receive(LATER_NS)] == ["delta/@x/a", "delta/y/a", "delta/y/a/z"]
        assert [frame.topic for frame in all_.receive(LATER_NS)] == sent

    def test_who_listens_later_misses_what_was_before(self, join: Callable[[str], Link]) -> None:
        sender, receiver = join("a"), join("b")
        sender.send("x", b"before", 0)
        sender.receive(LATER_NS)
        receiver.receive(LATER_NS)
        receiver.listen("x")
        sender.send("x", b"after", LATER_NS)
        assert [frame.payload for frame in receiver.receive(2 * LATER_NS)] == [b"after"]

    @pytest.mark.parametrize("topic", ["", "/x", "x/", "x//y", "x+", "x/**", "x/$*", "x#", "x?", "x\n", "x" * 501])
    def test_topics_that_some_carrier_would_misread_are_refused(self, join: Callable[[str], Link], topic: str) -> None:
        link = join("a")
        with pytest.raises(InputError, match="topic"):
            link.send(topic, b"", 0)
        with pytest.raises(InputError, match="topic"):
            link.listen(topic)

    def test_a_frame_too_large_is_refused_and_nothing_of_it_arrives(self, join: Callable[[str], Link]) -> None:
        sender, receiver = join("a"), join("b")
        receiver.listen("x")
        with pytest.raises(InputError, match=f"{sender.max_frame_bytes + 1} bytes"):
            sender.send("x", bytes(sender.max_frame_bytes + 1), 0)
        assert receiver.receive(LATER_NS) == []

    def test_a_closed_link_is_silent(self, join: Callable[[str], Link]) -> None:
        sender, receiver = join("a"), join("b")
        receiver.listen("x")
        sender.send("x", b"1", 0)
        for _ in range(2):
            receiver.close()
        sender.send("x", b"2", LATER_NS)
        assert receiver.receive(2 * LATER_NS) == []
        with pytest.raises(InputError, match="closed"):
            receiver.send("x", b"3", 2 * LATER_NS)

    def test_a_name_is_free_again_when_its_node_has_left(self, join: Callable[[str], Link]) -> None:
        sender, first = join("a"), join("b")
        with pytest.raises(InputError, match="'b'"):
            join("b")
        first.listen("x")
        first.close()
        second = join("b")
        sender.send("x", b"1", 0)
        assert second.receive(LATER_NS) == []
