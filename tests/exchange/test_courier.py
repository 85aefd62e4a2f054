"""What a courier does, case by case; `test_convergence.py` has schedules at random."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from terrafuse.errors import InputError
from terrafuse.exchange import courier as courier_
from terrafuse.exchange.codec import encode
from terrafuse.exchange.courier import Channel, Courier, CourierSettings
from terrafuse.exchange.delta import Delta
from terrafuse.exchange.framing import frames_of
from terrafuse.exchange.links import Cut, Faults, Frame, Link, MemoryHub, MisbehavingLink
from terrafuse.exchange.own import LIFE
from terrafuse.exchange.piece import Piece, encode_piece
from terrafuse.exchange.posts import Post, encode_post
from terrafuse.exchange.summary import VERSION, State, Summary, pack
from terrafuse.mapper import Mapper
from terrafuse.replica import Replica
from terrafuse.testing.deltas import deltas_of, random_scans
from terrafuse.types import Scan
from tests.exchange.fleet import (
    CHANNEL,
    FACTOR,
    LATTICE,
    MODEL,
    QUICK,
    STATION,
    STEP_NS,
    agreed,
    mesh,
    run,
    star,
    undisturbed,
)

SECOND_NS = 1_000_000_000


class Deaf:
    """A link that takes no frames of a topic."""

    def __init__(self, link: Link, topic: str) -> None:
        self.deaf_to = topic
        self._link = link

    def __getattr__(self, name: str) -> Any:
        return getattr(self._link, name)

    def receive(self, now_ns: int) -> list[Frame]:
        return [frame for frame in self._link.receive(now_ns) if frame.topic != self.deaf_to]


def scans(robots: int, count: int = 12) -> list[list[Scan]]:
    return [random_scans(seed, count, 8.0, 20) for seed in range(robots)]


def test_all_come_to_the_same_map_within_two_reports() -> None:
    nodes = star(scans(3), MemoryHub(600).link)
    run(nodes, 0, 8)
    assert agreed(nodes)
    assert [nodes[name].courier.behind(STATION) for name in ("r1", "r2", "r3")] == [{}] * 3
    assert nodes[STATION].courier.reached(8 * SECOND_NS) == ["r1", "r2", "r3"]
    for node in nodes.values():
        assert node.replica.robots == ["r1", "r2", "r3"]
        assert not [name for name in node.courier.counts if name.startswith("refused")]


def test_robots_among_themselves_need_no_station() -> None:
    nodes = mesh(scans(3), MemoryHub(600).link)
    run(nodes, 0, 8)
    assert agreed(nodes)


def test_who_hears_nobody_says_only_what_it_holds() -> None:
    nodes = star(scans(1)[:1], MemoryHub(600).link)
    run({"r1": nodes["r1"]}, 0, 10)
    counts = nodes["r1"].courier.counts
    assert counts["frames_sent.delta"] == 0
    assert counts["frames_sent.summary"] == 20  # one each half second
    assert nodes["r1"].replica.digest() == undisturbed(nodes).digest()


def test_nothing_more_is_sent_once_all_is_level_and_nothing_is_new() -> None:
    nodes = star(scans(2), MemoryHub(600).link)
    run(nodes, 0, 10)
    before = {name: node.courier.counts["frames_sent.delta"] for name, node in nodes.items()}
    run(nodes, 10, 60)
    assert {name: node.courier.counts["frames_sent.delta"] for name, node in nodes.items()} == before


def test_who_said_only_part_of_what_it_holds_is_not_sent_all() -> None:
    """A summary in two messages; the one with this robot's own revision comes later."""
    hub = MemoryHub(600)
    nodes = star(scans(1, 4), hub.link)
    run({"r1": nodes["r1"]}, 0, 2)
    nodes[STATION].link.close()
    station, head = hub.link(STATION), Summary(VERSION, born_ns=1, said_ns=1, robots={CHANNEL: 2})
    for second, held, expected in ((2, {"r2": 9}, 0), (4, {"r1": 3}, 1)):
        (message,) = pack(head, State({CHANNEL: held}), 500)
        send(station, f"summary/{STATION}", message)
        run({"r1": nodes["r1"]}, second, second + 2)
        assert nodes["r1"].courier.counts["messages_sent.delta"] == expected


