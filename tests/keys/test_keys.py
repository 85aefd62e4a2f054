"""Fleets of certificates: what is made, what is refused, and what the rules say."""

from __future__ import annotations

import json
import stat
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

pytest.importorskip("cryptography")

from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID

from terrafuse.errors import InputError
from terrafuse.keys.access import access_control, keys_of
from terrafuse.keys.certificates import common_name, may_listen, new_certificate
from terrafuse.keys.fleet import Fleet, Member, Roster, read_roster
from terrafuse.keys.identity import load_identity
from terrafuse.keys.names import host, node_name
from tests.program import terrafuse


@pytest.fixture
def fleet(tmp_path: Path) -> Fleet:
    return Fleet.new(tmp_path / "fleet")


def certificate(folder: Path) -> x509.Certificate:
    return x509.load_pem_x509_certificate((folder / "cert.pem").read_bytes())


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_a_robots_certificate_is_for_connecting_under_its_name_alone(fleet: Fleet) -> None:
    folder = fleet.add("r4", days=30)
    made = certificate(folder)
    assert common_name(made) == "r4"
    assert not may_listen(made)
    uses = made.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
    assert list(uses) == [ExtendedKeyUsageOID.CLIENT_AUTH]
    made.verify_directly_issued_by(x509.load_pem_x509_certificate((folder / "ca.pem").read_bytes()))
    assert abs(made.not_valid_after_utc - datetime.now(UTC) - timedelta(days=30)) < timedelta(minutes=1)


def test_a_stations_certificate_names_where_it_is_reached(fleet: Fleet) -> None:
    made = certificate(fleet.add("station", station=True, hosts=["10.0.0.1", "map.example", "fe80::1"]))
    assert may_listen(made)
    names = made.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert names.get_values_for_type(x509.DNSName) == ["localhost", "map.example"]
    assert [str(each) for each in names.get_values_for_type(x509.IPAddress)] == [
        "127.0.0.1",
        "::1",
        "10.0.0.1",
        "fe80::1",
    ]


def test_no_certificate_outlives_the_authority(tmp_path: Path) -> None:
    short = Fleet.new(tmp_path / "fleet", days=10)
    made = certificate(short.add("r4", days=365))
    authority = x509.load_pem_x509_certificate((short.ca / "ca.pem").read_bytes())
    assert made.not_valid_after_utc == authority.not_valid_after_utc


def test_keys_are_nobody_elses(fleet: Fleet) -> None:
    folder = fleet.add("r4")
    assert mode(fleet.ca / "ca-key.pem") == mode(folder / "key.pem") == 0o600
    assert mode(fleet.ca) == mode(folder) == 0o700
    assert not list(fleet.folder.rglob(".*"))
    secrets = {path for path in fleet.folder.rglob("*.pem") if b"PRIVATE" in path.read_bytes()}
    assert secrets == {fleet.ca / "ca-key.pem", folder / "key.pem"}


def test_the_authority_may_be_kept_elsewhere(tmp_path: Path) -> None:
    ca = tmp_path / "safe"
    fleet = Fleet.new(tmp_path / "fleet", ca)
    assert not (fleet.folder / "ca").exists()
    fleet.add("r4")
    with pytest.raises(InputError, match=r"ca\.pem"):
        Fleet(fleet.folder).add("r5")
    assert Fleet(fleet.folder, ca).add("r5").is_dir()


def test_an_authority_of_another_fleet_makes_no_members(fleet: Fleet, tmp_path: Path) -> None:
    other = Fleet.new(tmp_path / "other")
    (fleet.ca / "ca.pem").write_bytes((other.ca / "ca.pem").read_bytes())
    with pytest.raises(InputError, match="--ca"):
        fleet.add("r4")
    assert fleet.roster.members == ()


@pytest.mark.parametrize("name", ["", "a/b", "../x", ".x", "-x", "x.", "a b", "ä", "x" * 64, "a\n", "*", "$*", "@a"])
def test_names_that_some_system_would_misread_are_refused(fleet: Fleet, name: str) -> None:
    with pytest.raises(InputError, match="a name has"):
        fleet.add(name)
    with pytest.raises(InputError, match="a name has"):
        fleet.add("r4", relay_for=[name])
    assert fleet.roster.members == ()


