"""Keeps services alive: starts them, gives them their ticks and messages, and starts again what raised.

supervisor = Supervisor([Spec("mapping", make_mapping, thread="mapping"), Spec("exchange", make_exchange)])
supervisor.start()
...
supervisor.stop(1.5)
"""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

from terrafuse.errors import InputError, TerrafuseError, shown
from terrafuse.services.service import (
    DONE,
    FAILED,
    IDLE_S,
    RUNNING,
    SECOND_NS,
    STARTING,
    STOPPED,
    WAITING,
    Contract,
    Message,
    Service,
    Status,
)

LONGEST_WAIT_S = 0.1
"""That a thread sleeps: how late a message may be looked at."""
SHOWN_EVERY_NS = SECOND_NS // 4
"""How old a status may be, unless it takes over a"""
SHOWN_SHARE = 50
"""50th of the time to make."""
MOST_WAITING = 1024
"""Messages in a mailbox: beyond, the oldest go."""


@dataclass(frozen=True)
class Restarts:
    """When a service that raised is started again."""

    first_s: float = 0.2
    """After one failure; each further one in a row doubles it,"""
    longest_s: float = 10.0
    """up to this."""
    steady_s: float = 30.0
    """A service that has run so long starts to count anew."""
    most: int | None = 8
    """Failures in a row after which it is given up; None: never."""

    def delay_s(self, failures: int) -> float:
        return float(min(self.first_s * 2.0 ** min(failures - 1, 30), self.longest_s))


@dataclass(frozen=True)
class Spec:
    """How a service is made, and which thread owns it."""

    name: str
    make: Callable[[], Service]
    thread: str = "network"
    restarts: Restarts = field(default_factory=Restarts)


class Supervised:
    """One service's life, step by step; for the thread that owns it, but for `send`, `restart` and `status`."""

    def __init__(self, spec: Spec) -> None:
        self.spec = spec
        self.fault: TerrafuseError | None = None
        """Why it was given up."""
        self._service: Service | None = None
        self._health, self._since_ns, self._due_ns = STARTING, 0, 0
        self._failures = self._restarts = 0
        self._reason = ""
        self._counts: Counter[str] = Counter()
        self._mailbox: deque[Message] = deque(maxlen=MOST_WAITING)
        self._again = False
        self._show_ns = 0
        self.status = Status(spec.name, "", STARTING, 0)

    def send(self, message: Message) -> None:
        """Leave a message for it; from any thread."""
        self._mailbox.append(message)

    def restart(self) -> None:
        """Have it started afresh; from any thread."""
        self._again = True

    def step(self, now_ns: int) -> int:
        """Do what is due; returns when the next step is."""
        if now_ns < self._due_ns and not self._mailbox and not self._again:
            return self._due_ns
        if self._health == FAILED or (self._health == WAITING and now_ns < self._due_ns):
            return max(self._due_ns, now_ns + round(IDLE_S * SECOND_NS))
        try:
            self._due_ns = now_ns + round(self._work(now_ns) * SECOND_NS)
        except Exception as error:
            self._fail(error, now_ns)
        self._show(now_ns)
        return self._due_ns

    def stop(self, now_ns: int) -> None:
        """Let it leave and close it."""
        if self._service is not None:
            try:
                self._service.leave()
            except Exception as error:
                self._blame(error)
            self._close()
        if self._health not in (FAILED, DONE):
            self._turn(STOPPED, now_ns)
        self._show(now_ns)

    def _work(self, now_ns: int) -> float:
        if self._again:
            self._again = False
            self._counts["restarts.asked"] += 1
            self._reason = "asked to"
            self._restarts += 1
            if self._service is not None:
                self._service.leave()
            self._close()
        if self._service is None:
            self._service = self.spec.make()
            self._turn(RUNNING, now_ns)
        self._deliver(self._service)
        if self._failures and now_ns - self._since_ns >= self.spec.restarts.steady_s * SECOND_NS:
            self._failures = 0
        wait_s = IDLE_S if self._service.done else self._service.tick(now_ns)
        if self._service.done != (self._health == DONE):
            self._turn(DONE if self._service.done else RUNNING, now_ns)
        return wait_s

    def _deliver(self, service: Service) -> None:
        for _ in range(len(self._mailbox)):
            message = self._mailbox.popleft()
            if message.contract != service.contract.id:
                self._counts["refused.contract"] += 1
            elif message.kind not in (service.contract.remote if message.sender else service.contract.takes):
                self._counts["refused.kind"] += 1
            else:
                self._counts[f"taken.{message.kind}"] += 1
                self._post(service, message)

    def _post(self, service: Service, message: Message) -> None:
        """What another node says may be anything: one message of it never has a service started again."""
        try:
            service.post(message)
        except TerrafuseError:
            raise
        except Exception as error:
            if not message.sender:
                raise
            self._counts[f"refused.{type(error).__name__}"] += 1

    def _fail(self, error: Exception, now_ns: int) -> None:
        self._failures += 1
        self._counts[f"raised.{type(error).__name__}"] += 1
        self._reason = f"{type(error).__name__}: {shown(str(error))}"
        self._close()
        most = self.spec.restarts.most
        if isinstance(error, InputError) or (most is not None and self._failures >= most):
            self._blame(error)
            self._turn(FAILED, now_ns)
            return
        self._restarts += 1
        self._due_ns = now_ns + round(self.spec.restarts.delay_s(self._failures) * SECOND_NS)
        self._turn(WAITING, now_ns)

    def _blame(self, error: Exception) -> None:
        if isinstance(error, TerrafuseError):
            self.fault = self.fault or error
        else:
            again = TerrafuseError(f"the service '{self.spec.name}' failed: {type(error).__name__}: {error}")
            again.__cause__ = error
            self.fault = self.fault or again

    def _close(self) -> None:
        """Whatever happens in it: what is thrown away can't fail any more, and its successor must get its turn."""
        service, self._service = self._service, None
        if service is not None:
            self._counts.update(service.counts)
            try:
                service.close()
            except Exception as error:
                self._counts[f"raised.{type(error).__name__}"] += 1

    def _turn(self, health: str, now_ns: int) -> None:
        self._health, self._since_ns, self._show_ns = health, now_ns, 0

    def _show(self, now_ns: int) -> None:
        if now_ns < self._show_ns:
            return
        started_ns = time.perf_counter_ns()
        service = self._service
        contract = service.contract.id if service else self.status.contract
        partners = tuple(service.partners) if service else self.status.partners
        counts = self._counts + service.counts if service else self._counts
        self.status = Status(
            self.spec.name, contract, self._health, self._since_ns, partners, self._restarts, self._reason,
            dict(sorted(counts.items())), service.state() if service else self.status.state,
        )  # fmt: skip
        cost_ns = time.perf_counter_ns() - started_ns
        self._show_ns = now_ns + max(SHOWN_EVERY_NS, SHOWN_SHARE * cost_ns)


