"""A node's own contribution, from one life of the node to the next."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

from terrafuse.exchange.delta import MAX_REVISION, Delta, TileCells
from terrafuse.exchange.parts import newer


class Source(Protocol):
    """A contribution that a node makes: `CoarseContribution`, `Mapper`."""

    @property
    def robot(self) -> str: ...

    @property
    def revision(self) -> int:
        """Of what `delta` would tell now."""

    def delta(self, since: int) -> Delta: ...


class Own:
    """A source whose revisions are beyond those of the node's earlier lives.

    A robot that was started afresh counts its scans from 1 again, while others hold its earlier reports as newer. Once
    it hears of those (`surpass`), it counts on from there. What it then tells begins after them: they are history,
    which those who hold it pass on.
    """

    def __init__(self, source: Source) -> None:
        self.robot = source.robot
        self._source = source
        self._before = 0

    @property
    def revision(self) -> int:
        return self._source.revision + self._before if self._source.revision else 0

    def delta(self, since: int) -> Delta:
        """What changed after revision `since`; its own `since` is larger where an earlier life ended later."""
        if not self._before:
            return self._source.delta(since)
        delta = self._source.delta(max(since - self._before, 0))
        tiles = tuple(self._later(tile) for tile in delta.tiles)
        return replace(delta, since=delta.since + self._before, revision=delta.revision + self._before, tiles=tiles)

    def surpass(self, revision: int) -> bool:
        """Somebody holds this revision of ours: is it of an earlier life? Then count on from there."""
        if revision <= max(self.revision, self._before) or revision + self._source.revision > MAX_REVISION // 2:
            return False
        self._before = revision
        return True

    def _later(self, tile: TileCells) -> TileCells:
        copy = newer(tile, 0)
        copy.cells["revision"] += self._before
        return copy