def test_a_message_for_several_peers_is_sent_once() -> None:
    """The station passes on to three robots what it alone hears of the fourth."""
    hub = MemoryHub(600)
    nodes = star([[], [], [], random_scans(4, 12, 8.0, 20)], lambda name: Deaf(hub.link(name), "delta/coarse/r4/r4"))
    nodes[STATION].link.deaf_to = ""  # type: ignore[attr-defined]
    run(nodes, 0, 10)
    assert agreed(nodes)
    sent, applied = (nodes[STATION].courier.counts[name] for name in ("messages_sent.delta", "deltas_applied"))
    assert 0 < sent <= applied
    assert nodes["r1"].courier.counts["deltas_applied"] == sent


def test_what_peers_overheard_is_not_passed_on() -> None:
    nodes = star([[], [], [], random_scans(4, 12, 8.0, 20)], MemoryHub(600).link)
    run(nodes, 0, 10)
    assert agreed(nodes)
    assert nodes[STATION].courier.counts["messages_sent.delta"] == 0


def test_an_outage_costs_what_changed_not_how_often() -> None:
    """The same ground over and over: after a cut of 60 s, the robot sends it once."""
    same = random_scans(1, 1, 4.0, 10)[0]
    again = [replace(same, stamp_ns=k * SECOND_NS) for k in range(120)]
    hub = MemoryHub(600)
    cut = Faults(cuts=(Cut(2.0, 62.0),))
    nodes = star([again], lambda name: MisbehavingLink(hub.link(name), cut))
    run(nodes, 0, 2)
    sent = nodes["r1"].courier.counts["bytes_sent.delta"]
    run(nodes, 2, 62)
    during = nodes["r1"].courier.counts["bytes_sent.delta"]
    assert not agreed(nodes)
    run(nodes, 62, 64)
    assert agreed(nodes)
    after = nodes["r1"].courier.counts["bytes_sent.delta"] - during
    assert 0 < after <= sent
    # Into the silence it sent only until it noticed: 5 s of it, each retry later than the one before.
    assert during - sent <= 2 * sent


@pytest.mark.parametrize("who", [STATION, "r1"])
def test_a_node_that_starts_with_nothing_catches_up(who: str) -> None:
    hub = MemoryHub(600)
    nodes = star(scans(2, 8), hub.link)
    run(nodes, 0, 5)
    nodes[who].link.close()
    nodes[who].start(hub.link(who), keep_map=who != STATION)
    assert not agreed(nodes)
    run(nodes, 5, 10)
    assert agreed(nodes)


def test_a_station_that_kept_its_store_asks_for_nothing_it_has() -> None:
    hub = MemoryHub(600)
    nodes = star(scans(2, 8), hub.link)
    run(nodes, 0, 6)
    nodes[STATION].link.close()
    nodes[STATION].start(hub.link(STATION), keep_store=True)
    before = nodes["r1"].courier.counts["frames_sent.delta"]
    run(nodes, 6, 12)
    assert agreed(nodes)
    assert nodes["r1"].courier.counts["frames_sent.delta"] == before


def test_a_robot_that_lost_all_memory_goes_on_under_its_name() -> None:
    """Scans of the new life begin at 1; others hold revision 8 of the old one. Nothing of either is lost."""
    hub = MemoryHub(600)
    nodes = star([random_scans(k, 20, 8.0, 20) for k in range(2)], hub.link)
    run(nodes, 0, 4)
    nodes["r1"].link.close()
    first_life = nodes["r1"].own.delta()
    nodes["r1"].start(hub.link("r1"))
    run(nodes, 4, 12)
    digests = {node.replica.digest() for node in nodes.values()}
    assert len(digests) == 1
    expected = Replica(LATTICE.coarser(FACTOR), MODEL)
    second_life = nodes["r1"].own.delta()
    for tile in second_life.tiles:
        tile.cells["revision"] += LIFE
    later = replace(second_life, revision=second_life.revision + LIFE)
    for delta in (first_life, later, nodes["r2"].own.delta()):
        expected.apply(delta)
    assert digests == {expected.digest()}
    assert nodes["r2"].replica.store.revision("r1") == LIFE + 12


