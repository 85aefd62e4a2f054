"""A token bucket: so many bytes a second may leave, and little more at once."""

from __future__ import annotations

from math import isinf

BURST_S = 0.05
"""Of what was not used, so much is saved up."""
LONGEST_S = 0.5
"""A node that slept for longer does not make up for it."""
FRAME_S = 0.05
"""A frame takes no more of the budget than this, so that what is urgent waits no longer."""
LEAST_FRAME = 256


class Budget:
    def __init__(self, bytes_per_s: float, overhead_bytes: int) -> None:
        self._bytes_per_s = bytes_per_s
        self._overhead_bytes = overhead_bytes
        self._allowed = 0.0
        self._now_ns: int | None = None

    def frame_bytes(self, most: int) -> int:
        """How long frames should be that a link takes of up to `most` bytes."""
        if isinf(self._bytes_per_s):
            return most
        return min(most, max(LEAST_FRAME, round(FRAME_S * self._bytes_per_s) - self._overhead_bytes))

    def earn(self, now_ns: int) -> None:
        """Time went by."""
        if isinf(self._bytes_per_s):
            self._allowed = self._bytes_per_s
            return
        since_s = BURST_S if self._now_ns is None else min((now_ns - self._now_ns) / 1e9, LONGEST_S)
        earned = self._bytes_per_s * since_s
        self._allowed = min(self._allowed + earned, max(self._bytes_per_s * BURST_S, earned))
        self._now_ns = now_ns

    @property
    def left(self) -> bool:
        """Whether a frame may leave: as soon as anything is allowed. Its size is paid for afterwards."""
        return self._allowed > 0

    def pay(self, payload_bytes: int) -> int:
        """A frame leaves; the bytes that it costs."""
        cost = payload_bytes + self._overhead_bytes
        self._allowed -= cost
        return cost
