"""How much of a robot's contribution a node holds: all up to a revision, and of some tiles more."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from terrafuse.types import TileKey


class Claim(NamedTuple):
    """Who holds all up to `since`, and each of these tiles up to the revision beside it, holds all up to `until`."""

    since: int
    until: int
    needs: tuple[tuple[TileKey, int], ...]


@dataclass
class Known:
    """All up to `base` is held, and the tiles in `ahead` up to a newer revision. Knowledge only grows."""

    base: int = 0
    ahead: dict[TileKey, int] = field(default_factory=dict)

    def of(self, key: TileKey) -> int:
        """Up to which revision the tile is held."""
        return max(self.base, self.ahead.get(key, 0))

    def learn(self, key: TileKey, until: int) -> None:
        if until > self.of(key):
            self.ahead[key] = until

    def level(self, base: int) -> None:
        """All up to `base` is held."""
        if base > self.base:
            self.base = base
            self.ahead = {key: until for key, until in self.ahead.items() if until > base}

    def follows(self, claim: Claim) -> bool:
        """Whether what it asks for is held."""
        return self.base >= claim.since and all(self.of(key) >= revision for key, revision in claim.needs)

    @property
    def newest(self) -> int:
        return max(self.base, max(self.ahead.values(), default=0))


def lacking(theirs: Known, ours: Known, revisions: Iterable[tuple[TileKey, int]]) -> Iterator[TileKey]:
    """Of tiles and the revisions that last changed them those of which we hold what they lack."""
    if theirs.base >= ours.base and not ours.ahead:
        return
    for key, revision in revisions:
        if theirs.of(key) < min(revision, ours.of(key)):
            yield key