def test_a_robot_whose_last_scans_were_not_saved_reports_its_map_anew() -> None:
    """It restarts with the map of three scans, and others hold eight; what it scans then counts."""
    hub = MemoryHub(600)
    some = random_scans(1, 20, 8.0, 20)
    nodes = star([some], hub.link)
    run(nodes, 0, 4)
    nodes["r1"].link.close()
    older = Mapper("r1", LATTICE, MODEL)
    for scan in some[:3]:
        older.integrate(scan)
    nodes["r1"].mapper = older
    nodes["r1"].start(hub.link("r1"), keep_map=True)
    run(nodes, 4, 12)
    assert nodes["r1"].replica.digest() == nodes[STATION].replica.digest()
    for tile in nodes["r1"].own.delta().tiles:
        held = nodes[STATION].replica.store.load("r1", tile.key)
        assert held is not None
        there = held.cells[np.isin(held.at, tile.at)]
        for name in there.dtype.names or ():
            if name != "revision":
                np.testing.assert_array_equal(there[name], tile.cells[name])


def test_a_long_delta_comes_in_parts_and_each_counts() -> None:
    """A cut in the middle: what came before it need not come again."""
    hub = MemoryHub(200)
    slow = CourierSettings(period_s=0.5, answer_s=0.1, message_cells=20, bytes_per_s=2000)
    nodes = star(scans(1), hub.link, slow)
    run({"r1": nodes["r1"]}, 0, 7)
    held = []

    def note() -> bool:
        store = nodes[STATION].replica.store
        held.append(sum(len(tile.at) for key in store.keys() if (tile := store.load("r1", key))))
        return agreed(nodes)

    for step in range(530):
        run(nodes, 7 + step / 10, 7.1 + step / 10, until=note)
        note()
    assert agreed(nodes)
    assert len(set(held)) > 3
    assert held == sorted(held)


def test_parts_that_lack_are_asked_for() -> None:
    """30 % of the frames are lost, of a message of over 40."""
    hub = MemoryHub(80)
    whole = replace(QUICK, message_cells=10_000)
    nodes = star([random_scans(1, 1, 14.0, 150)], hub.link, whole)
    run({"r1": nodes["r1"]}, 0, 1)
    for node in nodes.values():
        node.link.close()
        node.start(MisbehavingLink(hub.link(node.name), Faults(loss=0.3), seed=1), keep_map=True)
    run(nodes, 1, 120, until=lambda: agreed(nodes))
    assert agreed(nodes)
    counts = nodes["r1"].courier.counts
    frames = len(frames_of("delta/coarse/r1/r1", encode(nodes["r1"].own.delta()), 80))
    assert frames > 40
    # 1/(1 - 0.3) of it in the mean; all of it again and again would be four times as much.
    assert counts["frames_sent.delta"] < 2 * frames


def test_it_keeps_to_its_rate() -> None:
    hub = MemoryHub(300)
    limited = replace(QUICK, bytes_per_s=3000.0)
    nodes = star(scans(2), hub.link, limited)
    sent: list[int] = []
    for second in range(20):
        run(nodes, second, second + 1)
        counts = nodes["r1"].courier.counts
        sent.append(sum(number for name, number in counts.items() if name.startswith("bytes_sent")))
    # A tenth of a second's worth may be saved up, and the last frame may be paid for afterwards.
    assert max(np.diff([0, *sent])) <= 3000 + 300 + 300
    assert agreed(nodes)


# --- posts -----------------------------------------------------------------------------------------------------------


