"""Frames that wait for the thread that sends them."""

from __future__ import annotations

import threading
from collections import deque

from terrafuse.exchange.links.base import Frame


class SendQueue:
    """First in, first out, with room for so many bytes; of two threads, one adds and one takes."""

    def __init__(self, most_bytes: int) -> None:
        self._most_bytes = most_bytes
        self._waiting: deque[Frame] = deque()
        self._bytes = 0
        self._woken = False
        self._changed = threading.Condition()

    def add(self, frame: Frame) -> bool:
        """Whether there was room. There always is for one frame."""
        with self._changed:
            if self._waiting and self._bytes + len(frame.payload) > self._most_bytes:
                return False
            self._waiting.append(frame)
            self._bytes += len(frame.payload)
            self._changed.notify()
            return True

    def take(self, wait_s: float) -> Frame | None:
        """The oldest; None if there is none within `wait_s`, or before somebody wakes who waits."""
        with self._changed:
            if not self._waiting and not self._woken:
                self._changed.wait(wait_s)
            self._woken = False
            if not self._waiting:
                return None
            frame = self._waiting.popleft()
            self._bytes -= len(frame.payload)
            return frame

    def wake(self) -> None:
        """Let who waits look after something else."""
        with self._changed:
            self._woken = True
            self._changed.notify()

    def clear(self) -> int:
        """Drop all, and let who waits go; how many were dropped."""
        with self._changed:
            dropped = len(self._waiting)
            self._waiting.clear()
            self._bytes = 0
            self._changed.notify_all()
            return dropped
