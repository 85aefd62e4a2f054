"""What a service is, after the *patrol* paper: contract, state to ask for (get), messages it takes (post), partners.

One rule of ownership: **a service belongs to one thread**, which alone makes, ticks, posts to and closes it. What
others see of it is its `Status`, an immutable copy; what others want of it waits in its mailbox. Threads share nothing
else but ports (`ports.py`) and stores, which are made for that. So services have no locks.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import msgspec

SECOND_NS = 1_000_000_000
IDLE_S = 0.05
"""Until a service looks again that found nothing to do."""


@dataclass(frozen=True)
class Contract:
    """What callers may rely on: who speaks another version is refused, not guessed at."""

    name: str
    version: int
    takes: frozenset[str] = frozenset()
    """Kinds of messages, from services of its own node,"""
    remote: frozenset[str] = frozenset()
    """and from those of other nodes."""

    @property
    def id(self) -> str:
        return f"{self.name}/{self.version}"


class Message(NamedTuple):
    """What is posted to a service."""

    contract: str
    """The id of the contract that the sender goes by."""
    kind: str
    payload: bytes = b""
    sender: str = ""
    """The node that it comes from; none: the service's own."""


class Service:
    """Base of all services: one that does nothing and takes no message.

    Raise InputError where starting again can't help; whatever else is raised makes the supervisor start it afresh.
    """

    contract = Contract("nothing", 1)
    partners: Sequence[str] = ()
    """Services that it works with: names in its own node, or NODE/NAME."""
    done = False
    """It has nothing left to do, ever."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()

    def tick(self, now_ns: int) -> float:
        """Do a small piece of work; returns after how many seconds it wants the next tick."""
        return IDLE_S

    def state(self) -> dict[str, Any]:
        """Plain values that JSON can hold."""
        return {}

    def post(self, message: Message) -> None:
        """Take a message of one of the contract's kinds."""

    def leave(self) -> None:
        """Before `close`, where nothing has failed: put down what must not be lost."""

    def close(self) -> None:
        """Let go of what it holds. Called once, after a failure too."""


STARTING, RUNNING, WAITING, DONE, FAILED, STOPPED = "starting", "running", "waiting", "done", "failed", "stopped"
"""A service's health: not made yet; at work; raised and not started again yet; without work left; given up; left."""


class Status(msgspec.Struct, frozen=True):
    """What a service shows: to its node, and with the node's report to the fleet."""

    name: str
    contract: str
    health: str
    since_ns: int
    """When it came to that health."""
    partners: tuple[str, ...] = ()
    restarts: int = 0
    reason: str = ""
    """Why it was last started again, or given up."""
    counts: dict[str, int] = {}
    state: dict[str, Any] = {}