def test_a_post_arrives_at_once_and_once() -> None:
    nodes = star(scans(2), MemoryHub(600).link)
    run(nodes, 0, 2)
    nodes[STATION].courier.post("r1", "route", b"there")
    run(nodes, 2, 2.3)
    assert nodes["r1"].posts == {(STATION, "route"): [b"there"]}
    run(nodes, 2.3, 10)
    assert nodes["r1"].posts == {(STATION, "route"): [b"there"]}
    assert nodes["r2"].posts == {}
    assert nodes[STATION].courier.counts["messages_sent.post"] == 1


def test_only_the_newest_of_a_kind_is_brought() -> None:
    hub = MemoryHub(600)
    cut = Faults(cuts=(Cut(1.0, 20.0),))
    nodes = star(scans(1), lambda name: MisbehavingLink(hub.link(name), cut))
    run(nodes, 0, 2)
    for k in range(50):
        nodes["r1"].courier.post(STATION, "state", str(k).encode())
        nodes["r1"].courier.post(STATION, "other", b"x")
        run(nodes, 2 + 0.2 * k, 2.2 + 0.2 * k)
    run(nodes, 12, 24)
    assert nodes[STATION].posts == {("r1", "state"): [b"49"], ("r1", "other"): [b"x"]}


def test_a_large_post_comes_in_parts() -> None:
    hub = MemoryHub(100)
    nodes = star(scans(1), lambda name: MisbehavingLink(hub.link(name), Faults(loss=0.2), seed=len(name)))
    route = bytes(range(256)) * 20
    nodes[STATION].courier.post("r1", "route", route)
    run(nodes, 0, 60)
    assert nodes["r1"].posts == {(STATION, "route"): [route]}


def test_a_peer_that_was_started_afresh_gets_its_orders_again() -> None:
    hub = MemoryHub(600)
    nodes = star(scans(1), hub.link)
    nodes[STATION].courier.post("r1", "route", b"there")
    run(nodes, 0, 3)
    nodes["r1"].link.close()
    nodes["r1"].start(hub.link("r1"), keep_map=True)
    assert nodes["r1"].posts == {}
    run(nodes, 3, 6)
    assert nodes["r1"].posts == {(STATION, "route"): [b"there"]}


def test_posts_of_a_sender_that_was_started_afresh_are_newer() -> None:
    hub = MemoryHub(600)
    nodes = star(scans(1), hub.link)
    for k in range(3):
        nodes[STATION].courier.post("r1", "route", str(k).encode())
        run(nodes, k, k + 1)
    nodes[STATION].link.close()
    nodes[STATION].start(hub.link(STATION))
    nodes[STATION].courier.post("r1", "route", b"new")
    run(nodes, 3, 5)
    assert nodes["r1"].posts == {(STATION, "route"): [b"0", b"1", b"2", b"new"]}


def test_what_can_not_be_posted() -> None:
    nodes = star(scans(1), MemoryHub(600).link)
    with pytest.raises(InputError, match="65537 bytes"):
        nodes[STATION].courier.post("r1", "route", bytes(2**16 + 1))
    with pytest.raises(InputError, match="'r2' is no peer of 'r1'"):
        nodes["r1"].courier.post("r2", "route", b"")


# --- what is refused -------------------------------------------------------------------------------------------------


def listening(**options: object) -> tuple[Courier, Link, Replica]:
    """A station with r1 and what it holds, and the link of somebody else."""
    hub = MemoryHub(200)
    replica = Replica(LATTICE, MODEL)
    return Courier(hub.link(STATION), [Channel(CHANNEL, replica.store)], **options), hub.link("r1"), replica  # type: ignore[arg-type]


def whole(delta: Delta) -> bytes:
    """As a message that leads from its first revision to its last."""
    claim = (delta.since, delta.revision, [])
    return encode_piece(Piece(delta.revision, [delta.since], claim, False, encode(delta)))


def send(link: Link, topic: str, message: bytes) -> None:
    for frame in frames_of(topic, message, link.max_frame_bytes):
        link.send(*frame, 0)


