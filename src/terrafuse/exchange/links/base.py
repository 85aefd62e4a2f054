"""The contract of a link: a node's one way to the others, whatever carries it (memory, Zenoh, the simulator's radio).

A link moves *frames*: a topic and some bytes, at most `max_frame_bytes` of them. It promises little, so that every
carrier can keep it, and the exchange relies on nothing more:

* A frame arrives whole or not at all, at every node that listens to its topic, and never at the one that sent it. It
  may be lost, come twice, late, after younger ones, or with other bytes than were sent. Who needs more, asks again.
* Nothing arrives that nobody sent, and nothing before it was sent.
* Sending and receiving return at once. Nothing is confirmed and nothing fails later: a frame that can't be carried now
  is as good as lost. How much is worth sending is decided above the link, where a changed cell can wait as one cell.
* Time is passed in: `now_ns` is of a clock that never runs backwards and that all links of one carrier share. A carrier
  with a clock of its own ignores it. Nothing else reads a clock, so a simulated run is the same every time.
* Frames wait at the receiver until they are asked for. One thread at a time may use a link.

A topic is what a message is about, then whom it is from or for, parts divided by slashes:

| topic | payload | who listens |
|---|---|---|
| `delta/CHANNEL/ROBOT/NODE` | cells that this robot reports, sent by that node, be it another | every replica |
| `summary/NODE` | which revisions this node holds | whoever can help it |
| `tiles/CHANNEL/ROBOT/NODE` | digests of this robot's tiles, as this node holds them | whoever holds others |
| `post/NODE/SENDER` | the newest message of its kind to this node | that node |

A carrier whose frames cost more than their payload says so: `overhead_bytes(topic, payload_bytes)`, all told, for who
keeps to a budget. One without that method costs nothing more.

Who sent a frame stands in its topic or payload. A carrier that knows credentials binds them to topics: it refuses what
a node may not send there. Which frame is worth more is not the link's affair: what comes first is sent first.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import NamedTuple, Protocol

from terrafuse.errors import InputError

MAX_TOPIC = 500
PART = re.compile(r"[^/*$#?+\x00-\x1f\x7f]+")
"""Of a topic: without what Zenoh or MQTT take for a wildcard."""


ANY = "*"


class Frame(NamedTuple):
    """What a link carries."""

    topic: str
    payload: bytes


class Link(Protocol):
    """A node's end. See the module's text for what every link promises, and for what it does not."""

    @property
    def node(self) -> str:
        """The name of the node whose end this is."""

    @property
    def max_frame_bytes(self) -> int:
        """The most bytes of payload that a frame takes."""

    def listen(self, topic: str) -> None:
        """From now on, receive frames of this topic and of all topics below it: `delta` takes `delta/r1`, too.

        A part `*` stands for any one part: `delta/*/r1` takes `delta/fine/r1` and what is below. Nothing else crosses
        to this node, where the carrier can help it.

        Listening twice, or to a topic and to one above it, changes nothing: a frame is received once.
        """

    def send(self, topic: str, payload: bytes, now_ns: int) -> None:
        """Send a frame. Raises InputError for a bad topic, too many bytes, or a closed link."""

    def receive(self, now_ns: int) -> list[Frame]:
        """The frames that arrived up to now, in the order of their arrival; each is handed out once.

        Must be called now and then, by nodes that only send, too: some links do their work in it.
        """

    def close(self) -> None:
        """Leave. Frames that have not arrived are lost. Closing twice is harmless; a closed link receives nothing."""


def overhead_of(link: Link) -> Callable[[str, int], int]:
    """What a frame of this topic and of so many bytes of payload costs beyond that, by what the link says."""
    said: Callable[[str, int], int] = getattr(link, "overhead_bytes", _nothing)
    return said


def _nothing(topic: str, payload_bytes: int) -> int:
    return 0


def check_topic(topic: str) -> None:
    """Raise InputError unless every carrier can tell this topic from all others."""
    if len(topic) > MAX_TOPIC or not all(PART.fullmatch(part) for part in topic.split("/")):
        raise InputError(
            f"topic {topic!r}: give parts divided by single slashes, without any of * $ # ? +, "
            f"{MAX_TOPIC} characters at most"
        )


def check_heard(topic: str) -> None:
    """The same of one that is listened to, whose parts may be `*`."""
    check_topic("/".join("any" if part == ANY else part for part in topic.split("/")))


def check_frame(link: Link, topic: str, payload: bytes) -> None:
    """Raise InputError for what this link can't carry."""
    check_topic(topic)
    if len(payload) > link.max_frame_bytes:
        raise InputError(
            f"a frame of {len(payload)} bytes on '{topic}': the link of '{link.node}' takes {link.max_frame_bytes}; "
            "split what it holds"
        )


def closed(link: Link, topic: str) -> InputError:
    return InputError(f"the link of '{link.node}' is closed; make a new one to send on '{topic}'")


def covers(topic: str, other: str) -> bool:
    """Whether who listens to `topic` receives `other`, or all that who listens to that does."""
    if ANY not in topic:
        return other == topic or other.startswith(topic + "/")
    ours, theirs = topic.split("/"), other.split("/")
    return len(ours) <= len(theirs) and all(part in (ANY, theirs[k]) for k, part in enumerate(ours))