@pytest.mark.parametrize("text", ["", "a b", "h:7447", "a..b", "-a", "http://x", "x" * 254])
def test_hosts_that_are_none_are_refused(fleet: Fleet, text: str) -> None:
    with pytest.raises(InputError, match="host"):
        fleet.add("station", station=True, hosts=[text])


def test_hosts_and_names_that_are_some() -> None:
    assert str(host("[::1]")) == "::1"
    assert host("map-1.example") == "map-1.example"
    assert node_name("R2_d.2-x") == "R2_d.2-x"


def test_a_name_is_given_once(fleet: Fleet) -> None:
    fleet.add("r4")
    with pytest.raises(InputError, match="renew it"):
        fleet.add("r4")
    fleet.revoke("r4")
    for again in (fleet.add, fleet.renew, fleet.revoke):
        with pytest.raises(InputError, match="'r4' was revoked"):
            again("r4")
    with pytest.raises(InputError, match=r"there is no 'r5'.*r4"):
        fleet.revoke("r5")


def test_a_fleet_is_not_made_over_another(fleet: Fleet) -> None:
    with pytest.raises(InputError, match="there is a fleet already"):
        Fleet.new(fleet.folder)


@pytest.mark.parametrize("days", [0, -1, 40_000])
def test_days_that_no_certificate_has_are_refused(fleet: Fleet, days: int) -> None:
    with pytest.raises(InputError, match=f"--days {days}"):
        fleet.add("r4", days=days)


def test_who_listens_has_the_roster_and_gets_each_change(fleet: Fleet) -> None:
    station = fleet.add("station", station=True)
    robot = fleet.add("r4")
    assert not (robot / "fleet.json").exists()
    assert read_roster(station / "fleet.json") == fleet.roster == Fleet(fleet.folder).roster
    assert [member.name for member in fleet.roster.members] == ["r4", "station"]


def test_a_renewed_certificate_keeps_its_rights_and_adds_hosts(fleet: Fleet) -> None:
    fleet.add("r4", relay_for=["r6", "r5"])
    before = fleet.member("r4")
    fleet.renew("r4", hosts=["10.0.0.4"])
    after = fleet.member("r4")
    assert after.relay_for == ("r5", "r6")
    assert after.hosts == ("localhost", "127.0.0.1", "::1", "10.0.0.4")
    assert after.serial != before.serial


@pytest.mark.parametrize("text", ["", "{", "[]", '{"fleet": 3}', '{"fleet": "f", "members": [{"name": "r4"}]}'])
def test_a_damaged_roster_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "fleet.json").write_text(text)
    with pytest.raises(InputError, match="damaged"):
        read_roster(tmp_path / "fleet.json")


def test_a_roster_with_names_that_rules_would_misread_is_refused(fleet: Fleet) -> None:
    fleet.add("r4")
    path = fleet.folder / "fleet.json"
    path.write_text(path.read_text().replace('"r4"', '"**"'))
    with pytest.raises(InputError, match="a name has"):
        Fleet(fleet.folder)


def test_a_newer_roster_is_refused(fleet: Fleet) -> None:
    path = fleet.folder / "fleet.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"version": 2}))
    with pytest.raises(InputError, match=r"version 2.*update"):
        Fleet(fleet.folder)


def member(name: str, **rights: object) -> Member:
    return Member(name, "1", datetime.now(UTC), **rights)  # type: ignore[arg-type]


def allowed(who: Member, key: str) -> bool:
    """By Zenoh's own rule of which key expression includes which."""
    zenoh = pytest.importorskip("zenoh")
    return any(zenoh.KeyExpr(each).includes(key) for each in keys_of(who))


@pytest.mark.parametrize(
    ("topic", "robot", "relay", "station"),
    [
        ("terrafuse/delta/fine/r4/r4", True, True, True),
        ("terrafuse/delta/coarse/r5/r4", False, True, True),
        ("terrafuse/delta/fine/r6/r4", False, False, True),
        ("terrafuse/delta/fine/r4/r5", False, False, False),
        ("terrafuse/delta/fine/r5/r5", False, False, False),
        ("terrafuse/delta/**", False, False, False),
        ("terrafuse/delta/fine/*/r4", False, False, True),
        ("terrafuse/summary/r4", True, True, True),
        ("terrafuse/tiles/fine/r5/r4", True, True, True),
        ("terrafuse/summary/r5", False, False, False),
        ("terrafuse/post/station/r4", True, True, True),
        ("terrafuse/post/station/r5", False, False, False),
        ("terrafuse/other/r4", False, False, True),
        ("terrafuse-nodes/end/r4/life", True, True, True),
        ("terrafuse-nodes/hub/r5/life", False, False, False),
        ("terrafuse-names/r5", False, False, False),
    ],
)
def test_what_r4_may_send(topic: str, robot: bool, relay: bool, station: bool) -> None:
    assert allowed(member("r4"), topic) is robot
    assert allowed(member("r4", relay_for=("r5",)), topic) is relay
    assert allowed(member("r4", station=True), topic) is station


