"""What a node holds and reports of one map: couriers bring several, side by side.

`fine` is the lattice that robots map on, `coarse` the same by a whole factor (`exchange.coarse`). A courier serves its
channels in the order in which it was given them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from terrafuse.errors import InputError
from terrafuse.exchange.delta import Delta
from terrafuse.exchange.own import Source
from terrafuse.store.base import Store
from terrafuse.types import TileKey

Guard = Callable[[str, Delta, int, int], str | None]
"""`guard(sender, delta, now_ns, nbytes)`: why a delta that this node sent, in so many bytes, is refused, in a word;
None: it may come in. What is refused may come again: it may be its time only that was wrong."""

NAME = re.compile(r"[a-z][a-z0-9_-]{0,31}")


def as_it_is(delta: Delta) -> Delta:
    return delta


def unheard(robot: str, keys: Sequence[TileKey]) -> None:
    pass


@dataclass(frozen=True)
class Channel:
    """One map in the exchange."""

    name: str
    store: Store | None = None
    """What this node holds of all robots, its own included; None for one that only reports its `own`. Once the courier
    has it, contributions come into it by the courier alone, or it can't know of gaps."""
    own: Source | None = None
    """What this node itself reports; its robot has the node's name. The courier takes it into the store, too."""
    relay: bool = False
    """Whether it passes on what others report, out of its store: a station does."""
    deaf: bool = False
    """It only tells what is in its store, which others write to: nothing of what peers say comes into it."""
    near: bool = False
    """Only tiles within a peer's area of interest are for it: what the station tells a robot of the whole map."""
    guard: Guard | None = None
    """Asked before a delta comes into the store; what it refuses is counted by its reason."""
    screen: Callable[[str, bytes], str | None] | None = None
    """`screen(sender, message)`: asked likewise, before the delta's bytes are unpacked."""
    on_change: Callable[[str, Sequence[TileKey]], None] = unheard
    """`on_change(robot, keys)`: these tiles of a robot's contribution changed in the store."""
    project: Callable[[Delta], Delta] = as_it_is
    """What becomes of this node's own contribution where it is reported: quantising, say. It must change nothing more
    when it is done again."""

    def __post_init__(self) -> None:
        if not NAME.fullmatch(self.name):
            raise InputError(f"channel {self.name!r}: give 1 to 32 of a-z, 0-9, _ and -, a letter first")
