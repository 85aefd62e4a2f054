"""`terrafuse keys …`: a fleet's certificates."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from terrafuse.cli.commands import Json
from terrafuse.cli.output import say, say_json

if TYPE_CHECKING:
    from terrafuse.keys.fleet import Fleet, Member

keys_app = typer.Typer(
    help="Certificates: who may be in a fleet, and as whom. docs/security.md",
    no_args_is_help=True,
    add_completion=False,
)

FleetFolder = Annotated[Path, typer.Option("--fleet", help="The fleet's folder.")]
CaFolder = Annotated[
    Path | None,
    typer.Option("--ca", help="Folder of the fleet's authority, where it is kept apart.  [default: FLEET/ca]"),
]
Name = Annotated[str, typer.Argument(metavar="NAME", help="A node's name: a robot's, a station's, an operator's.")]
Hosts = Annotated[
    list[str] | None,
    typer.Option("--host", metavar="HOST", help="An address or name by which others reach this node; repeatable."),
]
Days = Annotated[int, typer.Option(help="How long the certificate holds.")]


@keys_app.command("new-fleet")
def new_fleet(
    out: Annotated[Path, typer.Option("--out", help="The folder for it.")] = Path("fleet"),
    ca: CaFolder = None,
    days: Annotated[int, typer.Option(help="How long the fleet's authority holds.")] = 3650,
    json: Json = False,
) -> None:
    """Begin a fleet: an authority that makes certificates, and no members yet."""
    fleets = _fleets()
    fleet = fleets.Fleet.new(out, ca, days)
    if json:
        say_json({"fleet": str(fleet.folder), "ca": str(fleet.ca)})
        return
    say(f"{fleet.folder}: a fleet without members; terrafuse keys add NAME --fleet {fleet.folder}")
    say(f"{fleet.ca / fleets.CA_KEY} makes members: keep it where robots and networks don't get at it")


@keys_app.command("add")
def add(
    name: Name,
    fleet: FleetFolder = Path("fleet"),
    station: Annotated[
        bool, typer.Option("--station", help="It listens, and passes on what all robots report.")
    ] = False,
    relay_for: Annotated[str, typer.Option(metavar="R,R…", help="Robots whose reports it may pass on.")] = "",
    host: Hosts = None,
    days: Days = 365,
    ca: CaFolder = None,
    json: Json = False,
) -> None:
    """Make a certificate for a node. The folder that is printed goes to that node, and nowhere else."""
    opened = _open(fleet, ca)
    relayed = [part for part in relay_for.split(",") if part]
    opened.add(name, station=station, relay_for=relayed, hosts=host or (), days=days)
    _tell_made(opened, name, json)


@keys_app.command("renew")
def renew(
    name: Name,
    fleet: FleetFolder = Path("fleet"),
    host: Hosts = None,
    days: Days = 365,
    ca: CaFolder = None,
    json: Json = False,
) -> None:
    """Make a node a new certificate, of the same rights; reached by further hosts, if any are given."""
    opened = _open(fleet, ca)
    opened.renew(name, hosts=host or (), days=days)
    _tell_made(opened, name, json)


@keys_app.command("revoke")
def revoke(name: Name, fleet: FleetFolder = Path("fleet"), json: Json = False) -> None:
    """Shut a node out: a robot that was lost, say. Its name is not given again."""
    opened = _open(fleet)
    opened.revoke(name)
    if json:
        say_json(_facts(opened, name))
    else:
        say(f"'{name}' is shut out {_once_known(opened)}")


@keys_app.command("list")
def list_(fleet: FleetFolder = Path("fleet"), json: Json = False) -> None:
    """List a fleet's members, what they may do, and until when."""
    opened = _open(fleet)
    if json:
        names = [member.name for member in opened.roster.members]
        say_json({"fleet": str(fleet), "members": [_facts(opened, name) for name in names]})
        return
    if not opened.roster.members:
        say(f"{fleet}: nobody yet; terrafuse keys add NAME --fleet {fleet}")
    for member in opened.roster.members:
        say(f"{member.name:16} {_state(member):24} {_rights(member)}")


@keys_app.command("show")
def show(name: Name, fleet: FleetFolder = Path("fleet"), json: Json = False) -> None:
    """Show a member: its certificate, and which topics it may send on."""
    opened = _open(fleet)
    facts = _facts(opened, name)
    if json:
        say_json(facts)
        return
    for key, value in facts.items():
        say(f"{key:10} {', '.join(value) if isinstance(value, list) else value}")


def _fleets() -> Any:
    from terrafuse.keys import fleet

    return fleet


def _open(folder: Path, ca: Path | None = None) -> Fleet:
    opened: Fleet = _fleets().Fleet(folder, ca)
    return opened


def _tell_made(fleet: Fleet, name: str, json: bool) -> None:
    facts = _facts(fleet, name)
    if json:
        say_json(facts)
        return
    say(f"{facts['folder']}: the keys of '{name}', until {facts['expires'][:10]}; for that node alone, as --keys")
    say(f"'{name}' is let in {_once_known(fleet)}")


def _once_known(fleet: Fleet) -> str:
    listening = [fleet.node_folder(each.name) for each in fleet.roster.members if each.hosts and not each.revoked]
    if not listening:
        return "once there is a station: terrafuse keys add station --station --host ADDRESS"
    return "within a second where a station's --keys has the new fleet.json: " + ", ".join(map(str, listening))


def _facts(fleet: Fleet, name: str) -> dict[str, Any]:
    from terrafuse.keys.access import keys_of

    member = fleet.member(name)
    return {
        "name": member.name,
        "state": _state(member),
        "station": member.station,
        "relay_for": list(member.relay_for),
        "hosts": list(member.hosts),
        "serial": member.serial,
        "expires": member.expires.isoformat(),
        "folder": str(fleet.node_folder(name)),
        "may_send": [] if member.revoked else keys_of(member),
    }


def _state(member: Member) -> str:
    from datetime import UTC, datetime

    if member.revoked:
        return "revoked"
    if member.expires < datetime.now(UTC):
        return f"expired on {member.expires:%Y-%m-%d}"
    return f"until {member.expires:%Y-%m-%d}"


def _rights(member: Member) -> str:
    rights: Sequence[str] = (
        *(["station"] if member.station else []),
        *([f"relays for {', '.join(member.relay_for)}"] if member.relay_for else []),
        *([f"at {', '.join(member.hosts)}"] if member.hosts else []),
    )
    return "; ".join(rights) or "own reports"
