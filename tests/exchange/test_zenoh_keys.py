"""Links over Zenoh with certificates: who gets in, and what he can say there."""

from __future__ import annotations

import socket
import ssl
import threading
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

pytest.importorskip("zenoh")
pytest.importorskip("cryptography")

from terrafuse.exchange.codec import encode
from terrafuse.exchange.framing import frames_of
from terrafuse.exchange.links.reach import diagnosis
from terrafuse.exchange.links.transport import Address, Transport, address
from terrafuse.exchange.links.zenoh import NO_WORD_S, ZenohLink
from terrafuse.keys.certificates import new_certificate
from terrafuse.keys.fleet import Fleet
from terrafuse.keys.identity import Identity, load_identity
from terrafuse.keys.names import host
from terrafuse.mapper import Mapper
from terrafuse.testing.deltas import random_scans
from tests.exchange.fleet import LATTICE, MODEL
from tests.exchange.zenoh_nodes import LOOPBACK, free_port, heard, station, until


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Fleet:
    """A station, r4, r5, and r6, which relays for r5."""
    made = Fleet.new(tmp_path_factory.mktemp("keys") / "fleet")
    made.add("station", station=True)
    made.add("r6", relay_for=["r5"])
    for name in ("r4", "r5"):
        made.add(name)
    return made


@pytest.fixture
def here() -> str:
    return f"tls/{LOOPBACK}:{free_port()}"


def link_of(fleet: Fleet, name: str, here: str, tell: Callable[[str], None] = lambda text: None) -> ZenohLink:
    return ZenohLink(name, Transport(connect=here, keys=fleet.node_folder(name)), tell)


FORGED = [
    "delta/fine/r5/r5",
    "delta/fine/r5/r4",
    "delta/fine/r4/r5",
    "delta/fine/r5/station",
    "summary/r5",
    "post/station/r5",
]


def test_a_robots_certificate_lets_it_speak_for_itself_alone(fleet: Fleet, here: str) -> None:
    """r4 reports as r5 in every way; what comes of it at the station is nothing. Then r5 itself does, and r6 for it."""
    mapper = Mapper("r5", LATTICE, MODEL)
    for scan in random_scans(1, 3):
        mapper.integrate(scan)
    with station(listen=here, keys=fleet.node_folder("station")) as process:
        thief, robot, relay = (link_of(fleet, name, here) for name in ("r4", "r5", "r6"))
        until(lambda: process.ask("nodes") == ["r4", "r5", "r6"], "robots")
        process.ask("topics")
        for topic in FORGED:
            for frame in frames_of(topic, encode(mapper.delta()), thief.max_frame_bytes):
                thief.send(*frame, 0)
        thief.send("pose/r4", b"a mark: what was sent before has been judged", 0)
        assert heard(process, "pose/r4") == ["pose/r4"]
        assert process.ask("level r5") == 0
        for link, topic in ((relay, "delta/fine/r5/r6"), (robot, "delta/fine/r5/r5")):
            link.send(topic, b"", 0)
            assert topic in heard(process, topic)
        for link in (thief, robot, relay):
            link.close()


def test_a_station_that_is_alone_is_well(fleet: Fleet, here: str) -> None:
    said: list[str] = []
    station = ZenohLink("station", Transport(listen=here, keys=fleet.node_folder("station")), said.append)
    robot = link_of(fleet, "r4", here)
    until(lambda: station.nodes() == ["r4"], "the robot")
    robot.close()
    until(lambda: not station.nodes(), "it to go")
    time.sleep(2 * NO_WORD_S)
    assert said == []
    assert station.trouble is None
    station.close()


def test_no_certificate_no_connection(fleet: Fleet, here: str) -> None:
    with station(listen=here, keys=fleet.node_folder("station")) as process:
        said: list[str] = []
        plain = ZenohLink("r4", Transport(connect=here.replace("tls", "tcp"), insecure=True), said.append)
        until(lambda: bool(said), "complaint")
        assert "but not as a station without encryption" in said[0]
        assert not plain.connected
        plain.close()
        context = ssl.create_default_context(cafile=str(fleet.node_folder("r4") / "ca.pem"))
        with pytest.raises((ssl.SSLError, ConnectionError)):
            greeted(here, context)
        assert process.ask("nodes") == []


def greeted(here: str, context: ssl.SSLContext) -> bytes:
    """What a station says first to who connects so."""
    at = address(here, "tls")
    with (
        socket.create_connection((at.host, at.port), 5) as plain,
        context.wrap_socket(plain, server_hostname=at.host) as end,
    ):
        return end.recv(1)


