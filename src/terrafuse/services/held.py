"""A robot's contribution as a store holds it: what its node tells is what is on disk, and never what a crash takes
back."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from contextlib import AbstractContextManager, nullcontext

from terrafuse.exchange.delta import Delta
from terrafuse.exchange.parts import delta_since
from terrafuse.store.base import Store


class Held:
    """A `Source` for a courier.

    A delta is put together tile by tile. Where another thread writes to the store, `unchanged` keeps it from that
    meanwhile: a delta must not go by a newer revision than tiles that were read before.
    """

    def __init__(
        self, store: Store, robot: str, unchanged: Callable[[], AbstractContextManager[None]] = nullcontext
    ) -> None:
        self.robot = robot
        self._store, self._unchanged = store, unchanged
        self._version: Hashable = None
        self._revision = 0

    @property
    def revision(self) -> int:
        version = self._store.version()
        if version != self._version:
            self._revision, self._version = self._store.revision(self.robot), version
        return self._revision

    def delta(self, since: int) -> Delta:
        with self._unchanged():
            return delta_since(self._store, self.robot, since)
