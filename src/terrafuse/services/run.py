"""Runs nodes in this process until their work is done, something can't go on, or somebody stops them."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from terrafuse.services.node import Node

LOOK_S = 0.1
PATIENCE_S = 1.5
"""For services to leave: with what a process needs to end, that makes less than two seconds."""

Watch = Callable[[Sequence[Node]], None]


class Hung(Exception):  # noqa: N818, no fault of what it is told to
    """A thread is still at work (compiling, or in a driver). What it had not committed is as good as never done, so the
    process may end at once."""


def run(nodes: Sequence[Node], stop: threading.Event, watch: Watch = lambda nodes: None) -> bool:
    """Run until `stop`, or until all nodes whose work has an end are done; returns whether they are.

    Raises what a service was given up for; Hung, when all that could be closed is, if one does not leave in time.
    """
    for node in nodes:
        node.supervisor.start(f"{node.name} ")
    try:
        ending = [node for node in nodes if node.ends_with is not None]
        while not stop.is_set() and not _fault(nodes) and not (ending and all(node.done for node in ending)):
            stop.wait(LOOK_S)
            watch(nodes)
        done = bool(ending) and all(node.done for node in ending)
    finally:
        left = _leave(nodes)
    if fault := _fault(nodes):
        raise fault
    if not left:
        raise Hung
    return done


def _leave(nodes: Sequence[Node]) -> bool:
    """Whether all services left in time."""
    deadline = time.monotonic() + PATIENCE_S
    for node in nodes:
        node.supervisor.ask_to_stop()
    left = [node.supervisor.stop(deadline - time.monotonic()) for node in nodes]
    for node, gone in zip(nodes, left, strict=True):
        if gone:
            node.close()
    return all(left)


def _fault(nodes: Sequence[Node]) -> Any:
    return next((node.supervisor.fault for node in nodes if node.supervisor.fault), None)


@contextmanager
def stopped_by_signals() -> Iterator[threading.Event]:
    """An event that Ctrl-C and SIGTERM set while the block runs."""
    stop = threading.Event()
    before = {number: signal.signal(number, lambda *_: stop.set()) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