def test_a_certificate_of_another_fleet_is_worth_nothing(fleet: Fleet, here: str, tmp_path: Path) -> None:
    other = Fleet.new(tmp_path / "other")
    other.add("r4")
    with station(listen=here, keys=fleet.node_folder("station")) as process:
        stranger = link_of(other, "r4", here)
        assert stranger.trouble is not None
        assert "is not of this fleet" in stranger.trouble
        assert not stranger.connected
        stranger.close()
        context = ssl.create_default_context(cafile=str(fleet.node_folder("r4") / "ca.pem"))
        folder = other.node_folder("r4")
        context.load_cert_chain(folder / "cert.pem", folder / "key.pem")
        with pytest.raises((ssl.SSLError, ConnectionError)):
            greeted(here, context)
        assert process.ask("nodes") == []


def test_a_station_by_another_name_is_not_trusted(fleet: Fleet) -> None:
    """127.0.0.2 is this machine, too, but no certificate is for it."""
    port = free_port()
    with station(listen=f"tls/0.0.0.0:{port}", keys=fleet.node_folder("station")):
        robot = link_of(fleet, "r4", f"tls/127.0.0.2:{port}")
        assert robot.trouble is not None
        assert "is for other names than '127.0.0.2'" in robot.trouble
        assert "--host 127.0.0.2" in robot.trouble
        assert not robot.connected
        robot.close()


@pytest.fixture
def pretender() -> Iterator[Callable[[Path], Address]]:
    """Listens with the keys of a folder, and talks TLS, no more."""
    servers: list[socket.socket] = []

    def listen(keys: Path) -> Address:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(keys / "cert.pem", keys / "key.pem")
        server = socket.create_server((LOOPBACK, 0))
        servers.append(server)

        def serve() -> None:
            while True:
                try:
                    connection, _ = server.accept()
                    with context.wrap_socket(connection, server_side=True) as end:
                        end.recv(1)
                except ssl.SSLError:
                    pass
                except OSError:
                    return

        threading.Thread(target=serve, daemon=True).start()
        return Address("tls", LOOPBACK, server.getsockname()[1])

    yield listen
    for server in servers:
        server.shutdown(socket.SHUT_RDWR)
        server.close()


def test_a_robot_does_not_pass_for_a_station(fleet: Fleet, pretender: Callable[[Path], Address]) -> None:
    said = diagnosis(pretender(fleet.node_folder("r5")), load_identity(fleet.node_folder("r4"), "r4", listens=False))
    assert "is refused" in said
    assert "purpose" in said


def test_a_station_whose_certificate_expired_is_said_to_be_so(
    fleet: Fleet, pretender: Callable[[Path], Address], tmp_path: Path
) -> None:
    authority = ((fleet.ca / "ca.pem").read_bytes(), (fleet.ca / "ca-key.pem").read_bytes())
    old = new_certificate("station", [host(LOOPBACK)], authority, 1, datetime.now(UTC) - timedelta(days=3))
    (tmp_path / "cert.pem").write_bytes(old.certificate)
    (tmp_path / "key.pem").write_bytes(old.key)
    at = pretender(tmp_path)
    said = diagnosis(at, load_identity(fleet.node_folder("r4"), "r4", listens=False))
    assert said == f"the certificate of {at} has expired; renew it: terrafuse keys renew STATION"


@pytest.mark.parametrize(("days_ago", "says"), [(3, "has expired"), (0, "does not know the fleet")])
def test_a_robot_whose_certificate_is_refused_is_told_why(
    fleet: Fleet, here: str, tmp_path: Path, days_ago: int, says: str
) -> None:
    """Its own check of its keys would say so, too, if its clock were right and its ca.pem that of its certificate."""
    source = fleet if days_ago else Fleet.new(tmp_path / "other")
    authority = ((source.ca / "ca.pem").read_bytes(), (source.ca / "ca-key.pem").read_bytes())
    issued = new_certificate("r4", [], authority, 1, datetime.now(UTC) - timedelta(days=days_ago))
    for name, content in {"cert.pem": issued.certificate, "key.pem": issued.key}.items():
        (tmp_path / name).write_bytes(content)
    (tmp_path / "ca.pem").write_bytes((fleet.ca / "ca.pem").read_bytes())
    with station(listen=here, keys=fleet.node_folder("station")):
        assert says in diagnosis(address(here, "tls"), Identity(tmp_path, None, ()))


