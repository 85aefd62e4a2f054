"""Compares a channel's contents with peers', where revisions may not tell all (`exchange.contents`)."""

from __future__ import annotations

from collections.abc import Iterable

from terrafuse.exchange.contents import Contents, Digests, encode_digests
from terrafuse.exchange.holding import Holding
from terrafuse.exchange.known import Known
from terrafuse.exchange.pace import SECOND_NS, CourierSettings
from terrafuse.types import TileKey

QUIET_PERIODS = 3
"""A robot of which nothing came for so many reports is quiet."""
SUSPECT_S = 600.0
"""For so long after a robot lost count it is looked at, quiet or not."""
MOST_AT_ONCE = 1
"""Tiles looked at in a tick."""
LOOK_NS = SECOND_NS // 5
"""Until it is looked again whether there is any, if there was none."""


class Comparing:
    """`holding` has a store."""

    def __init__(self, holding: Holding, settings: CourierSettings) -> None:
        assert holding.store is not None
        self.unlike: dict[str, set[TileKey]] = {}
        """Tiles of which a peer holds something else."""
        self._holding, self._settings = holding, settings
        self._contents = Contents(holding.store)
        self._quiet_ns = QUIET_PERIODS * settings.period_s * SECOND_NS
        self._patience_ns = 2 * settings.period_s * SECOND_NS
        self._changed_ns: dict[str, int] = {}
        self._look_ns = 0
        self._until_ns: dict[str, float] = {}
        """Until when a robot is looked at, quiet or not."""
        self._told: dict[tuple[str, str], tuple[float, float]] = {}
        """Peers and robots whose tiles these were told: when they may be again, and how long to wait after that."""
        for robot, tiles in holding.tiles.items():
            self._contents.changed(robot, tiles)

    def tick(self, now_ns: int) -> None:
        """Note what changed, and look at some of what is to be compared."""
        for robot, keys in self._holding.changed.items():
            self._contents.changed(robot, keys)
            self._changed_ns[robot] = now_ns
        self._until_ns |= dict.fromkeys(self._holding.reborn, now_ns + SUSPECT_S * SECOND_NS)
        self._holding.changed.clear()
        self._holding.reborn.clear()
        if now_ns < self._look_ns or self._holding.channel.near:
            return
        left = MOST_AT_ONCE
        for robot in self._contents.stale:
            if left and self._compared(robot, now_ns):
                left -= self._contents.find(robot, left)
        if left:
            self._look_ns = now_ns + LOOK_NS

    def roots(self, robots: Iterable[str], now_ns: int) -> dict[str, int]:
        """To be told to peers, of those that are to be compared and were looked at."""
        known = self._holding.known
        some = [robot for robot in robots if self._compared(robot, now_ns) and not known[robot].ahead]
        return {robot: root for robot in some if (root := self._contents.root(robot)) is not None}

    def hear(self, peer: str, robot: str, theirs: Known, root: int, now_ns: int) -> bytes | None:
        """A peer told its root: the digests of this node's tiles for it, if they differ."""
        ours = self._holding.known.get(robot)
        if ours is None or ours.ahead or theirs.ahead or ours.base != theirs.base:
            return None
        own = self._contents.root(robot)
        if own is None:
            self._until_ns[robot] = max(self._until_ns.get(robot, 0), now_ns + self._quiet_ns)
            return None
        if own == root:
            self._told.pop((peer, robot), None)
            return None
        next_ns, patience_ns = self._told.get((peer, robot), (0, self._patience_ns))
        if now_ns < next_ns:
            return None
        self._told[peer, robot] = now_ns + patience_ns, self._settings.longer(patience_ns)
        tiles = self._contents.of(robot) or {}
        return encode_digests(
            Digests(robot, ours.base, [(key.x, key.y, digest) for key, digest in sorted(tiles.items())])
        )

    def differ(self, digests: Digests) -> None:
        """A peer told the digests of its tiles: note those of which this node holds something else."""
        robot = digests.robot
        ours, tiles = self._holding.told.get(robot), self._contents.of(robot)
        if ours is not None and tiles is not None and ours.base == digests.base and not ours.ahead:
            theirs = {TileKey(x, y): digest for x, y, digest in digests.tiles}
            unlike = {key for key, digest in tiles.items() if theirs.get(key) != digest}
            self.unlike.setdefault(robot, set()).update(unlike)

    def _compared(self, robot: str, now_ns: int) -> bool:
        quiet = now_ns >= self._changed_ns.get(robot, 0) + self._quiet_ns
        return quiet or now_ns < self._until_ns.get(robot, 0)
