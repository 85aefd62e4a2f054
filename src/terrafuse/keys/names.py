"""Names of nodes and hosts that certificates are made for."""

from __future__ import annotations

import ipaddress
import re

from terrafuse.errors import InputError

_NODE = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,62}")
_HOST = re.compile(
    r"(?=.{1,253}$)[A-Za-z0-9]([A-Za-z0-9-]{0,61}[A-Za-z0-9])?(\.[A-Za-z0-9]([A-Za-z0-9-]{0,61}[A-Za-z0-9])?)*"
)

Host = ipaddress.IPv4Address | ipaddress.IPv6Address | str


LOCAL = ("localhost", "127.0.0.1", "::1")
"""Where everybody reaches a node on the same machine."""


def node_name(text: str) -> str:
    """The name, if it can be a topic's part, a folder's name and a certificate's, on all systems."""
    if not _NODE.fullmatch(text) or text.endswith("."):
        raise InputError(
            f"node '{text}': a name has 1 to 63 of A-Z a-z 0-9 _ . -, a letter or digit first and no dot at the end"
        )
    return text


def host(text: str) -> Host:
    """An IP address, or the name of a host."""
    try:
        return ipaddress.ip_address(text.strip("[]"))
    except ValueError:
        if not _HOST.fullmatch(text):
            raise InputError(f"host '{text}': give an IP address or a host's name, without port") from None
        return text
