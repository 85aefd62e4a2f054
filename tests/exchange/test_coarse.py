"""A robot's map at a coarser lattice: what it reports is what its map, coarsened, holds, however it gets there."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from terrafuse.errors import LatticeError
from terrafuse.exchange.coarse import CoarseContribution, delta_since
from terrafuse.exchange.codec import decode, encode
from terrafuse.exchange.delta import Delta, check_content
from terrafuse.exchange.own import LIFE, Own
from terrafuse.exchange.parts import oldest
from terrafuse.lattice import Lattice
from terrafuse.mapper import Mapper
from terrafuse.models import Model, make_model
from terrafuse.replica import Replica
from terrafuse.store.memory import MemoryStore
from terrafuse.testing.deltas import SECOND_NS, deltas_of, random_scans, scan_of
from terrafuse.testing.scans import KINDS, mixed_scans
from terrafuse.types import Scan, TileKey
from terrafuse.window import WINDOWS

LATTICE = Lattice(0.5, 4.0)
ELEVATION = make_model("elevation")
MODELS = {
    "elevation": ELEVATION,
    "terrain": make_model("terrain"),
    "occupancy": make_model("occupancy"),
    "grey": make_model("grey", {"opening_angle_rad": math.radians(25)}),
}


def scans_for(model: Model, seed: int, count: int) -> list[Scan]:
    kinds = (KINDS["sonar"],) if model.name == "grey" else tuple(KINDS.values())
    return mixed_scans(seed, count, kinds)


def followed(own: CoarseContribution, mapper: Mapper, scans: Sequence[Scan], arrives: Sequence[bool]) -> list[Delta]:
    """The deltas that arrive, one at most after each scan, each since what arrived last; the last one does arrive."""
    out, since = [], 0
    for scan, good in zip(scans, [*arrives[:-1], True], strict=True):
        mapper.integrate(scan)
        own.update()
        delta = own.delta(since)
        check_content(delta)
        if good:
            out.append(delta)
            since = delta.revision
    return out


@pytest.mark.parametrize("model_name", MODELS)
@settings(max_examples=25)
@given(seed=st.integers(0, 2**31), factor=st.sampled_from([2, 4, 8]), data=st.data())
def test_a_replica_of_what_arrived_is_the_fine_contributions_coarsened(
    model_name: str, seed: int, factor: int, data: st.DataObject
) -> None:
    model = MODELS[model_name]
    fine, coarse = Replica(LATTICE, model), Replica(LATTICE.coarser(factor), model)
    arrived = []
    for robot in ("r1", "r2"):
        mapper = Mapper(robot, LATTICE, model)
        own = CoarseContribution(mapper, factor)
        scans = scans_for(model, seed + len(arrived), 6)
        arrived += followed(own, mapper, scans, data.draw(st.lists(st.booleans(), min_size=6, max_size=6)))
        fine.apply(mapper.delta())
    for delta in data.draw(st.permutations(arrived + data.draw(st.lists(st.sampled_from(arrived), max_size=5)))):
        coarse.apply(decode(encode(delta), model.cell))
    expected = Replica(store=fine.store, factor=factor)
    assert coarse.digest() == expected.digest()
    assert coarse.reading == expected.reading
    for key in expected.keys:
        np.testing.assert_array_equal(coarse.cells(key), expected.cells(key))


def test_only_cells_that_changed_are_told_again() -> None:
    mapper = Mapper("r1", LATTICE, ELEVATION)
    own = CoarseContribution(mapper, 2)
    mapper.integrate(scan_of([[0.2, 0.2, 1.0], [3.2, 0.2, 1.0]]))
    assert own.update() == 2
    mapper.integrate(scan_of([[0.2, 0.2, 1.0]], SECOND_NS))
    assert own.update() == 1
    mapper.integrate(scan_of(np.empty((0, 3)), 2 * SECOND_NS))
    assert own.update() == 0
    assert own.update() == 0
    delta = own.delta(1)
    assert (delta.since, delta.revision, delta.stamp_ns) == (1, 3, 2 * SECOND_NS)
    # Cells (0, 0) and (3, 0) of the coarse lattice, 4 a side; only the first one changed after revision 1, in 2.
    (tile,) = delta.tiles
    assert (tile.key, tile.at.tolist(), tile.cells["revision"].tolist()) == (TileKey(0, 0), [0], [2])
    assert own.delta().tiles[0].cells["revision"].tolist() == [2, 1]
    assert own.delta(2).tiles == ()


def test_asking_leaves_no_way_into_what_is_held() -> None:
    mapper = Mapper("r1", LATTICE, ELEVATION)
    own = CoarseContribution(mapper, 2)
    mapper.integrate(scan_of([[0.2, 0.2, 1.0]]))
    own.update()
    own.delta().tiles[0].cells["n"] = 99
    assert own.delta().tiles[0].cells["n"].tolist() == [1]


def test_it_follows_a_mapper_whose_tiles_leave_its_memory() -> None:
    """Updates come rarely: by then tiles have left the window, and are read from the archive."""
    along = [np.array([2.0 * k, 0, 0]) for k in range(12)]
    here = random_scans(3, 12, 6.0)
    scans = [scan_of(scan.points + shift, scan.stamp_ns) for scan, shift in zip(here, along, strict=True)]
    store = MemoryStore(LATTICE, ELEVATION)
    paged = Mapper("r1", LATTICE, ELEVATION, WINDOWS["tiles3x3"](LATTICE), store)
    whole = Mapper("r1", LATTICE, ELEVATION)
    own, expected = CoarseContribution(paged, 4), CoarseContribution(whole, 4)
    for scan in scans:
        paged.integrate(scan)
        whole.integrate(scan)
    assert paged.paging.evictions > 0
    assert own.update() == expected.update()
    assert own.delta().identity == expected.delta().identity
    # A robot that goes on after a restart reports the same cells, with the revision of its restart.
    paged.commit()
    again = CoarseContribution(Mapper("r1", LATTICE, ELEVATION, archive=store), 4)
    again.update()
    replicas = [Replica(LATTICE.coarser(4), ELEVATION) for _ in range(2)]
    for replica, one in zip(replicas, (own, again), strict=True):
        replica.apply(one.delta())
    assert replicas[0].digest() == replicas[1].digest()


def test_a_factor_divides_the_tile() -> None:
    with pytest.raises(LatticeError, match="factor 3 does not divide the 8 cells"):
        CoarseContribution(Mapper("r1", LATTICE, ELEVATION), 3)


# --- parts of deltas -------------------------------------------------------------------------------------------------


def states(delta: Delta) -> dict[tuple[TileKey, int], bytes]:
    return {
        (tile.key, int(at)): cell.tobytes()
        for tile in delta.tiles
        for at, cell in zip(tile.at, tile.cells, strict=True)
    }


@given(seed=st.integers(0, 2**31), since=st.integers(0, 8))
@settings(max_examples=30)
def test_what_a_store_tells_of_a_robot_is_what_the_robot_told(seed: int, since: int) -> None:
    scans = random_scans(seed, 8)
    store = MemoryStore(LATTICE, ELEVATION)
    for delta in deltas_of("r1", scans, LATTICE, ELEVATION, every=3):
        store.accept(delta)
    mapper = Mapper("r1", LATTICE, ELEVATION)
    for scan in scans:
        mapper.integrate(scan)
    told, expected = delta_since(store, "r1", since), mapper.delta(since)
    check_content(told)
    assert told.identity == expected.identity
    assert (told.map, told.stamp_ns) == (expected.map, expected.stamp_ns)


@given(seed=st.integers(0, 2**31), most=st.integers(1, 60))
@settings(max_examples=30)
def test_a_delta_in_parts_is_the_delta(seed: int, most: int) -> None:
    mapper = Mapper("r1", LATTICE, ELEVATION)
    for scan in random_scans(seed, 8, points=10):
        mapper.integrate(scan)
    whole, since, together = mapper.delta(), 0, {}
    while since < whole.revision:
        part = oldest(mapper.delta(since), most)
        check_content(part)
        assert part.since == since < part.revision
        revisions = {int(revision) for tile in part.tiles for revision in tile.cells["revision"]}
        assert part.cell_count <= most or len(revisions) == 1
        together |= states(part)
        since = part.revision
    assert together == states(whole)
    assert part.stamp_ns == whole.stamp_ns


# --- lives -----------------------------------------------------------------------------------------------------------


def test_a_later_life_counts_on_from_beyond_what_others_hold() -> None:
    mapper = Mapper("r1", LATTICE, ELEVATION)
    own = Own(mapper)
    own.begin(0)
    assert own.surpass(40)
    assert not own.surpass(40)
    assert own.revision == 0
    mapper.integrate(scan_of([[0.2, 0.2, 1.0]]))
    mapper.integrate(scan_of([[2.2, 0.2, 1.0]], 1))
    first, second = LIFE + 1, LIFE + 2
    assert own.revision == second
    for since, revisions in ((0, [first, second]), (40, [first, second]), (first, [second]), (second, [])):
        delta = own.delta(since)
        check_content(delta)
        assert (delta.since, delta.revision) == (since, second)
        assert [int(r) for tile in delta.tiles for r in tile.cells["revision"]] == revisions
    # The mapper's own cells stay as they were.
    assert mapper.delta().tiles[0].cells["revision"].tolist() == [1, 2]


def test_a_life_is_not_counted_on_from_its_own_reports_nor_into_impossible_numbers() -> None:
    mapper = Mapper("r1", LATTICE, ELEVATION)
    own = Own(mapper)
    own.begin(0)
    mapper.integrate(scan_of([[0.2, 0.2, 1.0]]))
    own.tell(1)
    for revision in (0, 1, 2**32 - 1):
        assert not own.surpass(revision)
    assert own.delta(0).identity == mapper.delta(0).identity


def test_what_was_not_told_in_this_life_is_of_another_one() -> None:
    """It made 30 scans out of reach before it hears that others hold 20, which it can't have told them."""
    mapper = Mapper("r1", LATTICE, ELEVATION)
    own = Own(mapper)
    own.begin(0)
    for k in range(30):
        mapper.integrate(scan_of([[0.2, 0.2, 1.0]], k))
    assert own.surpass(20)
    assert own.revision == LIFE + 30


@pytest.mark.parametrize(("held", "expected"), [(0, 3), (2, 3), (3, 3), (4, LIFE + 3), (LIFE + 3, LIFE + 3),
                                                (LIFE + 4, 2 * LIFE + 3)])  # fmt: skip
def test_who_kept_its_map_goes_on_where_it_was(held: int, expected: int) -> None:
    """Three scans are in its map, and so many of its own reports in its store; who has more of them lost some."""
    mapper = Mapper("r1", LATTICE, ELEVATION)
    for k in range(3):
        mapper.integrate(scan_of([[0.2, 0.2, 1.0]], k))
    own = Own(mapper)
    own.begin(held)
    assert own.revision == expected
    assert not own.surpass(held)
