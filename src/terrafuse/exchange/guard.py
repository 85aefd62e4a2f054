"""What a node lets in: quotas and checks, before a delta comes into a store.

    guard = Guard(store.map, Quotas(reach_m=150.0), Policy(relays=frozenset({"station"})))
    guard.place("r4", 12.5, -3.0, now_ns)                # whenever a robot says where it is
    if (reason := guard.screen("r4", message)) is None:  # bytes that are not unpacked yet: cheap
        delta = decode(message, cell, guard.quotas.message_cells)
        reason = guard.check("r4", delta, now_ns, len(message))

Either gives None for what may come in, else why it may not, in one word; `counts` has how often each word fell. What is
refused changes nothing else. `check` is what a channel takes as its guard. Memory is bounded by the quotas.

| word | what was wrong |
|---|---|
| sender | this node may not report that robot, nor pass it on |
| map | cells of another lattice, model or CRS |
| damaged | no delta of a version that we read (`screen` only) |
| size | a message of too many bytes or cells |
| clock | a stamp later than the receiver's clock, plus a tolerance |
| rate | more bytes a second from this node than it may send |
| robots | more robots, or nodes, than are remembered |
| tiles, area | more tiles, or ground, than a robot may report altogether |
| place | the robot did not say where it is |
| distance | cells further from where the robot was than it can see |
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from math import hypot, inf, isinf
from typing import Protocol

import numpy as np

from terrafuse.errors import CodecError, InputError
from terrafuse.exchange.codec import heading
from terrafuse.exchange.delta import Delta, MapId
from terrafuse.types import Array, Stamp, TileKey

SECOND_NS = 1_000_000_000
MOST_PLACES = 512
"""That are remembered of a robot; the oldest go first."""
NEAR = 4
"""A place nearer to the last one than a quarter of the reach adds nothing."""


class Allows(Protocol):
    """`Policy`, or what looks it up."""

    def allows(self, node: str, robot: str) -> bool: ...


@dataclass(frozen=True)
class Policy:
    """Which node may report which robot. A node may always report the robot of its own name."""

    relays: Collection[str] = ()
    """Nodes that may pass on any robot's reports."""
    reports: Mapping[str, Collection[str]] = field(default_factory=dict)
    """By node, robots besides."""

    def allows(self, node: str, robot: str) -> bool:
        return node == robot or node in self.relays or robot in self.reports.get(node, ())


