"""How often a courier speaks, and how much."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

SECOND_NS = 1_000_000_000


@dataclass(frozen=True)
class CourierSettings:
    """How often, how much."""

    period_s: float = 1.0
    """Between reports of what is new, and between summaries."""
    answer_s: float = 0.2
    """What arrived is acknowledged by a summary as soon as this is over since the last one."""
    retry_s: float = 1.0
    """A peer that says, this long after the last frame of a message has left, that it lacks it, gets it again; each
    time in vain doubles that, up to `longest_retry_s`."""
    longest_retry_s: float = 16.0
    silent_s: float = 5.0
    """Nothing is sent to a peer of whom nothing was heard for so long."""
    bytes_per_s: float = inf
    """What this node sends at most; less than what the link carries, or it queues there."""
    overhead_bytes: int = 0
    """That the carrier adds to each frame beside what the link says itself, and the budget counts."""
    summary_share: float = 0.15
    """Of the budget: summaries come less often, and whole ones say less, rather than take more."""
    overhears: bool = True
    """Whether contributions that others than its peers send are taken, too. Over a radio they come for nothing; where a
    station passes all frames on, they would come beside its budget."""
    message_cells: int = 2048
    """Of a tile in which more changed, the oldest revisions come first, in a message of their own (more only where one
    revision has more)."""

    def longer(self, patience_ns: float) -> float:
        """How long to wait for an answer after one more time in vain."""
        return min(2 * patience_ns, self.longest_retry_s * SECOND_NS)
