"""A token bucket: so many bytes a second may leave, and little more at once."""

from __future__ import annotations

from collections import deque
from math import isinf

BURST_S = 0.05
"""Of what was not used, so much is saved up."""
LONGEST_S = 0.5
"""A node that slept for longer does not make up for it."""
WINDOW_S, WINDOW_SHARE = 2.0, 1.02
"""In any so many seconds no more than this share leaves, and a frame: who slept makes up for it only in what is left of
them, or both halves of a nap would count twice."""
FRAME_S = 0.05
"""A frame takes no more of the budget than this, so that what is urgent waits no longer."""
LEAST_FRAME = 256


class Budget:
    def __init__(self, bytes_per_s: float, overhead_bytes: int) -> None:
        self._bytes_per_s = bytes_per_s
        self._overhead_bytes = overhead_bytes
        self._allowed = 0.0
        self._now_ns: int | None = None
        self._lately: deque[tuple[int, int]] = deque()
        """When how much was paid within the window."""
        self._lately_bytes = 0

    def frame_bytes(self, most: int, carrier_bytes: int = 0) -> int:
        """How long frames should be that a link takes of up to `most` bytes, and adds so many to."""
        if isinf(self._bytes_per_s):
            return most
        return min(most, max(LEAST_FRAME, round(FRAME_S * self._bytes_per_s) - self._overhead_bytes - carrier_bytes))

    def earn(self, now_ns: int) -> None:
        """Time went by."""
        if isinf(self._bytes_per_s):
            self._allowed = self._bytes_per_s
            return
        since_s = BURST_S if self._now_ns is None else min((now_ns - self._now_ns) / 1e9, LONGEST_S)
        earned = self._bytes_per_s * since_s
        self._allowed = min(self._allowed + earned, max(self._bytes_per_s * BURST_S, earned))
        self._now_ns = now_ns
        while self._lately and self._lately[0][0] <= now_ns - WINDOW_S * 1e9:
            self._lately_bytes -= self._lately.popleft()[1]

    @property
    def left(self) -> bool:
        """Whether a frame may leave: as soon as anything is allowed. Its size is paid for afterwards."""
        return self._allowed > 0 and self._lately_bytes <= WINDOW_SHARE * WINDOW_S * self._bytes_per_s

    def pay(self, payload_bytes: int, carrier_bytes: int = 0) -> int:
        """A frame leaves; the bytes that it costs."""
        cost = payload_bytes + self._overhead_bytes + carrier_bytes
        self._allowed -= cost
        if self._now_ns is not None:
            self._lately.append((self._now_ns, cost))
            self._lately_bytes += cost
        return cost
