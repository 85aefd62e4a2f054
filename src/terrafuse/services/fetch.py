"""Brings a part of a station's map here: its tiles at full resolution, or a picture that it draws."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import msgspec

from terrafuse.errors import InputError
from terrafuse.exchange.asking import Question
from terrafuse.exchange.codec import decode
from terrafuse.exchange.delta import MapId
from terrafuse.lattice import Lattice
from terrafuse.models import make_model
from terrafuse.models.base import Layer
from terrafuse.replica import Replica
from terrafuse.services.operator import Operator
from terrafuse.types import Bounds, TileKey
from terrafuse.views import known_window

MOST_TILES = 1024


@dataclass(frozen=True)
class Fetched:
    replica: Replica
    area: Bounds
    tiles: int
    """That were asked for."""
    nbytes: int
    """That came."""


def map_of(state: Mapping[str, Any], channel: str) -> Replica:
    """An empty replica of a station's map, by what its map manager shows."""
    about = MapId(**state["map"])
    cells_m = state["cells_m"]
    if channel not in cells_m:
        raise InputError(f"there is no map '{channel}' at the station; there are: {', '.join(cells_m)}")
    lattice = Lattice(cells_m[channel], about.tile_m, about.crs)
    return Replica(lattice, make_model(about.model, state["settings"]))


def extent(asking: Operator, channel: str) -> Bounds:
    """Of all that the station holds of it. Raises InputError where that is nothing."""
    (answer,) = asking.ask([Question(what="extent", channel=channel)])
    found = msgspec.msgpack.decode(answer, type=Bounds | None)
    if found is None:
        raise InputError("the station's map is empty: no robot has reported a cell")
    return found


def fetch(asking: Operator, whole: Replica, channel: str, layer: Layer, area: Bounds | None) -> Fetched:
    """The tiles that an area needs to show a layer. Raises InputError for too many, and where nobody saw any of it."""
    covered = extent(asking, channel)
    area = area or covered
    keys = _keys(whole, area, layer.halo)
    nbytes = 0
    for answer in asking.ask([Question(what="tile", channel=channel, x=key.x, y=key.y) for key in keys]):
        nbytes += len(answer)
        whole.apply(decode(answer, whole.model.cell))
    if not _anything(whole, area):
        raise InputError(f"nobody has seen anything in {tuple(area)}; the station's map covers {tuple(covered)}")
    return Fetched(whole, area, len(keys), nbytes)


def sketch(asking: Operator, channel: str, layer: str, area: Bounds | None) -> tuple[bytes, Bounds]:
    """A picture of it as the station draws it, and of what."""
    area = area or extent(asking, channel)
    (picture,) = asking.ask([Question(what="picture", channel=channel, layer=layer, area=area)])
    return picture, area


def _anything(replica: Replica, area: Bounds) -> bool:
    known, asked = known_window(replica), replica.lattice.cell_window(area)
    return known is not None and all(known[k] < asked[k + 2] and asked[k] < known[k + 2] for k in range(2))


def _keys(replica: Replica, area: Bounds, halo: int) -> list[TileKey]:
    side = replica.lattice.tile_cells
    i0, j0, i1, j1 = replica.lattice.cell_window(area)
    columns = range((i0 - halo) // side, (i1 - 1 + halo) // side + 1)
    rows = range((j0 - halo) // side, (j1 - 1 + halo) // side + 1)
    if len(columns) * len(rows) > MOST_TILES:
        raise InputError(
            f"{tuple(area)} is {len(columns)}×{len(rows)} tiles; {MOST_TILES} at most are asked for at once: give a "
            "smaller --area, or --map coarse where there is one"
        )
    return [TileKey(x, y) for x in columns for y in rows]