def test_what_leaves_a_gap_is_refused_until_the_gap_is_closed() -> None:
    station, link, replica = listening()
    first, second = deltas_of("r1", random_scans(1, 4), LATTICE, MODEL, every=2)
    send(link, "delta/coarse/r1/r1", whole(second))
    station.tick(0)
    assert (station.counts["refused.gap"], replica.store.robots()) == (1, [])
    for delta in (first, second, second):
        send(link, "delta/coarse/r1/r1", whole(delta))
    station.tick(STEP_NS)
    assert (station.counts["deltas_applied"], station.counts["deltas_known"]) == (2, 1)
    assert replica.store.revision("r1") == 4


def test_what_does_not_belong_here_is_refused() -> None:
    heard: list[object] = []
    station, link, replica = listening(on_message=lambda *message: heard.append(message))
    (alien,) = deltas_of("r1", random_scans(1, 1), LATTICE.coarser(2), MODEL)
    bad = {
        "delta/coarse/r1/r1": [whole(alien), b"", b"TFD", whole(alien)[:-1]],
        "summary/r1": [b"", b"\x97", b"no summary"],
        f"post/{STATION}/r1": [b"", b"\x94", encode_post(Post(0, 1, "x", b""))[:-1]],
    }
    for topic, messages in bad.items():
        for message in messages:
            send(link, topic, message)
    send(link, f"post/{STATION}/r1", encode_post(Post(0, 1, "x", b"good")))
    link.send("summary/r1", b"no frame", 0)
    link.send("summary", b"no sender, no frame", 0)
    station.tick(0)
    assert {name: count for name, count in station.counts.items() if name.startswith("refused")} == {
        "refused.delta": 4, "refused.summary": 3, "refused.post": 3, "refused.short": 1,
        "refused.checksum": 1,
    }  # fmt: skip
    assert replica.store.robots() == []
    assert heard == [("r1", "x", b"good")]


def test_a_node_without_a_replica_only_reports() -> None:
    hub = MemoryHub(600)
    nodes = star(scans(2), hub.link)
    channel = Channel(CHANNEL, own=nodes["r1"].own)
    nodes["r1"].courier = Courier(_rejoined(nodes["r1"], hub), [channel], peers=[STATION], settings=QUICK)
    run(nodes, 0, 8)
    station = nodes[STATION]
    assert station.replica.digest() == undisturbed(nodes).digest() == nodes["r2"].replica.digest()
    assert nodes["r1"].courier.counts["messages_received.delta"] == 0
    assert station.courier.behind("r2") == {}


def _rejoined(node, hub: MemoryHub) -> Link:  # type: ignore[no-untyped-def]
    node.link.close()
    return hub.link(node.name)


def test_who_can_not_take_part() -> None:
    hub = MemoryHub(600)
    with pytest.raises(InputError, match="can't report as 'r1'"):
        Courier(hub.link("r2"), [Channel(CHANNEL, own=Mapper("r1", LATTICE, MODEL))])
    with pytest.raises(InputError, match="without slashes"):
        Courier(hub.link("fleet/r3"))
    with pytest.raises(InputError, match="needs 64 at least"):
        Courier(MemoryHub(63).link("r1"))


def test_who_was_silent_for_long_makes_room(monkeypatch: pytest.MonkeyPatch) -> None:
    """Who looks at a station has another name each time."""
    monkeypatch.setattr(courier_, "MOST_PEERS", 3)
    hub = MemoryHub()
    station, now_ns = Courier(hub.link("station")), 0
    for k in range(6):
        looker = Courier(hub.link(f"ops-{k}"), peers=["station"])
        for _ in range(20):
            now_ns += 100_000_000
            station.tick(now_ns)
            looker.tick(now_ns)
        assert (f"ops-{k}" in station.reached(now_ns)) == (k < 3)
    now_ns += 601 * 1_000_000_000
    station.tick(now_ns)
    for _ in range(20):
        now_ns += 100_000_000
        station.tick(now_ns)
        looker.tick(now_ns)
    assert "ops-5" in station.reached(now_ns)