@dataclass(frozen=True)
class Quotas:
    """How much is too much. The defaults leave room for a fast ground robot; infinite switches a check off."""

    message_bytes: float = 1 << 20
    message_cells: int = 1 << 17
    """One scan of a 3D lidar has some 50,000 cells of 0.1 m."""
    bytes_per_s: float = 500_000
    """Of a node, over `burst_s`: what it did not send for so long, it may send at once."""
    burst_s: float = 30.0
    ahead_s: float = 60.0
    """By how much a robot's clock may be ahead of the receiver's."""
    tiles: int = 20_000
    """Of a robot,"""
    all_tiles: int = 1_000_000
    """and of all robots together. They are remembered, so never infinite."""
    area_m2: float = inf
    """Of a robot's tiles."""
    reach_m: float = inf
    """From where the robot was to the near edge of a tile that it reports. Finite, a robot has to say where it is."""
    speed_mps: float = 10.0
    """While nothing was heard of a robot it may have been further away, by this speed."""
    robots: int = 4096
    """And as many nodes."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value > 0:
                raise InputError(f"quota {name} {value}: give a positive number")
        for name in ("message_cells", "tiles", "all_tiles", "robots"):
            if isinf(getattr(self, name)):
                raise InputError(f"quota {name} bounds memory: give a finite number")


@dataclass
class _Bucket:
    allowed: float
    at_ns: int


@dataclass
class _Robot:
    tiles: set[TileKey] = field(default_factory=set)
    places: deque[tuple[float, float, float]] = field(default_factory=lambda: deque(maxlen=MOST_PLACES))
    """East, north, and how far away it may have been since the place before."""
    track: Array = field(default_factory=lambda: np.empty((0, 3)))
    """As it told them itself, the latest time."""
    heard_ns: Stamp | None = None


class Guard:
    """See the module's text. Not for two threads at once."""

    def __init__(self, map_: MapId, quotas: Quotas | None = None, policy: Allows | None = None) -> None:
        self.quotas, self.policy = quotas or Quotas(), policy or Policy()
        self.counts: Counter[str] = Counter()
        self._map = map_
        self._robots: dict[str, _Robot] = {}
        self._tiles = 0
        """Of all robots."""
        self._buckets: dict[str, _Bucket] = {}

    def place(self, robot: str, east_m: float, north_m: float, now_ns: Stamp) -> None:
        """Robot `robot` says that it is here. To be called for what comes from the robot itself."""
        if (own := self._known(robot)) is None:
            return
        silence_s = 0.0 if own.heard_ns is None else max(now_ns - own.heard_ns, 0) / SECOND_NS
        own.heard_ns, away_m = now_ns, self.quotas.speed_mps * silence_s
        if own.places:
            east, north, _ = own.places[-1]
            if hypot(east_m - east, north_m - north) + away_m < self.quotas.reach_m / NEAR:
                return
        own.places.append((float(east_m), float(north_m), away_m))

    def track(self, robot: str, places_m: Array, spacing_m: float) -> None:
        """Robot `robot` says that it came by these places (K, 2), east and north, each so far from the one before: for
        a node that has not heard where it was. The last `MOST_PLACES` count, in place of those told before."""
        if (own := self._known(robot)) is not None:
            some = np.asarray(places_m, np.float64)[-MOST_PLACES:]
            own.track = np.column_stack([some, np.full(len(some), min(spacing_m / 2, self.quotas.reach_m))])

    def remember(self, robot: str, tiles: Iterable[TileKey]) -> None:
        """These the robot has reported already: what a store holds when a node starts."""
        if (own := self._known(robot)) is not None:
            self._take(own, set(tiles))

    def screen(self, sender: str, message: bytes) -> str | None:
        """Whether to unpack these bytes at all: damaged, size, sender, map."""
        if len(message) > self.quotas.message_bytes:
            return self._refused("size")
        try:
            head = heading(message)
        except CodecError:
            return self._refused("damaged")
        return self._refused(self._outline(sender, head.robot, head.map, head.cells))

    def check(self, sender: str, delta: Delta, now_ns: Stamp, nbytes: int = 0) -> str | None:
        """Whether a delta that `sender` sent in so many bytes may come in at `now_ns` of the receiver's clock (UTC)."""
        reason = "size" if nbytes > self.quotas.message_bytes else None
        reason = reason or self._outline(sender, delta.robot, delta.map, delta.cell_count)
        if reason := reason or self._late(delta, now_ns):
            return self._refused(reason)
        own = self._robots.get(delta.robot) or _Robot()
        keys = {tile.key for tile in delta.tiles}
        if (
            reason := self._beyond(own, keys)
            or self._crowded(sender, delta.robot)
            or self._spent(sender, nbytes, now_ns)
        ):
            return self._refused(reason)
        self._take(self._robots.setdefault(delta.robot, own), keys)
        return None

    def _refused(self, reason: str | None) -> str | None:
        if reason is not None:
            self.counts[reason] += 1
        return reason

    def _known(self, name: str) -> _Robot | None:
        if name not in self._robots and len(self._robots) < self.quotas.robots:
            self._robots[name] = _Robot()
        return self._robots.get(name)

    def _take(self, own: _Robot, keys: set[TileKey]) -> None:
        self._tiles -= len(own.tiles)
        own.tiles |= keys
        self._tiles += len(own.tiles)

    def _crowded(self, sender: str, robot: str) -> str | None:
        most = self.quotas.robots
        full = (robot not in self._robots and len(self._robots) >= most) or (
            sender not in self._buckets and len(self._buckets) >= most
        )
        return "robots" if full else None

    def _outline(self, sender: str, robot: str, map_: MapId, cells: int) -> str | None:
        if not self.policy.allows(sender, robot):
            return "sender"
        if map_ != self._map:
            return "map"
        return "size" if cells > self.quotas.message_cells else None

    def _late(self, delta: Delta, now_ns: Stamp) -> str | None:
        newest = max((tile.newest[1] for tile in delta.tiles), default=0)
        return "clock" if max(newest, delta.stamp_ns) > now_ns + self.quotas.ahead_s * SECOND_NS else None

    def _spent(self, sender: str, nbytes: int, now_ns: Stamp) -> str | None:
        """Take the bytes out of the sender's bucket, if they are in it; or it is full, and will be in debt."""
        most = self.quotas.bytes_per_s * self.quotas.burst_s
        if isinf(most):
            return None
        bucket = self._buckets.setdefault(sender, _Bucket(most, now_ns))
        since_s = max(now_ns - bucket.at_ns, 0) / SECOND_NS
        allowed = min(bucket.allowed + since_s * self.quotas.bytes_per_s, most)
        if nbytes > allowed < most:
            return "rate"
        bucket.allowed, bucket.at_ns = allowed - nbytes, max(now_ns, bucket.at_ns)
        return None

    def _beyond(self, own: _Robot, keys: set[TileKey]) -> str | None:
        more = len(keys - own.tiles)
        tiles = len(own.tiles) + more
        if tiles > self.quotas.tiles or self._tiles + more > self.quotas.all_tiles:
            return "tiles"
        if tiles * self._map.tile_m**2 > self.quotas.area_m2:
            return "area"
        if isinf(self.quotas.reach_m) or not keys:
            return None
        if not own.places and not len(own.track):
            return "place"
        return "distance" if (self._apart_m(own, keys) > self.quotas.reach_m).any() else None

    def _apart_m(self, own: _Robot, keys: set[TileKey]) -> Array:
        """(K,) metres from each tile's near edge to the nearest of where the robot was, or may have been."""
        corners = np.array([(key.x, key.y) for key in keys], np.float64)[:, None] * self._map.tile_m
        places = np.concatenate([own.track, np.reshape(own.places, (-1, 3))])
        nearest = np.clip(places[:, :2], corners, corners + self._map.tile_m)
        return np.asarray((np.linalg.norm(places[:, :2] - nearest, axis=2) - places[:, 2]).min(axis=1))