class Supervisor:
    """Runs services on a thread for each name of thread in their specs."""

    def __init__(self, specs: Iterable[Spec], clock: Callable[[], int] | None = None) -> None:
        self._services = {spec.name: Supervised(spec) for spec in specs}
        self._clock = clock or Clock()
        self._stop = threading.Event()
        self._threads: list[threading.Thread] = []

    @property
    def names(self) -> list[str]:
        return list(self._services)

    @property
    def statuses(self) -> list[Status]:
        return [service.status for service in self._services.values()]

    @property
    def fault(self) -> TerrafuseError | None:
        """Of the first service that was given up."""
        return next((service.fault for service in self._services.values() if service.fault), None)

    def send(self, service: str, message: Message) -> bool:
        """Leave a message for a service; False if there is none of this name. From any thread."""
        if service not in self._services:
            return False
        self._services[service].send(message)
        return True

    def restart(self, service: str) -> bool:
        """Have a service started afresh; False if there is none of this name. From any thread."""
        if service not in self._services:
            return False
        self._services[service].restart()
        return True

    def start(self, prefix: str = "") -> None:
        groups: dict[str, list[Supervised]] = {}
        for service in self._services.values():
            groups.setdefault(service.spec.thread, []).append(service)
        self._threads = [
            # Daemons: one that hangs in a driver must not keep the process alive that wants to leave.
            threading.Thread(target=self._run, args=(group,), name=f"{prefix}{name}", daemon=True)
            for name, group in groups.items()
        ]
        for thread in self._threads:
            thread.start()

    def ask_to_stop(self) -> None:
        """Have all services leave, and do not wait for it."""
        self._stop.set()

    def stop(self, patience_s: float) -> bool:
        """Have all services leave; whether they did in time."""
        self.ask_to_stop()
        deadline = time.monotonic() + patience_s
        for thread in self._threads:
            thread.join(max(deadline - time.monotonic(), 0.0))
        return not any(thread.is_alive() for thread in self._threads)

    def _run(self, group: Sequence[Supervised]) -> None:
        while not self._stop.is_set():
            due_ns = min(service.step(self._clock()) for service in group)
            wait_s = min((due_ns - self._clock()) / SECOND_NS, LONGEST_WAIT_S)
            if wait_s > 0:
                self._stop.wait(wait_s)
        for service in group:
            service.stop(self._clock())


class Clock:
    """The clock on the wall, in ns, but never backwards: lives of nodes are told apart by when they began."""

    def __init__(self) -> None:
        self._last_ns = 0

    def __call__(self) -> int:
        self._last_ns = max(self._last_ns, time.time_ns())
        return self._last_ns


class Orchestration(Service):
    """The supervisor as a service among its own: which services there are, how they fare, and starting one afresh."""

    partners: tuple[str, ...] = ()

    def __init__(self, contract: str, supervisor: Callable[[], Supervisor]) -> None:
        super().__init__()
        self.contract = Contract(contract, 1, frozenset({"restart"}))
        self._supervisor = supervisor

    def post(self, message: Message) -> None:
        """`restart`: the name of a service."""
        if not self._supervisor().restart(message.payload.decode(errors="replace")):
            self.counts["refused.unknown"] += 1

    def state(self) -> dict[str, object]:
        statuses = self._supervisor().statuses
        self.partners = tuple(status.name for status in statuses)
        return {
            "health": {status.name: status.health for status in statuses},
            "restarts": sum(status.restarts for status in statuses),
        }
