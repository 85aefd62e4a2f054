"""What a node answers who asks for a part of its map: out of its own stores alone, and no more than it has time for.

| question | content of the answer |
|---|---|
| `tile` | the tile's global cells, as a delta |
| `picture` | PNG of a layer over a tile or an area, a pixel a cell or a block of cells, see-through where unknown |
| `extent` | what rectangle the map's tiles cover |
"""

from __future__ import annotations

import io
import math
import time
from collections import Counter, OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import msgspec
import numpy as np

from terrafuse import views
from terrafuse.errors import InputError, MissingExtra, TerrafuseError
from terrafuse.exchange.asking import BUSY, Question, Tiles
from terrafuse.lattice import MAX_CELL, union
from terrafuse.replica import Replica
from terrafuse.types import Bounds

MOST_CELLS = 2_000_000
"""Of a picture."""
MOST_PIXELS = 1024
"""On a side of it."""
MOST_PEERS = 1024
"""Whose questions are remembered; the longest ago go first."""


@dataclass(frozen=True)
class Rates:
    """What a node answers at most. Reading a million cells takes about a tenth of a second, in which it does nothing
    else."""

    cells_per_s: float = 1_000_000
    """Of a peer,"""
    burst_cells: float = 4_000_000
    """which may ask for so many at once."""
    all_cells_per_s: float = 2_000_000
    """Of all peers together, likewise."""
    all_burst_cells: float = 8_000_000


class Answers:
    """See the module's text. `replicas`: by channel. For one thread.

    `counts`: questions.answered, questions.busy (too much at once), questions.refused.
    """

    def __init__(
        self,
        node: str,
        replicas: Mapping[str, Replica],
        rates: Rates | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.counts: Counter[str] = Counter()
        self._replicas, self._rates, self._clock = replicas, rates or Rates(), clock
        self._all = Allowance(self._rates.all_cells_per_s, self._rates.all_burst_cells, clock())
        self._peers: OrderedDict[str, Allowance] = OrderedDict()
        self._kinds: dict[str, Callable[[str, Question], bytes]]
        self._kinds = {"tile": Tiles(node, replicas), "picture": self._picture, "extent": self._extent}

    def __call__(self, peer: str, question: Question) -> bytes:
        """Raises InputError, with what to do, for what there is not, for too much at once, and for too large a part."""
        try:
            content = self._answer(peer, question)
        except TerrafuseError as error:
            self.counts["questions.busy" if str(error).startswith(BUSY) else "questions.refused"] += 1
            raise
        self.counts["questions.answered"] += 1
        return content

    def _answer(self, peer: str, question: Question) -> bytes:
        if question.what not in self._kinds:
            raise InputError(f"nobody answers '{question.what}' here; ask for {', '.join(self._kinds)}")
        if question.channel not in self._replicas:
            there = ", ".join(self._replicas) or "none"
            raise InputError(f"there is no map '{question.channel}' here; there are: {there}")
        replica = self._replicas[question.channel]
        self._spend(peer, _cells(replica, question))
        return self._kinds[question.what](peer, question)

    def _spend(self, peer: str, cells: int) -> None:
        now_s = self._clock()
        own = self._peers.pop(peer, None) or Allowance(self._rates.cells_per_s, self._rates.burst_cells, now_s)
        self._peers[peer] = own
        if len(self._peers) > MOST_PEERS:
            self._peers.popitem(last=False)
        if not (own.has(cells, now_s) and self._all.has(cells, now_s)):
            raise InputError(f"{BUSY}: so many cells a second are too much; ask again in a second")
        own.spend(cells)
        self._all.spend(cells)

    def _extent(self, peer: str, question: Question) -> bytes:
        replica = self._replicas[question.channel]
        return msgspec.msgpack.encode(union(replica.keys, replica.lattice))

    def _picture(self, peer: str, question: Question) -> bytes:
        replica = self._replicas[question.channel]
        (layer,) = views.chosen_layers(replica, [question.layer or replica.model.picture_layer])
        return drawn(replica, layer.name, _area(replica, question))


class Allowance:
    """So many cells a second, and at most so many at once."""

    def __init__(self, per_s: float, burst: float, now_s: float) -> None:
        self._per_s, self._burst = per_s, burst
        self._left, self._at_s = burst, now_s

    def has(self, cells: float, now_s: float) -> bool:
        self._left = min(self._left + max(now_s - self._at_s, 0.0) * self._per_s, self._burst)
        self._at_s = now_s
        return cells <= self._left

    def spend(self, cells: float) -> None:
        self._left -= cells


def drawn(replica: Replica, layer: str, area: Bounds) -> bytes:
    """A layer as a bare PNG, its colours as in `terrafuse export`: north up, at most MOST_PIXELS a side."""
    try:
        from matplotlib.image import imsave
    except ImportError as error:
        raise MissingExtra("a picture", "matplotlib", "plot") from error
    from terrafuse.export.looks import look_of, painted

    (chosen,) = views.chosen_layers(replica, [layer])
    window = replica.lattice.cell_window(area)
    values = views.reduced(replica, chosen, window, math.ceil(max(views.shape_of(window)) / MOST_PIXELS))[::-1]
    known = values[~np.isnan(values)]
    if not len(known):
        raise InputError(f"nothing of the map lies within {tuple(area)}")
    look = look_of(chosen)
    out = io.BytesIO()
    imsave(out, painted(values, look, look.scale(known), None), format="png")
    return out.getvalue()


def _cells(replica: Replica, question: Question) -> int:
    """How many a question is about. Raises InputError for an area without any, or with too many."""
    side = replica.lattice.tile_cells
    if question.what == "extent":
        return 0
    if question.what == "tile" or question.area is None:
        if max(abs(question.x), abs(question.y)) > MAX_CELL // side:
            raise InputError(f"tile ({question.x}, {question.y}) is beyond the lattice")
        return side * side
    rows, columns = views.shape_of(replica.lattice.cell_window(_area(replica, question)))
    if rows * columns > MOST_CELLS:
        raise InputError(
            f"an area of {columns}×{rows} cells: a picture has {MOST_CELLS:,} at most; ask for a smaller one, or "
            "of the coarse map"
        )
    return rows * columns


def _area(replica: Replica, question: Question) -> Bounds:
    if question.area is not None:
        return Bounds(*question.area)
    tile_m = replica.lattice.tile_m
    west, south = question.x * tile_m, question.y * tile_m
    return Bounds(west, south, west + tile_m, south + tile_m)
