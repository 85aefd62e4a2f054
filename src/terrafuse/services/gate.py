"""What a station lets in: a guard for each of its maps, and what those have to know of robots and of keys."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import accumulate
from math import inf
from pathlib import Path

import numpy as np

from terrafuse.errors import InputError
from terrafuse.exchange.area import tiles_in
from terrafuse.exchange.channel import Channel, unheard
from terrafuse.exchange.framing import Limits
from terrafuse.exchange.guard import Allows, Guard, Policy, Quotas
from terrafuse.services.places import PLACE, TRACK, decode_place, decode_track
from terrafuse.services.settings import QuotasPart
from terrafuse.store.base import Store
from terrafuse.types import Bounds, TileKey

OnChange = Callable[[str, Sequence[TileKey]], None]

MESSAGE_CELLS = 1 << 17
"""A message of one tile may have all of it, however many cells that are."""


class Gate:
    """`keys`: the folder of the station's keys; None: each node may report itself, and `relays` any robot."""

    def __init__(
        self, stores: Sequence[Store], quotas: QuotasPart, keys: str | None, relays: Sequence[str] = ()
    ) -> None:
        if keys is not None and relays:
            raise InputError("relays: with keys, these say who may relay: terrafuse keys add NAME --station")
        policy: Allows = Policy(frozenset(relays)) if keys is None else Roll(Path(keys))
        self._guards = [_guard(store, quotas, policy) for store in stores]
        self._quotas, self._tile_m = quotas, stores[0].map.tile_m
        self._policy, self._open = policy, keys is None

    def channel(self, name: str, which: int, store: Store, on_change: OnChange = unheard) -> Channel:
        """The channel of a map, which is passed on, too."""
        guard = self._guards[which]
        return Channel(name, store, relay=True, guard=guard.check, screen=guard.screen, on_change=on_change)

    def grant(self, robot: str, area: Bounds) -> bool:
        """Whether a robot may be interested in so much."""
        return tiles_in(area, self._tile_m) <= self._quotas.area_tiles

    def within(self, areas: Sequence[Bounds]) -> list[Bounds]:
        """The first of these, as many as may be of interest at once."""
        counts = accumulate(tiles_in(area, self._tile_m) for area in areas)
        return [area for area, tiles in zip(areas, counts, strict=True) if tiles <= self._quotas.all_area_tiles]

    def may_correct(self, sender: str, robot: str) -> bool:
        """Who may report a robot may say where it was; without keys, anybody."""
        return self._open or self._policy.allows(sender, robot)

    def hear(self, sender: str, kind: str, payload: bytes, now_ns: int) -> bool:
        """Where a robot says that it is, or was; whether the message was of that kind. Raises ValueError for others."""
        if kind == PLACE:
            place = decode_place(payload)
            for guard in self._guards:
                guard.place(sender, place.east_m, place.north_m, now_ns)
        elif kind == TRACK:
            track = decode_track(payload)
            places = np.reshape(np.array(track.places_m, np.float64), (-1, 2))
            for guard in self._guards:
                guard.track(sender, places, track.spacing_m)
        return kind in (PLACE, TRACK)


class Roll:
    """Who may report whom, by the `fleet.json` beside a station's keys, as it is by now: stations and relays."""

    def __init__(self, folder: Path) -> None:
        self._file = folder / "fleet.json"
        self._seen: tuple[int, int] | None = None
        self._stations: frozenset[str] = frozenset()
        self._reports: dict[str, frozenset[str]] = {}

    @property
    def exists(self) -> bool:
        """Those who only connect have none."""
        return self._file.exists()

    def allows(self, node: str, robot: str) -> bool:
        self._look()
        return node in self._reports and (node in self._stations or robot in self._reports[node])

    def _look(self) -> None:
        """What can't be read leaves what was before; the link tells of it."""
        try:
            status = self._file.stat()
            seen = (status.st_mtime_ns, status.st_ino)
            if seen != self._seen:
                self._read()
                self._seen = seen
        except (OSError, InputError):
            pass

    def _read(self) -> None:
        from terrafuse.keys.fleet import read_roster

        members = [member for member in read_roster(self._file).members if not member.revoked]
        self._stations = frozenset(member.name for member in members if member.station)
        self._reports = {member.name: frozenset({member.name, *member.relay_for}) for member in members}


def _guard(store: Store, quotas: QuotasPart, policy: Allows) -> Guard:
    cells = store.map.lattice.tile_cells**2
    guard = Guard(
        store.map,
        Quotas(
            message_bytes=Limits().message_bytes,
            message_cells=max(MESSAGE_CELLS, cells),
            bytes_per_s=quotas.bytes_per_s,
            tiles=quotas.tiles,
            reach_m=inf if quotas.distance_m is None else quotas.distance_m,
        ),
        policy,
    )
    for name in store.robots():
        guard.remember(name, store.revisions(name))
    return guard
