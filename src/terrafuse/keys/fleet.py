"""A fleet on disk: its members, and their certificates."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import msgspec

from terrafuse.errors import InputError, OutputError
from terrafuse.keys.certificates import Issued, new_authority, new_certificate
from terrafuse.keys.names import LOCAL, host, node_name

NODE_DAYS = 365
AUTHORITY_DAYS = 3650
ROSTER = "fleet.json"
CA, CA_KEY, CERTIFICATE, KEY = "ca.pem", "ca-key.pem", "cert.pem", "key.pem"


@dataclass(frozen=True)
class Member:
    """A node, and what it may do."""

    name: str
    serial: str
    """Of its certificate, hexadecimal."""
    expires: datetime
    station: bool = False
    """May pass on what any robot reports, and send what stations send."""
    relay_for: tuple[str, ...] = ()
    """Robots whose reports it may pass on."""
    hosts: tuple[str, ...] = ()
    """Where others reach it; none: it may not listen."""
    revoked: bool = False


@dataclass(frozen=True)
class Roster:
    """What `fleet.json` holds."""

    fleet: str
    members: tuple[Member, ...] = ()
    version: int = 1

    def member(self, name: str) -> Member | None:
        return next((member for member in self.members if member.name == name), None)

    def but(self, member: Member) -> Roster:
        """With this member, in place of any of its name."""
        others = [each for each in self.members if each.name != member.name]
        return replace(self, members=tuple(sorted([*others, member], key=lambda each: each.name)))


class Fleet:
    """A folder of `terrafuse keys new-fleet`. Its methods raise InputError for names and settings that can't be, and
    OutputError where nothing can be written; then nothing has changed."""

    def __init__(self, folder: Path, ca: Path | None = None) -> None:
        self.folder, self.ca = folder, ca or folder / "ca"
        self.roster = read_roster(folder / ROSTER)

    @staticmethod
    def new(folder: Path, ca: Path | None = None, days: int = AUTHORITY_DAYS) -> Fleet:
        """Make a fleet without members. `ca`: where its authority is kept, if not beside the rest."""
        ca = ca or folder / "ca"
        for taken in (folder / ROSTER, ca / CA_KEY):
            if taken.exists():
                raise InputError(f"{taken} exists: there is a fleet already; add to it, or choose another folder")
        issued = new_authority(f"terrafuse fleet {folder.resolve().name}"[:64], check_days(days), datetime.now(UTC))
        _private_folder(ca)
        _write(ca / CA_KEY, issued.key, private=True)
        _write(ca / CA, issued.certificate)
        write_roster(folder / ROSTER, Roster(folder.resolve().name))
        return Fleet(folder, ca)

    def add(
        self,
        name: str,
        *,
        station: bool = False,
        relay_for: Sequence[str] = (),
        hosts: Sequence[str] = (),
        days: int = NODE_DAYS,
    ) -> Path:
        """A new member; returns the folder for it. A station is reached by this machine and by `hosts`."""
        known = self.roster.member(node_name(name))
        if known is not None:
            state = "was revoked" if known.revoked else "is there already"
            raise InputError(f"'{name}' {state}: choose another name" + ("" if known.revoked else ", or renew it"))
        if station and relay_for:
            raise InputError(f"'{name}': a station passes on what all robots report; leave --relay-for out")
        relayed = tuple(sorted({node_name(each) for each in relay_for}))
        listens = station or bool(hosts)
        checked = tuple(dict.fromkeys([*(LOCAL if listens else ()), *(str(host(each)) for each in hosts)]))
        return self._issue(Member(name, "", datetime.now(UTC), station, relayed, checked), days)

    def renew(self, name: str, *, hosts: Sequence[str] = (), days: int = NODE_DAYS) -> Path:
        """A new certificate and key for a member, reached by these hosts, too. The old ones stay valid to their end."""
        member = self._existing(name)
        added = [str(host(each)) for each in hosts]
        first = LOCAL if added and not member.hosts else member.hosts
        return self._issue(replace(member, hosts=tuple(dict.fromkeys([*first, *added]))), days)

    def revoke(self, name: str) -> None:
        """From now on nobody takes anything from it or tells it anything; its name is not given again."""
        self._write_rosters(self.roster.but(replace(self._existing(name), revoked=True)))

    def member(self, name: str) -> Member:
        """One that is or was there. Raises InputError."""
        member = self.roster.member(name)
        if member is None:
            names = ", ".join(each.name for each in self.roster.members) or "nobody yet"
            raise InputError(f"there is no '{name}' in {self.folder}; there are: {names}")
        return member

    def node_folder(self, name: str) -> Path:
        return self.folder / "nodes" / name

    def _existing(self, name: str) -> Member:
        member = self.member(name)
        if member.revoked:
            raise InputError(f"'{name}' was revoked; add it by another name")
        return member

    def _issue(self, member: Member, days: int) -> Path:
        hosts = [host(each) for each in member.hosts]
        authority = (_read(self.ca / CA), _read(self.ca / CA_KEY))
        try:
            issued = new_certificate(member.name, hosts, authority, check_days(days), datetime.now(UTC))
        except (ValueError, TypeError) as error:
            raise InputError(f"{self.ca}: no authority of a fleet ({error}); give --ca the right folder") from error
        folder = self.node_folder(member.name)
        _private_folder(folder)
        self._write_node(folder, issued)
        self._write_rosters(self.roster.but(replace(member, serial=issued.serial, expires=issued.expires)))
        return folder

    def _write_node(self, folder: Path, issued: Issued) -> None:
        """The certificate last: who watches for a new one then finds all that belongs to it."""
        ca = _read(self.ca / CA)
        if not (folder / CA).exists() or _read(folder / CA) != ca:
            _write(folder / CA, ca)
        _write(folder / KEY, issued.key, private=True)
        _write(folder / CERTIFICATE, issued.certificate)

    def _write_rosters(self, roster: Roster) -> None:
        """To the fleet's folder, and to those of all who listen, who go by it."""
        self.roster = roster
        write_roster(self.folder / ROSTER, roster)
        for member in roster.members:
            if member.hosts and (folder := self.node_folder(member.name)).is_dir():
                write_roster(folder / ROSTER, roster)