def test_who_is_revoked_is_no_subject_of_any_rule() -> None:
    rules = access_control(Roster("f", (member("r4"), member("r5", revoked=True))))
    assert [subject["cert_common_names"] for subject in rules["subjects"]] == [["r4"]]
    assert rules["default_permission"] == "deny"


def test_keys_are_checked_before_they_are_used(fleet: Fleet, tmp_path: Path) -> None:
    station, robot, other = fleet.add("station", station=True), fleet.add("r4"), fleet.add("r5")
    assert load_identity(station, "station", listens=True).access is not None
    assert load_identity(robot, "r4", listens=False).access is None
    with pytest.raises(InputError, match="the keys of 'r4', not of 'r5'"):
        load_identity(robot, "r5", listens=False)
    with pytest.raises(InputError, match="renew r4 --host"):
        load_identity(robot, "r4", listens=True)
    (robot / "key.pem").write_bytes((other / "key.pem").read_bytes())
    with pytest.raises(InputError, match=r"not that of cert\.pem"):
        load_identity(robot, "r4", listens=False)
    (robot / "ca.pem").write_bytes((Fleet.new(tmp_path / "o").ca / "ca.pem").read_bytes())
    with pytest.raises(InputError, match="different fleets"):
        load_identity(robot, "r4", listens=False)
    (robot / "cert.pem").write_text("nonsense")
    with pytest.raises(InputError, match="damaged"):
        load_identity(robot, "r4", listens=False)
    (robot / "cert.pem").unlink()
    with pytest.raises(InputError, match=r"cert.pem is not there; give --keys"):
        load_identity(robot, "r4", listens=False)


@pytest.mark.parametrize(
    ("made_ago", "days", "says"), [(timedelta(days=20), 10, "expired on"), (timedelta(days=-3), 10, "set the clock")]
)
def test_certificates_out_of_time_are_refused(fleet: Fleet, made_ago: timedelta, days: int, says: str) -> None:
    folder = fleet.add("r4")
    authority = ((fleet.ca / "ca.pem").read_bytes(), (fleet.ca / "ca-key.pem").read_bytes())
    issued = new_certificate("r4", [], authority, days, datetime.now(UTC) - made_ago)
    (folder / "cert.pem").write_bytes(issued.certificate)
    (folder / "key.pem").write_bytes(issued.key)
    with pytest.raises(InputError, match=says):
        load_identity(folder, "r4", listens=False)


def test_a_change_of_the_files_is_noticed(fleet: Fleet) -> None:
    identity = load_identity(fleet.add("station", station=True), "station", listens=True)
    assert not identity.changed()
    fleet.add("r4")
    assert identity.changed()


def test_the_commands(tmp_path: Path) -> None:
    def keys(*arguments: str) -> dict[str, object]:
        ran = terrafuse("keys", *arguments, "--json", cwd=tmp_path)
        assert ran.code == 0, ran.err
        return ran.json

    assert keys("new-fleet") == {"fleet": "fleet", "ca": "fleet/ca"}
    assert keys("add", "station", "--station", "--host", "10.0.0.1")["station"] is True
    assert keys("add", "r4", "--relay-for", "r5,r6", "--days", "3")["relay_for"] == ["r5", "r6"]
    assert keys("renew", "r4")["folder"] == "fleet/nodes/r4"
    assert "terrafuse/delta/**/r5/r4" in keys("show", "r4")["may_send"]  # type: ignore[operator]
    assert keys("revoke", "r4")["may_send"] == []
    listed = keys("list")["members"]
    assert next((each["name"], each["state"]) for each in listed) == ("r4", "revoked")  # type: ignore[attr-defined]
    assert "r4               revoked" in terrafuse("keys", "list", cwd=tmp_path).out
    missing = terrafuse("keys", "show", "r9", cwd=tmp_path)
    assert missing.code == 2
    assert "there is no 'r9'" in missing.err
