"""Work on a store's tiles that nobody waits for, by a thread of its own that lives as long as there is any."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

Item = TypeVar("Item", bound=Hashable)


class Folding(Generic[Item]):
    """Has `work` done for each item that is `put`, once for those that wait already, in their order.

    What it raises is raised to whoever asks next; then no more is done.
    """

    def __init__(self, work: Callable[[Item], None], name: str) -> None:
        self._work, self._name = work, name
        self._waiting: dict[Item, None] = {}
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._fault: Exception | None = None
        self._closed = False

    def put(self, item: Item) -> None:
        with self._lock:
            self._waiting[item] = None
            if self._thread is None and not self._closed:
                self._thread = threading.Thread(target=self._run, name=self._name, daemon=True)
                self._thread.start()

    def raise_fault(self) -> None:
        if self._fault is not None:
            raise self._fault

    def wait(self) -> None:
        """Until nothing waits."""
        with self._lock:
            thread = self._thread
        if thread is not None:
            thread.join()

    def close(self) -> None:
        """Let it finish what it is at; what waits is left."""
        with self._lock:
            self._closed = True
        self.wait()

    def _run(self) -> None:
        while (item := self._next()) is not None:
            try:
                self._work(item)
            except Exception as error:
                self._fault = error
                with self._lock:
                    self._closed = True

    def _next(self) -> Item | None:
        """None ends the thread: whoever puts something after that starts another."""
        with self._lock:
            if self._closed or not self._waiting:
                self._thread = None
                return None
            item = next(iter(self._waiting))
            del self._waiting[item]
            return item
