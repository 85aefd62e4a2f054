"""What of each model's cells travels: `PROFILES[model][profile]`, the leanest first. Cells that a robot reports as they
are travel `exact`, and so do those of models that have no profiles; give yours some with
`PROFILES["mine"] = {"lean": Profile(...)}`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from terrafuse.errors import InputError
from terrafuse.exchange.delta import Delta
from terrafuse.exchange.erased import erased
from terrafuse.exchange.profiles import elevation, grey, occupancy, terrain
from terrafuse.exchange.profiles.base import Profile, Quantity
from terrafuse.lattice import Lattice
from terrafuse.models.base import Model
from terrafuse.tile import opaque
from terrafuse.types import Array

PROFILES: dict[str, dict[str, Profile]] = {
    "elevation": elevation.PROFILES,
    "grey": grey.PROFILES,
    "occupancy": occupancy.PROFILES,
    "terrain": terrain.PROFILES,
}

EXACT = "exact"
CODES = {EXACT: 0, "full": 1, "lean": 2}
"""Of profiles, in messages."""


def report(delta: Delta, profile: str, model: Model) -> Delta:
    """The delta, of this model, as a robot reports it by this profile: its cells rounded (`Profile.report`), or as they
    are: `exact`, or a model without this profile.

    To be done once, where a robot reports, before its own replica takes the delta in; again changes nothing. The codec
    sees by the cells how short it can be: it is told nothing. Raises InputError for a profile that there is not.
    """
    if profile not in CODES:
        raise InputError(f"no profile '{profile}' of what travels; there are: {', '.join(CODES)}")
    found = PROFILES.get(delta.map.model, {}).get(profile)
    if found is None:
        return delta
    lattice = delta.map.lattice
    tiles = (replace(tile, cells=_reported(found, tile.cells, model, lattice)) for tile in delta.tiles)
    return replace(delta, tiles=tuple(tiles))


def _reported(profile: Profile, cells: Array, model: Model, lattice: Lattice) -> Array:
    """Rounded, but for erased cells, of which there is nothing to round."""
    gone = erased(cells)
    if not gone.any():
        return profile.report(cells, model, lattice)
    out = cells.copy()
    opaque(out)[~gone] = opaque(profile.report(np.ascontiguousarray(cells[~gone]), model, lattice))
    return out


__all__ = ["CODES", "EXACT", "PROFILES", "Profile", "Quantity", "report"]
