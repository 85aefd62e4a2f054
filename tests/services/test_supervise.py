"""Supervision: what raises is started again, later and later; what can't be helped ends; messages arrive."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from terrafuse.errors import InputError, TerrafuseError
from terrafuse.services.service import Contract, Message, Service
from terrafuse.services.supervise import Orchestration, Restarts, Spec, Supervised, Supervisor

SECOND = 1_000_000_000
STEP = SECOND // 10


class Scripted(Service):
    """Does what its script says, one word a tick: `work`, or what to raise. Lives share the script."""

    contract = Contract("test/scripted", 2, takes=frozenset({"add"}), remote=frozenset({"hello"}))

    def __init__(self, script: list[str], log: list[str]) -> None:
        super().__init__()
        self._script, self._log = script, log
        self._log.append("made")

    def tick(self, now_ns: int) -> float:
        word = self._script.pop(0) if self._script else "work"
        self._log.append(word)
        if word == "input":
            raise InputError("no such log")
        if word == "end":
            self.done = True
        elif word != "work":
            raise RuntimeError(word)
        self.counts["ticks"] += 1
        return 0.1

    def post(self, message: Message) -> None:
        self._log.append(f"{message.kind} {message.payload.decode()} from {message.sender or 'here'}")
        if message.payload == b"poison":
            raise RuntimeError("poison")

    def state(self) -> dict[str, object]:
        return {"left": len(self._script)}

    def leave(self) -> None:
        self._log.append("left")

    def close(self) -> None:
        self._log.append("closed")


def supervised(script: Sequence[str], restarts: Restarts | None = None) -> tuple[Supervised, list[str]]:
    log: list[str] = []
    rest = list(script)
    return Supervised(Spec("one", lambda: Scripted(rest, log), restarts=restarts or Restarts())), log


def go(service: Supervised, from_s: float, to_s: float) -> None:
    for now in range(round(from_s * SECOND), round(to_s * SECOND), STEP):
        service.step(now)


def test_what_raises_is_started_again_after_a_while() -> None:
    service, log = supervised(["work", "oops", "work"])
    go(service, 1, 1.25)  # ticks at 1.0 and 1.1, where it raises; the first delay is 0.2 s
    assert log == ["made", "work", "oops", "closed"]
    assert (service.status.health, service.status.restarts) == ("waiting", 1)
    assert service.status.reason == "RuntimeError: oops"
    go(service, 1.3, 1.35)
    assert log[4:] == ["made", "work"]
    assert service.status.health == "running"
    assert service.status.counts["raised.RuntimeError"] == 1
    assert service.status.counts["ticks"] == 2  # of both lives


def test_what_the_user_must_mend_is_given_up_at_once() -> None:
    service, log = supervised(["work", "input", "work"])
    go(service, 1, 3)
    assert log == ["made", "work", "input", "closed"]
    assert service.status.health == "failed"
    assert isinstance(service.fault, InputError)


def test_what_fails_again_and_again_is_given_up() -> None:
    service, log = supervised(["oops"] * 9, Restarts(most=3))
    go(service, 1, 20)
    assert log.count("made") == 3
    assert service.status.health == "failed"
    assert isinstance(service.fault, TerrafuseError)
    assert "'one' failed: RuntimeError: oops" in str(service.fault)


def test_failing_to_be_made_counts_too() -> None:
    def refuse() -> Service:
        raise OSError("no link")

    service = Supervised(Spec("one", refuse, restarts=Restarts(most=2)))
    go(service, 1, 3)
    assert service.status.health == "failed"
    assert service.status.counts == {"raised.OSError": 2}


def test_delays_double_up_to_the_longest() -> None:
    restarts = Restarts(first_s=0.2, longest_s=1.0)
    assert [restarts.delay_s(n) for n in (1, 2, 3, 4, 100)] == [0.2, 0.4, 0.8, 1.0, 1.0]


def test_a_steady_run_lets_delays_begin_anew() -> None:
    script = ["oops", "oops", *["work"] * 60, "oops"]
    service, log = supervised(script, Restarts(first_s=0.2, steady_s=3.0, most=3))
    # Failures at 1.0 and 1.2, a restart at 1.6, six seconds of work, and one more failure: the first in a row again.
    go(service, 1, 8)
    assert log.count("made") == 4
    assert service.status.health == "running"
    assert service.status.restarts == 3


def test_what_is_done_is_not_ticked_but_takes_messages() -> None:
    service, log = supervised(["end"])
    go(service, 1, 2)
    assert log == ["made", "end"]
    assert service.status.health == "done"
    service.send(Message("test/scripted/2", "add", b"1"))
    go(service, 2, 2.2)
    assert log[2:] == ["add 1 from here"]


def test_messages_of_other_contracts_and_kinds_are_refused_and_counted() -> None:
    service, log = supervised([])
    service.send(Message("test/scripted/1", "add"))  # another version
    service.send(Message("test/scripted/2", "subtract"))
    service.send(Message("test/scripted/2", "add", b"", "r9"))  # from another node: only `hello` may
    service.send(Message("test/scripted/2", "hello", b"x", "r9"))
    go(service, 1, 1.5)
    counts = service.status.counts
    assert (counts["refused.contract"], counts["refused.kind"], counts["taken.hello"]) == (1, 2, 1)
    assert log[1] == "hello x from r9"


def test_a_poisonous_message_is_not_taken_twice() -> None:
    service, log = supervised([])
    service.send(Message("test/scripted/2", "add", b"poison"))
    service.send(Message("test/scripted/2", "add", b"2"))
    go(service, 1, 2)
    assert log.count("add poison from here") == 1
    assert log.count("add 2 from here") == 1
    assert service.status.health == "running"


@given(st.lists(st.sampled_from(["work", "work", "oops", "ouch"]), max_size=40), st.integers(1, 6))
def test_laws_of_supervision(script: list[str], most: int) -> None:
    """Each life is closed once and before the next; restarts = lives − 1 or one is awaited; the back-off is kept."""
    restarts = Restarts(first_s=0.1, longest_s=0.4, steady_s=1e9, most=most)
    service, log = supervised(script, restarts)
    times: list[tuple[int, str]] = []
    for now in range(SECOND, 30 * SECOND, STEP):
        before = len(log)
        service.step(now)
        times += [(now, word) for word in log[before:]]
    lives = [word for word in log if word in ("made", "closed")]
    assert lives == (["made", "closed"] * len(lives))[: len(lives)]
    failures = sum(word in ("oops", "ouch") for word in log)
    if service.status.health == "failed":
        assert failures == most
        assert service.status.restarts == most - 1
    else:
        assert failures < most
        assert service.status.restarts == failures == log.count("made") - 1
    fell = 0
    for (now, word), (later, following) in pairwise(times):
        if word == "closed":
            fell += 1
            assert following == "made"
            assert later - now >= restarts.delay_s(fell) * SECOND - STEP
    assert sum(service.status.counts[key] for key in service.status.counts if key.startswith("raised.")) == failures


def until(condition: object, seconds: float = 5.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():  # type: ignore[operator]
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_services_live_on_threads_of_their_own_and_leave() -> None:
    logs: dict[str, list[str]] = {"a": [], "b": []}
    scripts = {"a": ["oops"], "b": ["oops"]}
    seen: dict[str, set[str]] = {"a": set(), "b": set()}

    class Seen(Scripted):
        def __init__(self, name: str) -> None:
            super().__init__(scripts[name], logs[name])
            self._name = name

        def tick(self, now_ns: int) -> float:
            seen[self._name].add(threading.current_thread().name)
            return super().tick(now_ns)

    supervisor = Supervisor([
        Spec("a", lambda: Seen("a"), thread="left", restarts=Restarts(first_s=0.01)),
        Spec("b", lambda: Seen("b"), thread="right", restarts=Restarts(first_s=0.01)),
        Spec("orchestration", lambda: Orchestration("test/orchestration", lambda: supervisor)),
    ])  # fmt: skip
    supervisor.start("r1 ")
    until(lambda: all(log.count("work") > 2 for log in logs.values()))
    assert supervisor.send("orchestration", Message("test/orchestration/1", "restart", b"a"))
    assert not supervisor.send("nobody", Message("test/orchestration/1", "restart", b"a"))
    until(lambda: logs["a"].count("made") == 3)
    until(lambda: supervisor.statuses[2].state["restarts"] == 3)  # one failure each, and one that was asked for
    assert supervisor.stop(2.0)
    assert seen == {"a": {"r1 left"}, "b": {"r1 right"}}
    assert all(log[-2:] == ["left", "closed"] for log in logs.values())
    assert [status.health for status in supervisor.statuses] == ["stopped"] * 3
    assert supervisor.statuses[2].partners == ("a", "b", "orchestration")


def test_a_hanging_service_does_not_keep_the_others() -> None:
    gate = threading.Event()

    class Hangs(Service):
        def tick(self, now_ns: int) -> float:
            gate.wait(10)
            return 0.0

    log: list[str] = []
    supervisor = Supervisor([Spec("hangs", Hangs, thread="x"), Spec("works", lambda: Scripted([], log))])
    supervisor.start()
    until(lambda: log.count("work") > 1)
    started = time.monotonic()
    assert not supervisor.stop(0.3)
    assert time.monotonic() - started < 2
    assert log[-1] == "closed"
    gate.set()


@pytest.mark.parametrize("fault", [ValueError("disk"), InputError("full")])
def test_failing_to_leave_is_a_fault(fault: Exception) -> None:
    """What could not be put down must not pass for put down."""

    class Stuck(Service):
        def leave(self) -> None:
            raise fault

    service = Supervised(Spec("stuck", Stuck))
    go(service, 1, 1.3)
    service.stop(2 * SECOND)
    assert service.fault is not None
    assert str(fault) in str(service.fault)
