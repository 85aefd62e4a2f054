"""Brings a channel's contributions to peers: what they lack, the most worth first, and again what did not arrive."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from math import isinf

from terrafuse.exchange.codec import encode
from terrafuse.exchange.delta import Delta
from terrafuse.exchange.holding import Holding
from terrafuse.exchange.known import Claim, Known, lacking
from terrafuse.exchange.outbox import Outbox, Outgoing
from terrafuse.exchange.pace import SECOND_NS, CourierSettings
from terrafuse.exchange.parts import oldest
from terrafuse.exchange.peer import Flight, Peer, PeerChannel, TileFlight, parts_of
from terrafuse.exchange.piece import Piece, encode_piece, in_topic, pack_claim
from terrafuse.exchange.wants import Want, Wants, provable
from terrafuse.types import TileKey

CELL_BYTES = 4
"""About as much as a cell takes: messages of a slow link are short, so that none keeps others waiting for long."""
LEAST_CELLS = 64
MOST_TILES = 32
"""In a message."""
MOST_NEEDS = 2048
"""Tiles in a claim."""
MOST_LOOSE = 16
SOME_PROGRESS = 5
"""Reports until a peer that still lacks something is told up to where it lacks nothing."""


class Bringer:
    """`unlike`: tiles, by robot, of which a peer holds something else than this node; what is sent is taken out."""

    def __init__(
        self, node: str, holding: Holding, outbox: Outbox, settings: CourierSettings, unlike: dict[str, set[TileKey]]
    ) -> None:
        self._node, self._holding, self._outbox, self._settings = node, holding, outbox, settings
        self._unlike = unlike
        self._loose: list[Flight] = []
        """Sent to whoever holds something else."""
        self._wants = Wants(holding, settings.period_s * SECOND_NS)
        self._cells = settings.message_cells
        if not isinf(settings.bytes_per_s):
            self._cells = min(self._cells, max(LEAST_CELLS, round(settings.bytes_per_s / CELL_BYTES)))
        self._peers: list[tuple[Peer, PeerChannel]] = []
        self._waiting: list[Want] | None = []
        """By worth, the least first; None: to be found out anew."""
        self._now_ns = 0
        self._reports = 0
        self._steps: dict[str, set[tuple[int, int]]] = {}
        """By robot, from and to which revisions, by the last report, peers lack nothing and may not know."""

    def reach(self, peers: Iterable[Peer], now_ns: int, *, news: bool, reporting: bool) -> None:
        """These peers can be reached by now. `news`: they said something, or a report is due."""
        name = self._holding.channel.name
        self._now_ns = now_ns
        self._peers = [(peer, known) for peer in peers if (known := peer.channels.get(name)) and known.served]
        if news:
            self._waiting = None
            for peer, known in self._peers:
                known.arrived()
                self._repair(peer, known)
        if reporting and not self._holding.channel.near:
            self._reports += 1
            for robot in self._holding.told if self._peers else ():
                self._level(robot)

    def behind(self, peer: Peer | None) -> dict[str, int]:
        """By robot, how many tiles a peer lacks something of that this node would send it."""
        known = None if peer is None else peer.channels.get(self._holding.channel.name)
        lacks = {
            robot: list(lacking((known or PeerChannel()).of(robot), ours, self._holding.tiles.get(robot, {}).items()))
            for robot, ours in self._holding.told.items()
        }
        if self._holding.channel.near:
            lacks = {
                robot: [key for key in keys if peer and self._wants.interest(peer, key)]
                for robot, keys in lacks.items()
            }
        return {robot: len(keys) for robot, keys in lacks.items() if keys}

    def refill(self) -> bool:
        """Put the next message into the outbox; False: there is none."""
        if self._peers and self._unlike:
            return self._send_unlike()
        if self._waiting is None:
            self._waiting = self._wants.of(self._peers, self._now_ns)
        while self._waiting:
            robot = self._waiting[-1].robot
            wants, delta = self._load(robot)
            if delta.tiles:
                self._send(robot, wants, delta)
                return True
        return False

    # --- tiles --------------------------------------------------------------------------------------------------------

    def _load(self, robot: str) -> tuple[dict[TileKey, Want], Delta]:
        """Take those tiles of a robot that are worth most from what waits, as many as go in a message."""
        assert self._waiting is not None
        ours = self._holding.told[robot]
        best = [want for want in reversed(self._waiting) if want.robot == robot]
        until = ours.of(best[0].key)
        some = [want for want in best if ours.of(want.key) == until][:MOST_TILES]
        delta = self._holding.cells(robot, {want.key: want.since for want in some})
        taken = self._fitting(some, {tile.key: len(tile.at) for tile in delta.tiles})
        self._waiting = [want for want in self._waiting if want.robot != robot or want.key not in taken]
        return taken, replace(delta, tiles=tuple(tile for tile in delta.tiles if tile.key in taken))

    def _fitting(self, wants: Iterable[Want], cells: Mapping[TileKey, int]) -> dict[TileKey, Want]:
        """The first at least, and all of which nothing is there."""
        taken: dict[TileKey, Want] = {}
        total = 0
        for want in wants:
            count = cells.get(want.key, 0)
            if not count or not total or total + count <= self._cells:
                taken[want.key] = want
                total += count
        return taken

    def _send(self, robot: str, wants: Mapping[TileKey, Want], delta: Delta) -> None:
        ours = self._holding.told[robot]
        part = _first(delta, self._cells)
        split = part.revision < delta.revision
        until = part.revision if split else ours.of(delta.tiles[0].key)
        claim = None if split else self._claim(robot, ours, part)
        sinces = [wants[tile.key].since for tile in part.tiles]
        message = self._message(robot, part, until, sinces, claim)
        for peer, known in self._peers:
            theirs = known.of(robot)
            for tile in part.tiles:
                if theirs.of(tile.key) < until and self._wants.interest(peer, tile.key):
                    before = known.tiles.get((robot, tile.key))
                    known.tiles[robot, tile.key] = TileFlight(message, self._patience(before), until)
        if claim is not None:
            self._under_way(robot, claim, message)

    def _send_unlike(self) -> bool:
        """Some tiles whole, to be taken whatever is held."""
        robot = min(self._unlike)
        keys = sorted(self._unlike[robot])
        delta = self._holding.cells(robot, dict.fromkeys(keys[:MOST_TILES], 0))
        wants = self._fitting([Want(robot, key, 0, 0.0) for key in keys], {t.key: len(t.at) for t in delta.tiles})
        self._unlike[robot] -= wants.keys()
        if not self._unlike[robot]:
            del self._unlike[robot]
        some = tuple(tile for tile in delta.tiles if tile.key in wants)
        if some:
            until = self._holding.of(robot).base
            message = self._message(robot, replace(delta, tiles=some), until, [0], None, again=True)
            self._loose = [*self._loose[-MOST_LOOSE:], Flight(message, self._patience(None))]
        return bool(some)

    def _message(
        self, robot: str, delta: Delta, until: int, sinces: list[int], claim: Claim | None, *, again: bool = False
    ) -> Outgoing:
        if len(set(sinces)) == 1:
            sinces = sinces[:1]
        if self._holding.own is not None and robot == self._holding.own.robot:
            self._holding.own.tell(max(until, delta.revision))
        piece = Piece(until, sinces, pack_claim(claim) if claim else None, again, encode(delta))
        topic = f"delta/{self._holding.channel.name}/{in_topic(robot)}/{self._node}"
        message = self._outbox.message(topic, encode_piece(piece))
        self._outbox.put(message, self._holding.channel.name)
        return message

    def _patience(self, before: Flight | None) -> float:
        return self._settings.retry_s * SECOND_NS if before is None else self._settings.longer(before.patience_ns)

    # --- claims -------------------------------------------------------------------------------------------------------

    def _claim(self, robot: str, ours: Known, delta: Delta) -> Claim | None:
        """With the last tiles of a robot: who has these and those before holds all."""
        assert self._waiting is not None
        behind = [known.of(robot).base for _, known in self._peers if known.of(robot).base < ours.base]
        if self._holding.channel.near or not behind or any(want.robot == robot for want in self._waiting):
            return None
        return self._claimed(robot, min(behind), ours.base, {tile.key for tile in delta.tiles})

    def _claimed(self, robot: str, since: int, until: int, without: Collection[TileKey] = ()) -> Claim | None:
        tiles = self._holding.tiles.get(robot, {}).items()
        needs = [(key, min(last, until)) for key, last in tiles if last > since and key not in without]
        return Claim(since, until, tuple(sorted(needs))) if len(needs) <= MOST_NEEDS else None

    def _level(self, robot: str) -> None:
        """Tell peers up to where they lack nothing, by what they said, if they may not know."""
        ours, tiles = self._holding.told[robot], self._holding.tiles.get(robot, {}).items()
        steps = set()
        for peer, known in self._peers:
            theirs, flight = known.of(robot), known.claims.get(robot)
            if theirs.base < ours.base and (flight is None or flight.in_vain(peer)):
                until = provable(theirs, ours, tiles)
                if until > theirs.base and (until == ours.base or self._reports % SOME_PROGRESS == 0):
                    steps.add((theirs.base, until))
        own = self._holding.own is not None and self._holding.own.robot == robot
        for since, until in sorted(steps if own else steps & self._steps.get(robot, set())):
            self._send_claim(robot, since, until)
        self._steps[robot] = steps

    def _send_claim(self, robot: str, since: int, until: int) -> None:
        claim = self._claimed(robot, since, until)
        if claim is not None:
            message = self._message(robot, self._holding.cells(robot, {}), until, [since], claim)
            self._under_way(robot, claim, message)

    def _under_way(self, robot: str, claim: Claim, message: Outgoing) -> None:
        for _, known in self._peers:
            if claim.since <= known.of(robot).base < claim.until:
                known.claims[robot] = TileFlight(message, self._patience(known.claims.get(robot)), claim.until)

    # --- again --------------------------------------------------------------------------------------------------------

    def _repair(self, peer: Peer, known: PeerChannel) -> None:
        """Send again the parts that a peer lacks of messages that arrived in part."""
        for flight in (*known.tiles.values(), *known.claims.values(), *self._loose):
            if flight.message.id in peer.missing and flight.in_vain(peer):
                self._outbox.put(flight.message, self._holding.channel.name, parts_of(flight.message, peer))


def _first(piece: Delta, most_cells: int) -> Delta:
    """Of a single tile what changed first, if it is too much for a message."""
    if len(piece.tiles) > 1:
        return piece
    part = oldest(replace(piece, since=0), most_cells)
    return replace(part, since=part.revision)
