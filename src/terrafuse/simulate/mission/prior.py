"""What is known before a mission: that there are buildings, of a height that somebody guessed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from terrafuse.exchange.delta import Delta, TileCells, map_id
from terrafuse.lattice import Lattice
from terrafuse.models.base import Model
from terrafuse.prior import ROBOT, open_prior
from terrafuse.replica import Replica
from terrafuse.simulate.blocks import corners_of
from terrafuse.simulate.houses import house_blocks
from terrafuse.simulate.world import World
from terrafuse.store.memory import MemoryStore
from terrafuse.tile import opaque

CONFIDENCE = 0.1
FILE = "prior.geojson"


def write_buildings(world: World, height_m: float, path: Path) -> None:
    """GeoJSON: each building's outline, with `height_m` above the ground at its middle, as z."""
    features = []
    for house in world.houses:
        for block in house_blocks(house, world.terrain):
            ring = corners_of(block)[[0, 1, 2, 3, 0], :2].round(3).tolist()
            z = round(float(world.terrain.height(house.x_m, house.y_m)) + height_m, 3)
            properties = {"height_m": z, "confidence": CONFIDENCE}
            features.append(
                {"type": "Feature", "properties": properties, "geometry": {"type": "Polygon", "coordinates": [ring]}}
            )
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}) + "\n")


def prior_store(path: Path, lattice: Lattice, model: Model) -> MemoryStore:
    """The prior's contribution on a lattice."""
    store = MemoryStore(lattice, model)
    for delta in open_prior([str(path)]).deltas(lattice, model):
        store.accept(delta)
    return store


def coarse_prior(store: MemoryStore, factor: int) -> Delta:
    """The same at a coarser level, as one delta."""
    replica = Replica(store=store, factor=factor)
    tiles = []
    for key in replica.keys:
        cells = replica.cells(key).reshape(-1)
        at = np.flatnonzero(replica.model.known(cells)).astype(np.int32)
        if len(at):
            tiles.append(TileCells(key, at, opaque(cells)[at].view(cells.dtype)))
    return Delta(map_id(replica.model.name, replica.lattice), ROBOT, 0, 1, 0, tuple(tiles))
