"""Topics as Zenoh's keys."""

from __future__ import annotations

ROOT = "terrafuse"
"""Above all topics, where others use the same network."""


def key_of(topic: str) -> str:
    """The same parts. A leading @, which Zenoh's wildcards pass over, is written as %40, and a % as %25."""
    return "/".join(_escaped(part) for part in topic.split("/"))


def topic_of(key: str) -> str:
    return key.replace("%40", "@").replace("%25", "%")


def _escaped(part: str) -> str:
    part = part.replace("%", "%25")
    return "%40" + part[1:] if part.startswith("@") else part
