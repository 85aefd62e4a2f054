"""Running nodes: what ends a run, and how soon all leave."""

from __future__ import annotations

import threading
import time

import pytest

from terrafuse.errors import InputError
from terrafuse.services.node import Node
from terrafuse.services.run import Hung, run
from terrafuse.services.service import Service
from terrafuse.services.supervise import Spec, Supervisor


class Ends(Service):
    def tick(self, now_ns: int) -> float:
        self.done = True
        return 0.0


class Broken(Service):
    def tick(self, now_ns: int) -> float:
        raise InputError("no such log")


def node(name: str, kind: type[Service], ends: bool = True) -> Node:
    return Node(name, Supervisor([Spec("only", kind)]), "only" if ends else None)


def test_it_ends_when_all_that_end_have_ended() -> None:
    assert run([node("r1", Ends), node("station", Service, ends=False)], threading.Event())


def test_it_ends_when_it_is_stopped() -> None:
    stop = threading.Event()
    threading.Timer(0.2, stop.set).start()
    assert not run([node("r1", Service)], stop)


def test_a_fault_of_one_ends_all() -> None:
    closed: list[str] = []
    other = node("r2", Service)
    other.files.callback(closed.append, "r2")
    with pytest.raises(InputError, match="no such log"):
        run([node("r1", Broken), other], threading.Event())
    assert closed == ["r2"]


def test_what_hangs_is_left_behind_and_said() -> None:
    gate = threading.Event()

    class Hangs(Service):
        def tick(self, now_ns: int) -> float:
            gate.wait(20)
            return 0.0

    stop = threading.Event()
    closed: list[str] = []
    nodes = [node("r1", Hangs), node("r2", Service)]
    for one in nodes:
        one.files.callback(closed.append, one.name)
    threading.Timer(0.2, stop.set).start()
    started = time.monotonic()
    with pytest.raises(Hung):
        run(nodes, stop)
    assert time.monotonic() - started < 2.0
    assert closed == ["r2"]  # not what is still in use
    gate.set()
