"""What peers lack of a channel, the most worth first.

A tile is worth the share of its cells that the peer knows nothing of, from 0 to 1; of the others, half the share of the
robot's revisions that it lacks of them; and each 30 s of waiting as much as a tile that nobody ever told. So nothing
starves: what has waited goes before all that is younger by 30 s, whatever it is.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from terrafuse.exchange.area import meets
from terrafuse.exchange.holding import Holding
from terrafuse.exchange.known import Known, lacking
from terrafuse.exchange.peer import Peer, PeerChannel
from terrafuse.types import TileKey

AGE_NS = 30e9
AGAIN = 0.5


@dataclass(frozen=True)
class Want:
    """A tile that peers lack: all of them hold it up to `since` at least."""

    robot: str
    key: TileKey
    since: int
    worth: float


class Wants:
    def __init__(self, holding: Holding, settle_ns: float) -> None:
        self._holding = holding
        self._settle_ns = settle_ns
        """What others report is passed on only when so long somebody lacked it: most overheard it from them."""
        self._first_ns: dict[tuple[str, TileKey], int] = {}

    def of(self, peers: Iterable[tuple[Peer, PeerChannel]], now_ns: int) -> list[Want]:
        """By worth, the least first."""
        lacks = self._lacks(list(peers))
        self._first_ns = {at: self._first_ns.get(at, now_ns) for at in lacks}
        wants = [self._want(*at, since, now_ns) for at, since in lacks.items() if self._settled(*at, now_ns)]
        return sorted(wants, key=lambda want: (want.worth, want.robot, want.key))

    def _lacks(self, peers: list[tuple[Peer, PeerChannel]]) -> dict[tuple[str, TileKey], int]:
        """By robot and tile, up to where those who lack it hold it."""
        lacks: dict[tuple[str, TileKey], int] = {}
        for robot, ours in self._holding.told.items() if peers else ():
            tiles = self._holding.tiles.get(robot, {}).items()
            for peer, known in peers:
                theirs = known.of(robot)
                for key in lacking(theirs, ours, tiles):
                    if self._may_go(peer, known, robot, key):
                        lacks[robot, key] = min(theirs.of(key), lacks.get((robot, key), theirs.of(key)))
        return lacks

    def _may_go(self, peer: Peer, known: PeerChannel, robot: str, key: TileKey) -> bool:
        """Whether it is not under way, and of interest."""
        flight = known.tiles.get((robot, key))
        if flight is not None and not (flight.in_vain(peer) and flight.message.id not in peer.missing):
            return False
        return self.interest(peer, key)

    def interest(self, peer: Peer, key: TileKey) -> bool:
        """Whether a tile is for this peer at all."""
        if not self._holding.channel.near:
            return True
        return peer.area is not None and meets(key, self._holding.tile_m, peer.area)

    def _settled(self, robot: str, key: TileKey, now_ns: int) -> bool:
        own = self._holding.own
        return (own is not None and robot == own.robot) or now_ns >= self._first_ns[robot, key] + self._settle_ns

    def _want(self, robot: str, key: TileKey, since: int, now_ns: int) -> Want:
        waited = (now_ns - self._first_ns[robot, key]) / AGE_NS
        return Want(robot, key, since, self._news(robot, key, since) + waited)

    def _news(self, robot: str, key: TileKey, since: int) -> float:
        own = self._holding.own
        unknown = self._holding.growth.unknown(key, since) if own is not None and own.robot == robot else None
        if unknown is None:
            unknown = 0.0 if since else 1.0
        revision = self._holding.tiles[robot][key]
        return unknown + (1 - unknown) * AGAIN * (revision - since) / revision


def provable(theirs: Known, ours: Known, tiles: Iterable[tuple[TileKey, int]]) -> int:
    """The newest revision up to which a peer, by what it said, lacks nothing."""
    return min((theirs.of(key) for key in lacking(theirs, ours, tiles)), default=ours.base)
