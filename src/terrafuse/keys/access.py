"""Who may send what: Zenoh's access rules, by the names in certificates.

What is not allowed is dropped by the node that it arrives at first. A topic's last part says who sends it; of a delta,
the part before it says whose report it is.

| topic | by N | if N relays for R | if N is a station |
|---|---|---|---|
| `delta/…/N/N` | yes | yes | yes |
| `delta/…/R/N` | no | yes | yes |
| `summary/N`, `tiles/…/N`, `post/PEER/N`, `pose/N`, `health/N`, `service/…/N` | yes | yes | yes |
| `…/N`, `global/…`, `correction/…` | no | no | yes |

All members may listen to all. Who is no member, or was revoked, may do nothing.
"""

from __future__ import annotations

from typing import Any

from terrafuse.keys.fleet import Member, Roster

ROOT, SIGNS, NAMES = "terrafuse", "terrafuse-nodes", "terrafuse-names"
"""As in exchange.links: topics; who is there; who answers to a name."""
OWN_KINDS = ("summary", "tiles", "post", "pose", "health", "service")
_EVERYTHING = [f"{ROOT}/**", f"{SIGNS}/**", f"{NAMES}/**"]
_HEARING = ["declare_subscriber", "liveliness_query", "declare_liveliness_subscriber", "query"]
_TELLING = ["put", "delete", "declare_queryable", "reply", "liveliness_token"]


def access_control(roster: Roster) -> dict[str, Any]:
    """Zenoh's section `access_control`."""
    members = [member for member in roster.members if not member.revoked]
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [_hear(), _be_told(), *map(_say, members)],
        "subjects": [{"id": member.name, "cert_common_names": [member.name]} for member in members],
        "policies": [
            {"rules": ["hear", "be told", f"say {member.name}"], "subjects": [member.name]} for member in members
        ],
    }


def keys_of(member: Member) -> list[str]:
    """What this member may send."""
    name = member.name
    own = [f"{ROOT}/{kind}/**/{name}" for kind in OWN_KINDS]
    relayed = [f"{ROOT}/delta/**/{robot}/{name}" for robot in (name, *member.relay_for)]
    stations = [f"{ROOT}/**/{name}", f"{ROOT}/global/**", f"{ROOT}/correction/**"] if member.station else []
    return [*own, *relayed, *stations, f"{SIGNS}/*/{name}/*", f"{NAMES}/{name}"]


def _hear() -> dict[str, Any]:
    return {
        "id": "hear",
        "permission": "allow",
        "flows": ["ingress", "egress"],
        "messages": _HEARING,
        "key_exprs": _EVERYTHING,
    }


def _be_told() -> dict[str, Any]:
    return {
        "id": "be told",
        "permission": "allow",
        "flows": ["egress"],
        "messages": _TELLING,
        "key_exprs": _EVERYTHING,
    }


def _say(member: Member) -> dict[str, Any]:
    return {
        "id": f"say {member.name}",
        "permission": "allow",
        "flows": ["ingress"],
        "messages": _TELLING,
        "key_exprs": keys_of(member),
    }
