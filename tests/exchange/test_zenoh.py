"""Links over Zenoh, without encryption: what every link keeps, and what this one says and survives."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from secrets import token_bytes

import pytest

pytest.importorskip("zenoh")

from terrafuse.errors import InputError, TerrafuseError
from terrafuse.exchange.links import Link
from terrafuse.exchange.links import zenoh as links_zenoh
from terrafuse.exchange.links.topics import key_of, topic_of
from terrafuse.exchange.links.transport import LARGEST_BATCH, Address, Transport, address
from terrafuse.exchange.links.zenoh import ZenohLink
from terrafuse.testing.links import LinkTests
from terrafuse.testing.relay import Mishaps, Relay
from tests.exchange.zenoh_nodes import LOOPBACK, PATIENCE_S, collected, free_port, joining, until


def plain(**settings: object) -> Transport:
    return Transport(insecure=True, **settings)  # type: ignore[arg-type]


def received(link: ZenohLink) -> int:
    """How many frames came by now; they are taken."""
    link.receive(0)
    return link.counts["frames_received"]


def reaches(sender: ZenohLink, *receivers: ZenohLink) -> bool:
    """Whether a frame, the last one, arrives: that somebody listens takes a while to get around."""
    probe = token_bytes(8)
    sender.send("x", probe, 0)
    time.sleep(0.2)
    return all(probe in [frame.payload for frame in receiver.receive(0)] for receiver in receivers)


@pytest.fixture
def here() -> str:
    return f"tcp/{LOOPBACK}:{free_port()}"


class TestZenohLink(LinkTests):
    @pytest.fixture
    def join(self, here: str) -> Iterator[Callable[[str], Link]]:
        with joining(plain(listen=here), plain(connect=here)) as join:
            yield join


def test_topics_are_keys_that_wildcards_reach() -> None:
    assert key_of("delta/fine/r4") == "delta/fine/r4"
    assert key_of("delta/@r4/50%/a@b") == "delta/%40r4/50%25/a@b"
    for topic in ("@", "%40", "%2540/@x", "a/%25/@@"):
        assert topic_of(key_of(topic)) == topic
        assert "/@" not in "/" + key_of(topic)


@pytest.mark.parametrize(
    ("text", "protocol", "expected"),
    [
        ("10.0.0.1", "tls", Address("tls", "10.0.0.1", 7447)),
        ("tcp/0.0.0.0:7447", "tcp", Address("tcp", "0.0.0.0", 7447)),
        ("tls/[::1]:17", "tls", Address("tls", "::1", 17)),
        ("station.local:80", "tcp", Address("tcp", "station.local", 80)),
    ],
)
def test_addresses_are_read(text: str, protocol: str, expected: Address) -> None:
    assert address(text, protocol) == expected
    assert address(str(expected), protocol) == expected


@pytest.mark.parametrize(
    "text", ["", "tcp/", "tcp/h:99999", "tcp/h:x", "tcp/h:1:2", "a b", "foo/h:1", "tcp//h", "::1:7"]
)
def test_addresses_that_are_none_are_refused(text: str) -> None:
    with pytest.raises(InputError, match="HOST"):
        address(text, "tcp")


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"connect": "h"}, "no keys: give --keys"),
        ({"connect": "h", "keys": "x", "insecure": True}, "keep one"),
        ({"connect": "tls/h", "insecure": True}, "tls needs keys"),
        ({"connect": "tcp/h", "keys": "x"}, "tcp is not encrypted"),
        ({"insecure": True}, "reaches nobody"),
    ],
)
def test_nothing_goes_without_protection_by_accident(settings: dict[str, object], says: str) -> None:
    with pytest.raises(InputError, match=says):
        ZenohLink("r4", Transport(**settings))  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["max_frame_bytes", "queue_bytes", "buffer_bytes", "hung_s"])
def test_impossible_settings_are_refused(name: str) -> None:
    with pytest.raises(InputError, match=name):
        plain(**{name: 0})


def test_an_address_in_use_is_said_to_be() -> None:
    here = f"tcp/{LOOPBACK}:{free_port()}"
    station = ZenohLink("station", plain(listen=here))
    with pytest.raises(InputError, match=f"{here}: the address is in use"):
        ZenohLink("other", plain(listen=here))
    station.close()
    ZenohLink("other", plain(listen=here)).close()


def test_an_address_of_another_machine_is_said_to_be() -> None:
    with pytest.raises(InputError, match="this machine has no such address"):
        ZenohLink("station", plain(listen="203.0.113.4"))


def test_a_robot_without_a_station_says_so_once_and_connects_when_it_comes(here: str) -> None:
    said: list[str] = []
    robot = ZenohLink("r4", plain(connect=here), said.append)
    assert robot.trouble == f"nothing listens at {here}; start the station there, or check host and port"
    robot.send("delta/r4/r4", b"lost", 0)
    assert robot.counts["dropped.unconnected"] == 1
    station = ZenohLink("station", plain(listen=here))
    until(lambda: robot.nodes() == ["station"] and station.nodes() == ["r4"], "each other")
    until(lambda: robot.trouble is None, "peace")
    assert [text.partition(";")[0] for text in said] == [f"nothing listens at {here}", "connected"]
    station.close()
    until(lambda: robot.trouble is not None, "complaint")
    assert len(said) == 3
    assert robot.nodes() == []
    robot.close()


def test_a_name_is_given_once_even_if_the_other_comes_later(here: str) -> None:
    """Both start before the station is there: when they meet, the older one stays."""
    older, younger = (ZenohLink("r4", plain(connect=here)) for _ in range(2))
    station = ZenohLink("station", plain(listen=here))

    def refused() -> bool:
        try:
            younger.receive(0)
        except InputError as error:
            return "there is a node 'r4' already" in str(error)
        return False

    until(refused, "refusal")
    with pytest.raises(InputError, match="'r4' already"):
        younger.send("x", b"", 0)
    older.send("x", b"", 0)
    assert older.receive(0) == []
    assert older.trouble is None
    for link in (older, younger, station):
        link.close()


def test_what_does_not_fit_the_queue_is_dropped_and_counted(here: str) -> None:
    """Of 1000 frames of 50 kB at once, few fit into 100 kB; sending returns at once, and what was taken arrives."""
    station = ZenohLink("station", plain(listen=here))
    station.listen("x")
    robot = ZenohLink("r4", plain(connect=here, queue_bytes=100_000))
    for _ in range(1000):
        robot.send("x", bytes(50_000), 0)
    until(lambda: robot.counts["frames_sent"] + robot.counts["dropped.queue"] == 1000, "an end")
    assert robot.counts["dropped.queue"] > 0
    until(lambda: received(station) == robot.counts["frames_sent"], "frames")
    for link in (robot, station):
        link.close()


def test_an_inbox_that_nobody_empties_is_bounded(here: str) -> None:
    """It keeps the newest."""
    station = ZenohLink("station", plain(listen=here, inbox_bytes=10 * LARGEST_BATCH))
    robot, other = ZenohLink("r4", plain(connect=here)), ZenohLink("r5", plain(connect=here))
    for link in (station, other):
        link.listen("x")
    until(lambda: reaches(robot, station, other), "robots")
    before = received(other)
    for number in range(50):
        robot.send("x", bytes([number]), 0)
    until(lambda: received(other) == before + 50, "frames, where somebody empties it")
    assert [frame.payload[0] for frame in station.receive(0)] == list(range(40, 50))
    assert station.counts["full.inbox"] == 1
    assert station.receive(0) == []
    for link in (robot, other, station):
        link.close()


def test_a_session_that_hears_nothing_is_made_anew(here: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """By who connects and asks in vain; not by who listens, nor by who does not ask."""
    monkeypatch.setattr(links_zenoh, "DEAF_S", 1.0)
    station, robot, idle = (ZenohLink(name, plain(**{way: here})) for name, way in
                            (("station", "listen"), ("r1", "connect"), ("r2", "connect")))  # fmt: skip
    for link in (station, robot, idle):
        link.listen("x")
    until(lambda: (received(robot), received(station), robot.counts["renewed"])[-1] > 0, "a new session")
    until(lambda: reaches(station, robot), "that it hears")
    assert (station.counts["renewed"], idle.counts["renewed"]) == (0, 0)
    for link in (station, robot, idle):
        link.close()


def test_one_hung_robot_keeps_neither_others_nor_the_end_waiting(here: str) -> None:
    """What is sent past it arrives elsewhere; a station that leaves does so, and another listens in its place."""
    station = ZenohLink("station", plain(listen=here))
    with Relay(here.removeprefix("tcp/"), Mishaps(stall=1.0, within_s=0.5)) as relay:
        hung, well = (ZenohLink(name, plain(connect=at)) for name, at in (("r1", relay.address), ("r2", here)))
        for robot in (hung, well):
            robot.listen("x")
        until(lambda: relay.counts["stalled"] == 1 and station.nodes() == ["r1", "r2"], "a hung robot")
        for k in range(100):
            station.send("x", bytes(50_000) + bytes([k]), 0)
            frames = collected(well, lambda frames: len(frames) == 1)
            assert frames[0].payload[-1] == k
        leaving = threading.Thread(target=station.close, daemon=True)
        leaving.start()
        leaving.join(5.0)
        assert not leaving.is_alive()
        ZenohLink("station", plain(listen=here)).close()
        for robot in (hung, well):
            robot.close()


def test_who_uses_a_link_never_waits_for_its_thread(here: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """It hangs, as it would in Zenoh; and says so, in time."""
    monkeypatch.setattr(links_zenoh, "STUCK_S", 2.0)
    station = ZenohLink("station", plain(listen=here))
    hangs, release = threading.Event(), threading.Event()

    def tell(text: str) -> None:
        hangs.set()
        release.wait(PATIENCE_S)

    robot = ZenohLink("r4", plain(connect=here), tell)
    until(lambda: robot.connected, "a connection")
    station.close()
    assert hangs.wait(PATIENCE_S)
    began_s = time.monotonic()
    robot.listen("x")
    robot.send("x", b"", 0)
    robot.nodes()
    assert robot.receive(0) == []
    assert time.monotonic() - began_s < 1.5

    def stuck() -> bool:
        try:
            robot.receive(0)
        except TerrafuseError as error:
            return "'r4' waiting" in str(error)
        return False

    until(stuck, "what is wrong")
    began_s = time.monotonic()
    robot.close()
    assert time.monotonic() - began_s < 3.0
    release.set()


def test_topics_come_and_sessions_go_while_frames_arrive(here: str) -> None:
    """Declaring and undeclaring waits for callbacks that run, and those for nothing that is held meanwhile."""
    station, robot = ZenohLink("station", plain(listen=here)), ZenohLink("r4", plain(connect=here))
    ended = threading.Event()

    def flood() -> None:
        while not ended.is_set():
            for k in range(8):
                station.send(f"x/{k}/{k}", bytes(2000), 0)
            time.sleep(0.001)

    flooding = threading.Thread(target=flood)
    flooding.start()
    try:
        for round_ in range(5):
            link = ZenohLink(f"s{round_}", plain(connect=here))
            for k in range(8):
                link.listen(f"x/{k}/{k}")
            for topic in ("x/0", "x/1", "x"):
                link.listen(topic)
            topics = {f"x/{k}/{k}" for k in range(8)}
            collected(link, lambda frames, all_=topics: {frame.topic for frame in frames} == all_)  # type: ignore[misc]
            robot._end_session()  # as where keys were renewed
            robot.listen(f"x/{round_}")
            link.close()
        collected(robot, lambda frames: {frame.topic for frame in frames} >= {f"x/{k}/{k}" for k in range(5)})
    finally:
        ended.set()
        flooding.join()
        for link in (robot, station):
            link.close()


WITHOUT = """
import sys
sys.modules[sys.argv[1]] = None  # as where it is not installed
from terrafuse.errors import MissingExtra
from terrafuse.exchange.links.transport import Transport
from terrafuse.exchange.links.zenoh import ZenohLink
try:
    ZenohLink("r4", Transport(connect="127.0.0.1", keys="nowhere"))
except MissingExtra as error:
    sys.stdout.write(str(error))
"""


@pytest.mark.parametrize(("module", "package"), [("zenoh", "eclipse-zenoh"), ("cryptography", "cryptography")])
def test_what_is_not_installed_is_named_with_its_extra(module: str, package: str) -> None:
    ran = subprocess.run([sys.executable, "-c", WITHOUT, module], capture_output=True, text=True, check=True)
    assert ran.stdout.endswith(f"needs the package '{package}': pip install 'terrafuse[net]'")
