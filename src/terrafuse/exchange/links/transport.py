"""How a node reaches the others over Zenoh: settings, checked, and what Zenoh is told by them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from terrafuse.errors import InputError

PORT = 7447
MOST_SESSIONS = 10_000
LARGEST_BATCH = 65_535
_ADDRESS = re.compile(r"(?:(?P<protocol>[a-z]+)/)?(?P<host>\[[0-9a-fA-F:.]+\]|[^\s:/\[\]]+)(?::(?P<port>\d{1,5}))?")
_GIVE = "give [tcp/|tls/]HOST[:PORT], like tls/192.168.1.10:7447 or tls/[::1]:7447"


@dataclass(frozen=True)
class Transport:
    """Where a node listens, to whom it connects, and by which keys. Checked when a link is made of it.

    A node that listens is a *router*: others meet there, and it may connect to further ones. One that only connects is
    a *client*, of the first address that answers. Either `keys`, a folder of `terrafuse keys add`, or `insecure`.
    """

    listen: str | Iterable[str] = ()
    connect: str | Iterable[str] = ()
    keys: str | Path | None = None
    insecure: bool = False
    """No encryption, no identity: whoever reaches the address can say anything in anybody's name."""
    max_frame_bytes: int = 60_000
    queue_bytes: int = 1 << 20
    """What may wait to be sent; a frame beyond is dropped, and counted."""
    inbox_bytes: int = 64 << 20
    """What may wait to be received of a topic that is listened to, a frame counted as the batch that it came in; the
    oldest are dropped."""
    buffer_bytes: int = 65_536
    """Of a socket. What lies there can't be overtaken: take a second's worth on a thin link."""
    hung_s: float = 10.0
    """Others give a connection to this node up when nothing came of it for so long, not even a sign of life. How long
    this node waits for them is theirs to say: set it at both ends."""

    def __post_init__(self) -> None:
        for name in ("listen", "connect"):
            given = getattr(self, name)
            object.__setattr__(self, name, (given,) if isinstance(given, str) else tuple(given))
        for name in ("max_frame_bytes", "queue_bytes", "inbox_bytes", "buffer_bytes", "hung_s"):
            if not getattr(self, name) > 0:
                raise InputError(f"{name} = {getattr(self, name)}: give a positive number")


class Address(NamedTuple):
    """Where somebody listens."""

    protocol: str
    host: str
    """Without the brackets of IPv6."""
    port: int

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.protocol}/{host}:{self.port}"


def address(text: str, protocol: str) -> Address:
    """Parse an address; `protocol` is what it must be, and is where it names none. Raises InputError."""
    match = _ADDRESS.fullmatch(text)
    if match is None or not 0 <= int(match["port"] or PORT) <= 65_535:
        raise InputError(f"address '{text}': {_GIVE}")
    given = match["protocol"] or protocol
    if given not in ("tcp", "tls"):
        raise InputError(f"address '{text}': there is no '{given}' here; {_GIVE}")
    if given != protocol:
        raise InputError(f"address '{text}': {_MISMATCH[given]}")
    return Address(given, match["host"].strip("[]"), int(match["port"] or PORT))


_MISMATCH = {
    "tcp": "tcp is not encrypted, and there are keys; make it tls/…, or leave the keys out and say --insecure",
    "tls": "tls needs keys, and --insecure does without; give --keys FOLDER, or make it tcp/…",
}


def addresses(transport: Transport) -> tuple[list[Address], list[Address]]:
    """(listen, connect). Raises InputError for settings that contradict each other, or would go without protection."""
    if not (transport.listen or transport.connect):
        raise InputError("a node that neither listens nor connects reaches nobody: give an address for one of both")
    if transport.insecure and transport.keys is not None:
        raise InputError(f"keys {transport.keys} and --insecure: keep one; with keys all is encrypted")
    if not transport.insecure and transport.keys is None:
        raise InputError(
            "no keys: give --keys FOLDER, of `terrafuse keys add NAME`; or --insecure, where everybody on the "
            "network is trusted"
        )
    protocol = "tcp" if transport.insecure else "tls"
    return [address(text, protocol) for text in transport.listen], [
        address(text, protocol) for text in transport.connect
    ]


def zenoh_settings(
    transport: Transport, tls: dict[str, Any] | None = None, access: dict[str, Any] | None = None
) -> dict[str, Any]:
    """Zenoh's settings by their path. `tls` and `access`: its sections on certificates and on who may do what."""
    listen, connect = addresses(transport)
    batch_bytes = min(LARGEST_BATCH, max(2048, transport.buffer_bytes))
    buffers = {"so_sndbuf": transport.buffer_bytes, "so_rcvbuf": transport.buffer_bytes}
    settings: dict[str, Any] = {
        "mode": "router" if listen else "client",
        "listen/endpoints": [str(each) for each in listen],
        "listen/timeout_ms": 0,
        "listen/exit_on_failure": True,
        "connect/endpoints": [str(each) for each in connect],
        # A client's first attempt is made by us, again and again: we can say what is wrong. Later ones are Zenoh's.
        "connect/timeout_ms": -1 if listen else 0,
        "connect/exit_on_failure": not listen,
        "connect/retry": {"period_init_ms": 200, "period_max_ms": 2000, "period_increase_factor": 1.5},
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": False,
        "transport/unicast/max_sessions": MOST_SESSIONS,
        "transport/unicast/accept_pending": 1000,
        "transport/link/tx/lease": round(transport.hung_s * 1000),
        "transport/link/tx/batch_size": batch_bytes,
        "transport/link/tx/queue/congestion_control/drop": _patience(bool(listen)),
        "transport/link/rx/max_message_size": max(2 * transport.max_frame_bytes, 1 << 20),
        "transport/link/tcp": buffers,
    }
    if tls is not None:
        settings["transport/link/tls"] = tls | buffers
    if access is not None:
        settings["access_control"] = access
    return settings


def _patience(router: bool) -> dict[str, int]:
    """Microseconds. A client waits in a thread of its own; while a router waits for one client, all others do."""
    wait_us = 20_000 if router else 1_000_000
    return {"wait_before_drop": wait_us, "max_wait_before_drop_fragments": 4 * wait_us}
