"""What goes wrong on a way from one node to others, drawn from a seed.

Each frame takes the same number of random draws whatever befalls it: with one fault more or less, or another rate, the
others still hit the same frames.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from math import ceil, inf, isfinite

from terrafuse.errors import InputError
from terrafuse.types import Floats

SECOND_NS = 1_000_000_000
FATES = 8
"""Random numbers that decide over a frame."""


@dataclass(frozen=True)
class Cut:
    """From `from_s` on nothing passes, until `to_s`, when it heals."""

    from_s: float
    to_s: float = inf

    def __post_init__(self) -> None:
        if not self.from_s < self.to_s:
            raise InputError(f"a cut from {self.from_s} s to {self.to_s} s: it must end after it begins")

    def at(self, now_ns: int) -> bool:
        return self.from_s * SECOND_NS <= now_ns < self.to_s * SECOND_NS


@dataclass(frozen=True)
class Faults:
    """How a way misbehaves. The default is a perfect one. Chances are 0 to 1, for each frame, independent.

    Frames leave one after the other, as fast as the rate allows; then each is, perhaps, lost, damaged or doubled, and
    takes its time.
    """

    loss: float = 0.0
    duplication: float = 0.0
    """Chance of a second copy, with a delay of its own."""
    corruption: float = 0.0
    """Chance of one flipped bit."""
    reordering: float = 0.0
    """Chance to be held back by `held_s`, so that younger frames overtake."""
    held_s: float = 0.5
    delay_s: float = 0.0
    jitter_s: float = 0.0
    """Up to this much is added to the delay, evenly spread."""
    bytes_per_s: float = inf
    overhead_bytes: int = 0
    """Bytes that a frame takes beside its payload."""
    queue_bytes: float = inf
    """Most bytes that may wait for their turn; a frame that would make it more is lost."""
    cuts: tuple[Cut, ...] = ()
    """What would leave or arrive within one is lost."""

    def __post_init__(self) -> None:
        for name in ("loss", "duplication", "corruption", "reordering"):
            if not 0 <= getattr(self, name) <= 1:
                raise InputError(f"{name} = {getattr(self, name)}: a chance is from 0 to 1")
        for name in ("held_s", "delay_s", "jitter_s", "overhead_bytes"):
            if not 0 <= getattr(self, name) < inf:
                raise InputError(f"{name} = {getattr(self, name)}: give a number from 0 on")
        for name in ("bytes_per_s", "queue_bytes"):
            if not getattr(self, name) > 0:
                raise InputError(f"{name} = {getattr(self, name)}: give a positive number, .inf for no limit")

    def cut(self, now_ns: int) -> bool:
        return any(cut.at(now_ns) for cut in self.cuts)


PERFECT = Faults()


class Queue:
    """A sender that puts frames on the way one after the other. Times are when the last byte of each has left."""

    def __init__(self) -> None:
        self._free_ns = 0

    def leaves_ns(self, payload: bytes, faults: Faults, now_ns: int) -> int | None:
        """When this frame will have left; None if too much waits already."""
        if not isfinite(faults.bytes_per_s):
            self._free_ns = max(self._free_ns, now_ns)
            return self._free_ns
        size = len(payload) + faults.overhead_bytes
        starts_ns = max(self._free_ns, now_ns)
        waiting = (starts_ns - now_ns) * faults.bytes_per_s / SECOND_NS
        if waiting + size > faults.queue_bytes:
            return None
        self._free_ns = starts_ns + ceil(size * SECOND_NS / faults.bytes_per_s)
        return self._free_ns


def disturbed(payload: bytes, faults: Faults, fate: Floats, counts: Counter[str]) -> list[tuple[int, bytes]]:
    """What becomes of a frame that has left: (delay in ns, bytes) of each copy that arrives. Counts what befell it.

    `fate`: (FATES,) random numbers, even in 0 to 1.
    """
    lost, doubled, damaged, bit, *delays = fate.tolist()
    if lost < faults.loss:
        counts["lost"] += 1
        return []
    if damaged < faults.corruption and payload:
        counts["corrupted"] += 1
        payload = flipped(payload, int(bit * 8 * len(payload)))
    copies = 1
    if doubled < faults.duplication:
        counts["duplicated"] += 1
        copies = 2
    return [(_delay_ns(faults, delays[2 * k], delays[2 * k + 1], counts), payload) for k in range(copies)]


def _delay_ns(faults: Faults, jitter: float, held: float, counts: Counter[str]) -> int:
    delay_s = faults.delay_s + faults.jitter_s * jitter
    if held < faults.reordering:
        counts["reordered"] += 1
        delay_s += faults.held_s
    return round(delay_s * SECOND_NS)


def flipped(payload: bytes, bit: int) -> bytes:
    """The same bytes but for one bit."""
    changed = bytearray(payload)
    changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)