def read_roster(path: Path) -> Roster:
    """Raises InputError for what is none."""
    text = _read(path)
    try:
        roster = msgspec.json.decode(text, type=Roster)
    except ValueError as error:
        raise InputError(f"{path}: damaged ({error}); take a copy from the fleet's folder") from error
    if roster.version != 1:
        raise InputError(f"{path}: of version {roster.version}, and this terrafuse reads 1; update it")
    for member in roster.members:
        for name in (member.name, *member.relay_for):
            node_name(name)
    return roster


def write_roster(path: Path, roster: Roster) -> None:
    _write(path, msgspec.json.format(msgspec.json.encode(roster), indent=2) + b"\n")


def check_days(days: int) -> int:
    if not 1 <= days <= 36_500:
        raise InputError(f"--days {days}: give 1 to 36500")
    return days


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; give a folder of `terrafuse keys new-fleet`") from error


def _private_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        folder.chmod(0o700)
    except OSError as error:
        raise OutputError(f"{folder}: {error.strerror}; choose a folder that can be written") from error


def _write(path: Path, content: bytes, private: bool = False) -> None:
    """In one go: who reads meanwhile sees all of the old or all of the new. A key is nobody else's at no time."""
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.unlink(missing_ok=True)
        with os.fdopen(
            os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600 if private else 0o644), "wb"
        ) as out:
            out.write(content)
        partial.replace(path)
    except OSError as error:
        raise OutputError(f"{path}: {error.strerror}; choose a folder that can be written") from error
