"""How links come about: in memory for the nodes of one process, over Zenoh for those of many."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from terrafuse.errors import InputError
from terrafuse.exchange.links import Link, MemoryHub
from terrafuse.services.settings import FleetSettings, LinkPart

if TYPE_CHECKING:
    from terrafuse.exchange.links.transport import Transport

Tell = Callable[[str], None]
Carrier = Callable[[str], Callable[[], Link]]
"""By a node's name, what makes its link; each time a new one."""


def carrier(settings: FleetSettings, tell: Tell) -> Carrier:
    return CARRIERS[settings.link.kind](settings, tell)


def _memory(settings: FleetSettings, tell: Tell) -> Carrier:
    hub = MemoryHub()
    return lambda node: lambda: hub.link(node)


def _zenoh(settings: FleetSettings, tell: Tell) -> Carrier:
    from terrafuse.exchange.links.transport import addresses
    from terrafuse.exchange.links.zenoh import ZenohLink

    def of_node(node: str) -> Callable[[], Link]:
        station = settings.station is not None and node == settings.station.name
        part = settings.robots.get(node)
        transport = transport_of(settings.link, node, station, () if part is None else part.listen)
        addresses(transport)  # what is wrong with them is said before anything starts
        return lambda: ZenohLink(node, transport, lambda text: tell(f"{node}: {text}"))

    return of_node


def upstream(settings: FleetSettings, tell: Tell) -> Callable[[], Link] | None:
    """What makes the station's link to the one above it, if there is one."""
    part, link = settings.station, settings.link
    if part is None or not part.upstream:
        return None
    if link.kind != "zenoh":
        raise InputError(f"link kind '{link.kind}' has no stations above stations; make it 'zenoh'")
    above = link.model_copy(update={"connect": part.upstream})
    return _zenoh(FleetSettings(link=above), lambda text: tell(f"to {part.upstream_name}: {text}"))(part.name)


def transport_of(link: LinkPart, node: str, listens: bool, also: tuple[str, ...] = ()) -> Transport:
    """`also`: where a node listens that is no station."""
    from terrafuse.exchange.links.transport import Transport

    keys = None if link.keys is None else link.keys.replace("{node}", node)
    listen, connect = (link.listen, ()) if listens else (also, link.connect)
    return Transport(listen=listen, connect=connect, keys=keys, insecure=link.insecure)


CARRIERS: dict[str, Callable[[FleetSettings, Tell], Carrier]] = {"memory": _memory, "zenoh": _zenoh}
