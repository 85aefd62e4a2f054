"""What every store must do."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from terrafuse.errors import DeltaError
from terrafuse.exchange.codec import encode
from terrafuse.exchange.delta import Delta
from terrafuse.exchange.profiles import report
from terrafuse.lattice import Lattice
from terrafuse.models import make_model
from terrafuse.replica import Replica
from terrafuse.store.base import PathPoint, Store
from terrafuse.testing.deltas import deltas_of, random_scans
from terrafuse.types import Pose, TileKey

LATTICE = Lattice(0.5, 4.0)
MODEL = make_model("elevation")


class StoreTests:
    """Subclass, and define the fixture `store`: an empty store of LATTICE and MODEL."""

    @pytest.fixture
    def store(self) -> Iterator[Store]:
        raise NotImplementedError

    def test_starts_empty(self, store: Store) -> None:
        assert store.robots() == []
        assert store.keys() == []
        assert store.revision("r1") == 0
        assert store.history() == []
        assert store.poses("r1") == []

    def test_holds_what_a_mapper_reported(self, store: Store) -> None:
        deltas = deltas_of("r1", random_scans(1, 6), LATTICE, MODEL)
        for delta in deltas:
            assert store.accept(delta)
        (whole,) = deltas_of("r1", random_scans(1, 6), LATTICE, MODEL, every=6)
        assert store.keys() == [tile.key for tile in whole.tiles]
        for tile in whole.tiles:
            held = store.load("r1", tile.key)
            assert held is not None
            np.testing.assert_array_equal(held.at, tile.at)
            np.testing.assert_array_equal(held.cells, tile.cells)
        assert store.revision("r1") == 6
        assert store.revisions("r1") == {tile.key: int(tile.cells["revision"].max()) for tile in whole.tiles}
        assert [entry.revision for entry in store.history()] == [1, 2, 3, 4, 5, 6]

    def test_pieces_lead_nowhere(self, store: Store) -> None:
        first, second, third = deltas_of("r1", random_scans(1, 3), LATTICE, MODEL)
        assert store.level("r1") == 0
        store.accept(first)
        store.accept(replace(third, since=3))
        assert (store.revision("r1"), store.level("r1")) == (3, 1)
        store.accept(second)
        assert store.level("r1") == 2
        store.accept(Delta(third.map, "r1", 2, 3, third.stamp_ns, ()))
        assert (store.revision("r1"), store.level("r1")) == (3, 3)

    def test_order_and_repetition_make_no_difference(self, store: Store) -> None:
        deltas = deltas_of("r1", random_scans(2, 5), LATTICE, MODEL) + deltas_of(
            "r2", random_scans(3, 5), LATTICE, MODEL
        )
        expected = Replica(LATTICE, MODEL)
        for delta in deltas:
            expected.apply(delta)
        for delta in [deltas[k] for k in (7, 3, 0, 9, 9, 1, 8, 2, 4, 6, 5, 0, 3)]:
            store.accept(delta)
        assert Replica(store=store).digest() == expected.digest()

    def test_says_when_a_delta_is_there_already(self, store: Store) -> None:
        (delta,) = deltas_of("r1", random_scans(4, 1), LATTICE, MODEL)
        assert store.accept(delta)
        assert not store.accept(delta)
        assert len(store.history()) == 1

    @pytest.mark.parametrize("profile", ["exact", "full"])
    def test_messages_are_as_good_as_cells(self, store: Store, profile: str) -> None:
        deltas = [report(delta, profile, MODEL) for delta in deltas_of("r1", random_scans(4, 6, 6.0), LATTICE, MODEL)]
        expected = Replica(LATTICE, MODEL)
        for delta in deltas:
            expected.apply(delta)
        for k in (3, 0, 5, 1, 1, 4, 2, 5):
            store.accept(deltas[k], message=encode(deltas[k]))
        assert Replica(store=store).digest() == expected.digest()
        assert len(store.history()) == 6

    def test_what_is_accepted_together_is_there(self, store: Store) -> None:
        deltas = deltas_of("r1", random_scans(4, 6), LATTICE, MODEL)
        store.accept(deltas[0])
        with store.together():
            for delta in deltas[1:4]:
                assert store.accept(delta, message=encode(delta))
            with pytest.raises(DeltaError):
                store.accept(replace(deltas[5], since=9))
            assert not store.accept(deltas[0])
            assert store.revision("r1") == 4
        assert store.accept(deltas[4])
        expected = Replica(LATTICE, MODEL)
        for delta in deltas[:5]:
            expected.apply(delta)
        assert Replica(store=store).digest() == expected.digest()

    def test_refuses_a_delta_of_another_map(self, store: Store) -> None:
        (delta,) = deltas_of("r1", random_scans(5, 1), Lattice(0.25, 4.0), MODEL)
        with pytest.raises(DeltaError, match=r"resolution_m=0\.25"):
            store.accept(delta)
        assert store.keys() == []
        assert store.history() == []

    def test_parts_of_one_delta_are_different_deltas(self, store: Store) -> None:
        (delta,) = deltas_of("r1", random_scans(8, 1), LATTICE, MODEL)
        for tile in delta.tiles:
            for some in (slice(0, 1), slice(1, None)):
                part = replace(tile, at=tile.at[some], cells=tile.cells[some])
                if len(part.at):
                    assert store.accept(replace(delta, tiles=(part,)))
        whole = Replica(LATTICE, MODEL)
        whole.apply(delta)
        assert Replica(store=store).digest() == whole.digest()

    def test_a_replica_follows_its_store(self, store: Store) -> None:
        first, second = deltas_of("r1", random_scans(8, 2), LATTICE, MODEL)
        replica = Replica(store=store)
        store.accept(first)
        before = replica.digest()
        store.accept(second)
        assert replica.digest() == Replica(store=store).digest() != before

    def test_refuses_what_no_mapper_makes(self, store: Store) -> None:
        (delta,) = deltas_of("r1", random_scans(9, 1), LATTICE, MODEL)
        tile = delta.tiles[0]
        for bad in (
            replace(tile, key=TileKey(2**62, 0)),
            replace(tile, key=TileKey(0, 0, 3)),
            replace(tile, at=tile.at[::-1]),
            replace(tile, at=tile.at[:0], cells=tile.cells[:0]),
        ):
            with pytest.raises(DeltaError):
                store.accept(replace(delta, tiles=(bad,)))
        with pytest.raises(DeltaError, match="do not rise"):
            store.accept(replace(delta, tiles=(tile, tile)))
        assert store.keys() == []

    def test_keeps_poses_in_stamp_order(self, store: Store) -> None:
        first, second = deltas_of("r1", random_scans(6, 2), LATTICE, MODEL)
        store.accept(second, [PathPoint(7, Pose.identity().shifted(1, 2, 3))])
        store.accept(first, [PathPoint(3, Pose.identity())])
        (third,) = deltas_of("r1", random_scans(7, 1), LATTICE, MODEL)
        store.accept(third, [PathPoint(3, Pose.identity().shifted(9, 9))])  # a stamp that is there already
        assert [point.stamp_ns for point in store.poses("r1")] == [3, 7]
        np.testing.assert_array_equal(store.poses("r1")[0].T_world_sensor.position, [0, 0, 0])
        np.testing.assert_array_equal(store.poses("r1")[1].T_world_sensor.position, [1, 2, 3])
