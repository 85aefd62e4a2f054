"""What a courier knows of its own node's channel: what it holds of each robot, and what it tells of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Hashable, Iterable, Mapping
from dataclasses import replace

from terrafuse.errors import CodecError, DeltaError
from terrafuse.exchange.channel import Channel
from terrafuse.exchange.codec import decode
from terrafuse.exchange.delta import Delta, TileCells
from terrafuse.exchange.growth import Growth
from terrafuse.exchange.known import Claim, Known
from terrafuse.exchange.own import LIFE, Own
from terrafuse.exchange.parts import newer
from terrafuse.exchange.piece import Piece, in_topic, unpack_claim
from terrafuse.types import TileKey


class Holding:
    """A channel, and what of it is held. `counts` gets what became of deltas."""

    def __init__(self, channel: Channel, counts: Counter[str]) -> None:
        self.channel = channel
        self.store = channel.store
        self.own = None if channel.own is None else Own(channel.own)
        self.known: dict[str, Known] = {}
        """By robot, what may be said to be held of it."""
        self.tiles: dict[str, dict[TileKey, int]] = {}
        """By robot, its tiles and the newest revision of each."""
        self.unsaid: dict[str, set[TileKey]] = {}
        """Robots of which more is held since the last summary, and tiles that are ahead."""
        self.changed: dict[str, set[TileKey]] = {}
        """Tiles that changed, until who compares contents takes note,"""
        self.reborn: set[str] = set()
        """and robots that lost count: a life began."""
        self.tile_m = 0.0 if self.store is None else self.store.map.tile_m
        """Of the channel's lattice, as soon as anything of it is there."""
        self.growth = Growth()
        """Of what this node itself made."""
        self._version: Hashable = None
        self._claims: dict[str, Claim] = {}
        """That can't be followed yet."""
        self._counts = counts
        self._find()

    def begin(self) -> None:
        """The node begins to live."""
        if self.own is not None:
            self.own.begin(self.of(self.own.robot).newest)

    def take_own(self) -> None:
        """Take in what this node itself made since the last time; or what others put into the store."""
        if self.channel.deaf:
            self._look_again()
        if self.own is None or not self.own.revision:
            return
        known = self.of(self.own.robot)
        if self.own.revision <= known.base:
            return
        delta = self.projected(known.base)
        self.tile_m = delta.map.tile_m
        if self.store is not None:
            self.store.accept(delta)
        self._note(delta.robot, delta.tiles)
        for tile in delta.tiles:
            self.growth.note(tile, delta.map.lattice.tile_cells)
        known.level(delta.revision)
        self.unsaid.setdefault(delta.robot, set())

    @property
    def told(self) -> Mapping[str, Known]:
        """By robot, what this node tells of it: its own, and what it passes on."""
        if self.channel.relay:
            return self.known
        return {} if self.own is None else {self.own.robot: self.of(self.own.robot)}

    def of(self, robot: str) -> Known:
        return self.known.setdefault(robot, Known())

    def cells(self, robot: str, since: Mapping[TileKey, int]) -> Delta:
        """Of each of these tiles what changed after the revision beside it, as a delta that leads nowhere."""
        if self.store is None:
            whole = self.projected(min(since.values(), default=self.of(robot).base))
        else:
            whole = self._held(robot, since)
        some = [newer(tile, since[tile.key]) for tile in whole.tiles if tile.key in since]
        return _piece(whole, [tile for tile in some if len(tile.at)])

    def projected(self, since: int) -> Delta:
        assert self.own is not None
        return self.channel.project(self.own.delta(since))

    def apply(self, sender: str, about: str, piece: Piece, now_ns: int) -> bool:
        """Take tiles into the store, unless they are known, refused, or leave a gap: what is held never has one.
        `about`: the robot that the topic names.

        False for what may be taken if it comes again. Raises CodecError for bytes that are none.
        """
        if self.store is None or not self.takes:
            return True
        screen = self.channel.screen
        if screen is not None and (reason := screen(sender, piece.delta)) is not None:
            self._counts[f"refused.{reason}"] += 1
            return True
        delta = decode(piece.delta, self.store.model.cell)
        if len(piece.sinces) not in (1, len(delta.tiles)):
            raise CodecError(f"{len(piece.sinces)} revisions for {len(delta.tiles)} tiles")
        if (reason := self._refusal(sender, about, delta, now_ns, len(piece.delta))) is not None:
            self._counts[f"refused.{reason}"] += 1
            return False
        if self.own is not None and delta.robot == self.own.robot:
            self.own.surpass(max(piece.until, delta.revision))  # before it is passed on, which would count as told
        known = self.of(delta.robot)
        sinces = piece.sinces * len(delta.tiles) if len(piece.sinces) == 1 else piece.sinces
        fresh = [
            tile
            for tile, since in zip(delta.tiles, sinces, strict=True)
            if piece.again or since <= known.of(tile.key) < piece.until
        ]
        gaps = any(since > known.of(tile.key) for tile, since in zip(delta.tiles, sinces, strict=True))
        self._take(known, delta, fresh, piece)
        if gaps and not piece.again:
            self._counts["refused.gap"] += 1
        return piece.again or not gaps

    def surpass(self, revision: int) -> bool:
        """A peer holds this revision of the node's own robot: is it of an earlier life of the node?"""
        return self.own is not None and self.own.surpass(revision)

    @property
    def takes(self) -> bool:
        """Whether contributions of others come into the store by this."""
        return self.store is not None and not self.channel.deaf

    def _look_again(self) -> None:
        assert self.store is not None
        version = self.store.version()
        if version != self._version:
            self._version = version
            self._find()

    def _find(self) -> None:
        """What the store holds, and which of it is of an earlier life of this node."""
        for robot in [] if self.store is None else self.store.robots():
            assert self.store is not None
            tiles = self.tiles[robot] = dict(self.store.revisions(robot))
            base = 0 if self.channel.near else self.store.level(robot)
            self.known[robot] = Known(base, {key: revision for key, revision in tiles.items() if revision > base})

    def _refusal(self, sender: str, about: str, delta: Delta, now_ns: int, nbytes: int) -> str | None:
        if in_topic(delta.robot) != about:  # carriers bind topics to who may send on them
            return "topic"
        guard = self.channel.guard
        return guard(sender, delta, now_ns, nbytes) if guard is not None else None

    def _take(self, known: Known, delta: Delta, fresh: list[TileCells], piece: Piece) -> None:
        """Into the store first, and only then among what is known."""
        assert self.store is not None
        ahead = Known(known.base, {**known.ahead})
        for tile in fresh:
            ahead.learn(tile.key, piece.until)
        claim = self._followed(ahead, delta.robot, piece, [tile.key for tile in delta.tiles])
        some, message = _piece(delta, fresh), piece.delta if len(fresh) == len(delta.tiles) else None
        try:
            if claim is not None and some.revision <= claim.until:
                self.store.accept(replace(some, since=known.base, revision=claim.until), message=message)
            else:
                if fresh:
                    self.store.accept(some, message=message)
                if claim is not None:
                    self.store.accept(replace(some, since=known.base, revision=claim.until, tiles=()))
        except DeltaError:
            self._counts["refused.delta"] += 1
            return
        self._counts["deltas_applied" if fresh or claim else "deltas_known"] += 1
        self._note(delta.robot, fresh)
        known.ahead = ahead.ahead
        if claim is not None:
            known.level(claim.until)
            self._claims.pop(delta.robot, None)
        if fresh or claim is not None:
            self.unsaid.setdefault(delta.robot, set()).update(tile.key for tile in fresh)

    def _followed(self, ahead: Known, robot: str, piece: Piece, keys: Iterable[TileKey]) -> Claim | None:
        """The claim that leads on from here: this piece's, or one that came before what it needs.

        A claim leaves out the tiles `keys` of its own piece: who could not take these does not follow it.
        """
        if piece.claim is not None and piece.claim[1] > ahead.base:
            told = unpack_claim(*piece.claim)
            own = tuple((key, min(piece.until, told.until)) for key in keys)
            self._claims[robot] = told._replace(needs=(*told.needs, *own))
        claim = self._claims.get(robot)
        return claim if claim is not None and claim.until > ahead.base and ahead.follows(claim) else None

    def _note(self, robot: str, tiles: Collection[TileCells]) -> None:
        known = self.tiles.setdefault(robot, {})
        life = max((tile.newest[0] for tile in tiles), default=0) // LIFE
        if known and life and life > max(known.values()) // LIFE:
            self.reborn.add(robot)
        for tile in tiles:
            known[tile.key] = max(known.get(tile.key, 0), tile.newest[0])
        if self.store is not None and tiles:
            keys = [tile.key for tile in tiles]
            self.changed.setdefault(robot, set()).update(keys)
            self.channel.on_change(robot, keys)

    def _held(self, robot: str, keys: Iterable[TileKey]) -> Delta:
        assert self.store is not None
        held = (self.store.load(robot, key) for key in sorted(keys))
        tiles = tuple(tile for tile in held if tile is not None)
        return Delta(self.store.map, robot, 0, self.store.revision(robot), self.store.stamp(robot), tiles)


def _piece(delta: Delta, tiles: Iterable[TileCells]) -> Delta:
    """These tiles as a delta that leads nowhere."""
    some = tuple(tiles)
    newest = max((tile.newest[0] for tile in some), default=0)
    return replace(delta, since=newest, revision=newest, tiles=some)
