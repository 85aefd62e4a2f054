"""What no honest robot does, and what rare accidents do: nothing is overwritten, forgotten or decided by order."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from terrafuse.errors import InputError, StoreError
from terrafuse.exchange.delta import MAX_REVISION, Delta
from terrafuse.kernels import evidence
from terrafuse.lattice import MAX_CELL, Lattice
from terrafuse.mapper import Mapper
from terrafuse.models import make_model
from terrafuse.replica import Replica
from terrafuse.store.memory import MemoryStore
from terrafuse.types import Pose, Scan
from terrafuse.window import Tiles3x3

LATTICE = Lattice(1.0, 8.0)
MODEL = make_model("elevation")
S = 1_000_000_000


def look(z: float = 0.0, stamp_ns: int = 0, x: float = 0.0) -> Scan:
    points = np.random.default_rng(0).uniform(0, 8, (200, 3)) * (1, 1, 0) + (x, 0, z)
    return Scan(stamp_ns, points, Pose.identity())


def test_a_tile_takes_no_revision_twice() -> None:
    """Its list of changes has room for each cell once a revision."""
    observe, tile = MODEL.observer(LATTICE), MODEL.tile(LATTICE)
    observe(look()).merge_into([tile], 0, 5)
    tile.changed(5)
    with pytest.raises(InputError, match="revision 5 is not larger"):
        observe(look()).merge_into([tile], 0, 5)
    observe(look()).merge_into([tile], 0, 6)
    assert len(tile.changed(5)[0]) == len(tile.changed(0)[0])


def spoilt(store: MemoryStore, revision: int) -> None:
    """Cells of a revision that the robot never reported, as a damaged file would have them."""
    for cells in store._tiles["r1"].values():
        cells["revision"][cells["revision"] > 0] = revision


def test_a_store_with_cells_newer_than_the_robot_is_not_gone_on_from() -> None:
    store = MemoryStore(LATTICE, MODEL)
    mapper = Mapper("r1", LATTICE, MODEL, Tiles3x3(LATTICE), store)
    mapper.integrate(look())
    mapper.commit()
    spoilt(store, MAX_REVISION)
    again = Mapper("r1", LATTICE, MODEL, Tiles3x3(LATTICE), store)
    with pytest.raises(StoreError, match="cells newer than the robot's newest report, revision 1"):
        again.integrate(look())


def test_revisions_end_with_a_word() -> None:
    store = MemoryStore(LATTICE, MODEL)
    last = Delta(Mapper("r1", LATTICE, MODEL).delta().map, "r1", 0, MAX_REVISION, 0, ())
    store.accept(last)
    mapper = Mapper("r1", LATTICE, MODEL, Tiles3x3(LATTICE), store)
    with pytest.raises(InputError, match="the most there can be"):
        mapper.integrate(look())


def test_a_restarted_mapper_knows_its_newest_stamp() -> None:
    store = MemoryStore(LATTICE, MODEL)
    mapper = Mapper("r1", LATTICE, MODEL, Tiles3x3(LATTICE), store)
    for stamp_ns in (100 * S, 1300 * S):
        mapper.integrate(look(stamp_ns=stamp_ns))
    mapper.commit()
    again = Mapper("r1", LATTICE, MODEL, Tiles3x3(LATTICE), store)
    assert again.delta().stamp_ns == 1300 * S


def test_a_robot_that_began_afresh_under_its_old_name_is_read_the_same_in_any_order() -> None:
    deltas = []
    for z in (0.0, 5.0):
        mapper = Mapper("r1", LATTICE, MODEL)
        mapper.integrate(look(z))
        deltas.append(mapper.delta())
    digests = []
    for order in (deltas, deltas[::-1]):
        replica = Replica(LATTICE, MODEL)
        for delta in order:
            replica.apply(delta)
        digests.append(replica.digest())
    assert digests[0] == digests[1]


@pytest.mark.parametrize("kind", [np.int64, np.uint64])
def test_stamps_of_numpy_are_as_good(kind: type) -> None:
    stamp_ns = 1_760_000_000_123_456_789
    plain, given = Mapper("r1", LATTICE, MODEL), Mapper("r1", LATTICE, MODEL)
    plain.integrate(look(stamp_ns=stamp_ns))
    given.integrate(replace(look(), stamp_ns=kind(stamp_ns)))
    assert given.delta().identity == plain.delta().identity
    assert type(given.delta().stamp_ns) is int


@pytest.mark.parametrize("name", ["elevation", "terrain"])
def test_a_point_beyond_the_lattice_is_dropped_and_counted(name: str) -> None:
    """Millimetre cells end 1.0995e9 m from the origin; the sensor stands a kilometre before."""
    lattice = Lattice(0.001, 1.0)
    mapper = Mapper("r1", lattice, make_model(name, {"max_range_m": 1e8}))
    points = np.array([[0.0, 0.0, 0.0], [500.0, 0.0, 0.0], [2000.0, 0.0, 0.0], [9e7, 0.0, 0.0]])
    done = mapper.integrate(Scan(0, points, Pose.identity().shifted(MAX_CELL * 0.001 - 1000.0, 0.0)))
    assert done.dropped["beyond the lattice"] == 2
    replica = Replica(lattice, mapper.model)
    assert replica.apply(mapper.delta())


@pytest.mark.parametrize("name", ["elevation", "terrain"])
def test_ranges_end_where_squares_still_make_sense(name: str) -> None:
    with pytest.raises(InputError, match="max ≤ 1e8"):
        make_model(name, {"max_range_m": 1e30})


def test_a_cell_that_has_seen_enough_keeps_what_it_knows() -> None:
    """2³¹ points at 1 m and as many again would count to 0, which is the unknown cell."""
    z = int(evidence.ticks(1.0))
    n = 2**31
    square = n * z * z
    record = np.zeros(1, evidence.EVIDENCE)
    record[0] = (n, z, z, square >> 64, n * z, square & (2**64 - 1))
    own = record.copy()
    for _ in range(3):
        evidence.add.py_func(own.view(np.recarray)[0], record.view(np.recarray)[0])
    assert own["n"][0] == n
    assert evidence.mean_m(own)[0] == pytest.approx(1.0)