def test_a_robot_joins_and_another_is_shut_out_while_the_station_goes_on(tmp_path: Path, here: str) -> None:
    fleet = Fleet.new(tmp_path / "fleet")
    keys = fleet.add("station", station=True)
    fleet.add("r1")
    with station(listen=here, keys=keys) as process:
        said: list[str] = []
        old = link_of(fleet, "r1", here, said.append)
        until(lambda: process.ask("nodes") == ["r1"], "r1")
        fleet.add("r2")
        new = link_of(fleet, "r2", here)
        until(lambda: process.ask("nodes") == ["r1", "r2"], "r2")
        new.send("delta/fine/r2/r2", b"", 0)
        assert "delta/fine/r2/r2" in heard(process, "delta/fine/r2/r2")
        fleet.revoke("r1")
        until(lambda: process.ask("nodes") == ["r2"], "r1's end")
        until(lambda: any("it was revoked" in text for text in said), "complaint")
        process.ask("topics")
        old.send("delta/fine/r1/r1", b"", 0)
        until(lambda: old.counts["frames_sent"] > 0, "attempt")
        new.send("pose/r2", b"", 0)
        assert "delta/fine/r1/r1" not in heard(process, "pose/r2")
        for link in (old, new):
            link.close()


def test_rules_that_are_damaged_leave_those_of_before(tmp_path: Path, here: str) -> None:
    fleet = Fleet.new(tmp_path / "fleet")
    keys = fleet.add("station", station=True)
    fleet.add("r1")
    said: list[str] = []
    with_rules = ZenohLink("station", Transport(listen=here, keys=keys), said.append)
    robot = link_of(fleet, "r1", here)
    until(lambda: with_rules.nodes() == ["r1"], "r1")
    (keys / "fleet.json").write_text("{")
    until(lambda: bool(said), "complaint")
    assert "damaged" in said[0]
    assert with_rules.nodes() == ["r1"]
    for link in (robot, with_rules):
        link.close()


def test_a_renewed_certificate_is_taken_while_the_robot_goes_on(tmp_path: Path, here: str) -> None:
    fleet = Fleet.new(tmp_path / "fleet")
    with station(listen=here, keys=fleet.add("station", station=True)) as process:
        fleet.add("r1")
        robot = link_of(fleet, "r1", here)
        until(lambda: process.ask("nodes") == ["r1"], "r1")
        before = robot.counts["connections"]
        fleet.renew("r1")
        until(lambda: robot.counts["connections"] > before, "a new connection")

        def arrived() -> bool:
            """The station, whose list of members changed, too, may be about to begin anew."""
            robot.send("pose/r1", b"", 0)
            return "pose/r1" in process.ask("topics")

        until(arrived, "what r1 says")
        robot.close()


def test_a_relay_speaks_for_a_robot_that_only_it_reaches(tmp_path: Path, here: str) -> None:
    """r5 meets r6, and r6 the station: what r5 says ends at r6, what r6 says for it arrives; r5 hears the station."""
    fleet, at_relay = Fleet.new(tmp_path / "fleet"), f"tls/{LOOPBACK}:{free_port()}"
    keys = {"station": fleet.add("station", station=True), "r6": fleet.add("r6", relay_for=["r5"], hosts=[LOOPBACK])}
    robot_keys = fleet.add("r5")
    hub = ZenohLink("station", Transport(listen=here, keys=keys["station"]))
    relay = ZenohLink("r6", Transport(listen=at_relay, connect=here, keys=keys["r6"]))
    robot = ZenohLink("r5", Transport(connect=at_relay, keys=robot_keys))
    for link in (hub, relay, robot):
        link.listen("delta")
        link.listen("post")
    until(lambda: relay.nodes() == ["r5", "station"] and robot.nodes() == ["r6", "station"], "each other")
    assert hub.nodes() == ["r6"]

    def got(link: ZenohLink, sender: ZenohLink, topic: str) -> set[str]:
        """Topics that came, until this one does: again and again, since who listens is not known everywhere at once."""
        topics: set[str] = set()

        def came() -> bool:
            sender.send(topic, b"", 0)
            topics.update(frame.topic for frame in link.receive(0))
            return topic in topics

        until(came, topic)
        return topics

    assert got(relay, robot, "delta/fine/r5/r5") == {"delta/fine/r5/r5"}
    assert got(hub, relay, "delta/fine/r5/r6") == {"delta/fine/r5/r6"}
    assert "post/r5/station" in got(robot, hub, "post/r5/station")
    for link in (robot, relay, hub):
        link.close()
