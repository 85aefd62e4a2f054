"""A node's own contribution, from one life of the node to the next."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

from terrafuse.exchange.delta import MAX_REVISION, Delta, TileCells
from terrafuse.exchange.parts import newer

LIFE = 1 << 20
"""Scans: who lost count begins anew where none that it made before can be."""


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
    it hears of a revision that it never told (`surpass`), it counts on from the next multiple of LIFE beyond it, and
    tells all that it has anew. What it told before is history, which those who hold it pass on; who lacks some of that
    is found out by comparing contents (`exchange.contents`).
    """

    def __init__(self, source: Source) -> None:
        self.robot = source.robot
        self._source = source
        self._before = 0
        self._told = 0

    @property
    def revision(self) -> int:
        return self._source.revision + self._before if self._source.revision else 0

    def delta(self, since: int) -> Delta:
        """What changed after revision `since`, as far as it is of this life."""
        if not self._before:
            return self._source.delta(since)
        delta = self._source.delta(max(since - self._before, 0))
        tiles = tuple(self._later(tile) for tile in delta.tiles)
        return replace(delta, since=since, revision=delta.revision + self._before, tiles=tiles)

    def begin(self, held: int) -> None:
        """A life begins, with this revision of it in the node's store: who kept its map told no more than is in it."""
        beyond = max(held - self._source.revision, 0)
        self._before = -(-beyond // LIFE) * LIFE
        self._told = self.revision
        self.surpass(held)

    def tell(self, revision: int) -> None:
        """Others are told up to this revision."""
        self._told = max(self._told, revision)

    def surpass(self, revision: int) -> bool:
        """Somebody holds this revision of ours: was it told in an earlier life? Then count on from beyond it."""
        before = (revision // LIFE + 1) * LIFE
        if revision <= self._told or before + self._source.revision > MAX_REVISION:
            return False
        self._before = self._told = before
        return True

    def _later(self, tile: TileCells) -> TileCells:
        copy = newer(tile, 0)
        copy.cells["revision"] += self._before
        return copy
