"""What every cell model must do."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import is_dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from terrafuse.errors import InputError
from terrafuse.exchange.codec import decode, encode
from terrafuse.exchange.delta import Delta
from terrafuse.lattice import Lattice
from terrafuse.mapper import Mapper
from terrafuse.models import make_model
from terrafuse.models.base import Model, fold
from terrafuse.models.layers import layers_of
from terrafuse.replica import Replica
from terrafuse.store.memory import MemoryStore
from terrafuse.testing.deltas import deltas_of
from terrafuse.testing.layers import LATTICE, check_layer, sample_map
from terrafuse.testing.scans import mixed_scans
from terrafuse.types import Array, Scan, TileKey
from terrafuse.window import Area, rectangle

NAN, INF = float("nan"), float("inf")
NOT_FINITE = [(NAN, NAN, NAN), (NAN, 0, 0), (0, NAN, 0), (0, 0, NAN), (INF, 0, 0), (0, -INF, 0), (0, 0, INF)]
NO_RETURNS = np.array([*NOT_FINITE, (1e15, 0, 0), (0, -1e300, 0)])
"""Rows of `points` that are no measurement: not finite, or beyond any lattice."""

Law = Callable[..., None]


def for_many_seeds(law: Law) -> Law:
    """Run a law on 10 random seeds, and tell the simplest that breaks it."""
    checks = [HealthCheck.function_scoped_fixture, HealthCheck.differing_executors, HealthCheck.too_slow]
    return settings(max_examples=10, deadline=None, suppress_health_check=checks)(
        given(seed=st.integers(0, 2**32 - 1))(law)
    )


class ModelTests:
    """Subclass, and define the fixture `model`: one with settings other than the defaults tests them, too.

    What a model claims beyond the laws of all stands in the attributes.
    """

    lattice: Lattice = LATTICE
    """0.5 m cells in tiles of 8×8. Cells of another size need `scans` of another extent."""
    fuse_commutes = True
    """fuse(a, b) is fuse(b, a). False: which report is newer counts, and the fold's order (stamp, robot) decides."""
    fuse_associates = False
    """fuse(fuse(a, b), c) is fuse(a, fuse(b, c)), as where evidence adds."""
    fuse_is_idempotent = False
    """fuse(a, a) is a, as where cells are bounds or the best of several; where evidence adds, it is not."""
    coarsen_composes = False
    """coarsen(coarsen(cells, k), m) is coarsen(cells, k·m)."""
    changes_restamp = True
    """What a scan changed carries its stamp. False: it may leave an older one, as where it only casts doubt."""
    gaps: frozenset[str] = frozenset()
    """Layers (or the name of `occupied`) that may be NaN also where the cell is known."""
    tolerance = 0.0
    """How far floating fields may be off in the laws of this list, relative and absolute; 0: the same in every bit."""

    @pytest.fixture
    def model(self) -> Model:
        raise NotImplementedError

    def scans(self, seed: int, count: int) -> list[Scan]:
        """What a robot sees, the same for the same seed; override it where the model wants sensors of one kind."""
        return mixed_scans(seed, count)

    # The record

    def test_a_record_is_flat_and_says_when(self, model: Model) -> None:
        cell = model.cell
        assert cell.names, "the dtype of a cell has named fields"
        assert (cell["stamp"], cell["revision"]) == (np.dtype(np.int64), np.dtype(np.uint32))
        assert all(cell[name].kind in "iufb" for name in cell.names), "fields are plain numbers"
        assert all(cell[name].isnative for name in cell.names)

    def test_zeros_are_unknown(self, model: Model) -> None:
        for shape in ((0,), (5,), (3, 4)):
            known = model.known(np.zeros(shape, model.cell))
            assert (known.shape, known.dtype) == (shape, np.dtype(bool))
            assert not known.any()

    # Observe and merge

    @for_many_seeds
    def test_a_patch_says_what_it_touches(self, model: Model, seed: int) -> None:
        observe = model.observer(self.lattice)
        for scan in self.scans(seed, 3):
            patch = observe(scan)
            assert len(set(patch.keys)) == len(patch.keys), "each tile once"
            tiles = [model.tile(self.lattice) for _ in patch.keys]
            patch.merge_into(tiles, scan.stamp_ns, 1)
            changed = [tile.changed(0)[0] for tile in tiles]
            assert all((np.diff(at) > 0).all() and len(at) for at in changed), "positions rise; no tile in vain"
            assert sum(map(len, changed)) == patch.cells
            assert all(tile.revision == 1 and tile.nbytes > 0 for tile in tiles)

    @for_many_seeds
    def test_what_a_scan_changed_is_known_and_carries_its_revision(self, model: Model, seed: int) -> None:
        mapper = Mapper("r", self.lattice, model)
        for scan in self.scans(seed, 4):
            revision = mapper.integrate(scan).revision
            for tile in mapper.delta(revision - 1).tiles:
                assert (tile.cells["revision"] == revision).all()
                stamped = np.equal if self.changes_restamp else np.less_equal
                assert stamped(tile.cells["stamp"], scan.stamp_ns).all()
                assert model.known(tile.cells).all(), "a cell that was reported must be known"
                assert model.check(tile.cells) is None, "what a mapper reports must pass the model's own check"

    @for_many_seeds
    def test_the_same_scans_make_the_same_bytes(self, model: Model, seed: int) -> None:
        one, two = (self._map(model, self.scans(seed, 4)).delta() for _ in range(2))
        assert encode(one) == encode(two)

    @for_many_seeds
    def test_rows_without_a_return_change_nothing(self, model: Model, seed: int) -> None:
        clean, dirty = Mapper("r", self.lattice, model), Mapper("r", self.lattice, model)
        for scan in self.scans(seed, 3):
            scan = replace(scan, origins=None, points=scan.points.astype(np.float64))
            where = np.sort(np.random.default_rng(seed).integers(0, len(scan.points) + 1, len(NO_RETURNS)))
            clean.integrate(scan)
            done = dirty.integrate(replace(scan, points=np.insert(scan.points, where, NO_RETURNS, axis=0)))
            assert sum(done.dropped.values()) >= len(NO_RETURNS), f"what is dropped is counted, not {done.dropped}"
        assert encode(dirty.delta()) == encode(clean.delta())

    @for_many_seeds
    def test_a_scan_of_nothing_changes_nothing(self, model: Model, seed: int) -> None:
        mapper = self._map(model, self.scans(seed, 2))
        before = mapper.delta()
        for points in (np.empty((0, 3)), np.full((4, 3), NAN)):
            done = mapper.integrate(replace(self.scans(seed, 1)[0], points=points, misses=None, origins=None))
            assert (done.cells, done.tiles) == (0, 0)
        assert _content(mapper.delta()) == _content(before)

    # Deltas

    @for_many_seeds
    def test_a_delta_holds_what_changed_since_as_absolute_states(self, model: Model, seed: int) -> None:
        mapper = Mapper("r", self.lattice, model)
        for k, scan in enumerate(self.scans(seed, 5)):
            mapper.integrate(scan)
            mapper.delta(k // 2)  # asking changes nothing, whatever is asked for next
        whole = _states(mapper.delta())
        for since in (3, 0, 4, 1, 5):
            newer = {place: cell for place, cell in whole.items() if cell["revision"] > since}
            assert _states(mapper.delta(since)) == newer

    @for_many_seeds
    def test_a_delta_stays_as_it_was(self, model: Model, seed: int) -> None:
        first, *rest = self.scans(seed, 3)
        mapper = self._map(model, [first])
        delta = mapper.delta()
        before = encode(delta)
        for scan in rest:
            mapper.integrate(scan)
        mapper.delta()
        assert encode(delta) == before

    @for_many_seeds
    def test_a_delta_survives_its_bytes(self, model: Model, seed: int) -> None:
        delta = self._map(model, self.scans(seed, 4)).delta()
        assert decode(encode(delta), model.cell).identity == delta.identity

    @for_many_seeds
    def test_paging_and_restarting_change_nothing(self, model: Model, seed: int) -> None:
        scans = self.scans(seed, 5)
        archive = MemoryStore(self.lattice, model)
        mapper = Mapper("r", self.lattice, model, _OneTile(self.lattice), archive)
        for k, scan in enumerate(scans):
            mapper.integrate(scan)
            if k == 2:
                mapper.commit()
                mapper = Mapper("r", self.lattice, model, _OneTile(self.lattice), archive)
        assert encode(mapper.delta()) == encode(self._map(model, scans).delta())

    # Fuse, and the fold

    @for_many_seeds
    def test_unknown_is_neutral_to_fuse(self, model: Model, seed: int) -> None:
        (cells,) = self._cells(model, seed, 1)
        nothing = np.zeros_like(cells)
        _same(model.fuse(cells, nothing, self.lattice), cells)
        _same(model.fuse(nothing, cells, self.lattice), cells)

    @for_many_seeds
    def test_fuse_is_a_function_of_two_cells(self, model: Model, seed: int) -> None:
        """The same for each cell whatever stands beside it, and it leaves its arguments alone."""
        older, newer = self._cells(model, seed, 2)
        before = older.tobytes(), newer.tobytes()
        fused = model.fuse(older, newer, self.lattice)
        assert (older.tobytes(), newer.tobytes()) == before
        assert (fused.dtype, fused.shape) == (model.cell, older.shape)
        some = np.random.default_rng(seed).permutation(len(older))[: len(older) // 2]
        _same(model.fuse(older[some], newer[some], self.lattice), fused[some])
        np.testing.assert_array_equal(model.known(fused), model.known(older) | model.known(newer))

    @for_many_seeds
    def test_fuse_commutes(self, model: Model, seed: int) -> None:
        _claimed(self.fuse_commutes, "fuse_commutes")
        a, b = self._cells(model, seed, 2)
        _same(model.fuse(a, b, self.lattice), model.fuse(b, a, self.lattice), self.tolerance)

    @for_many_seeds
    def test_fuse_associates(self, model: Model, seed: int) -> None:
        _claimed(self.fuse_associates, "fuse_associates")
        a, b, c = self._cells(model, seed, 3)
        left = model.fuse(model.fuse(a, b, self.lattice), c, self.lattice)
        _same(left, model.fuse(a, model.fuse(b, c, self.lattice), self.lattice), self.tolerance)

    @for_many_seeds
    def test_fuse_is_idempotent(self, model: Model, seed: int) -> None:
        _claimed(self.fuse_is_idempotent, "fuse_is_idempotent")
        (a,) = self._cells(model, seed, 1)
        _same(model.fuse(a, a, self.lattice), a, self.tolerance)

    @for_many_seeds
    def test_the_fold_takes_robots_by_stamp_then_name(self, model: Model, seed: int) -> None:
        """Cell by cell it is `fuse` over those who know the cell, in that order; by name where a model says so."""
        robots = self._cells(model, seed, 3)
        folded = fold(model, robots, self.lattice)
        by_stamp = not model.fold_by_name
        for k in np.random.default_rng(seed).integers(0, len(folded), 10):
            one = [cells[k : k + 1] for cells in robots if model.known(cells[k : k + 1])[0]]
            expected = np.zeros(1, model.cell)
            for cell in sorted(one, key=lambda cell: int(cell["stamp"][0]) if by_stamp else 0):
                expected = model.fuse(expected, cell, self.lattice)
            _same(folded[k : k + 1], expected)

    @for_many_seeds
    def test_order_repetition_and_delay_make_no_difference(self, model: Model, seed: int) -> None:
        rng = np.random.default_rng(seed)
        robots = {f"r{k}": self.scans(seed + k, 4) for k in range(3)}
        deltas = [d for name, scans in robots.items() for d in deltas_of(name, scans, self.lattice, model)]
        in_order, shuffled = Replica(self.lattice, model), Replica(self.lattice, model)
        for delta in deltas:
            in_order.apply(delta)
        for k in rng.permutation(np.tile(np.arange(len(deltas)), 2)):
            shuffled.apply(deltas[k])
            if rng.random() < 0.2:
                shuffled.digest()
        assert shuffled.digest() == in_order.digest()

    # Coarsen

    @for_many_seeds
    @pytest.mark.parametrize("factor", [1, 2, 4, 8])
    def test_coarsening_gives_a_cell_for_each_square(self, model: Model, seed: int, factor: int) -> None:
        for fine in self._tiles(model, seed):
            before = fine.tobytes()
            coarse = model.coarsen(fine, factor)
            assert fine.tobytes() == before
            assert (coarse.dtype, coarse.shape) == (model.cell, (len(fine) // factor, len(fine) // factor))
            squares = fine.reshape(len(coarse), factor, len(coarse), factor).swapaxes(1, 2)
            np.testing.assert_array_equal(model.known(coarse), model.known(squares).any(axis=(2, 3)))
            for field in ("stamp", "revision"):
                np.testing.assert_array_equal(coarse[field], squares[field].max(axis=(2, 3)))

    @for_many_seeds
    def test_coarsening_composes(self, model: Model, seed: int) -> None:
        _claimed(self.coarsen_composes, "coarsen_composes")
        for fine in self._tiles(model, seed):
            for k, m in ((2, 2), (2, 4), (4, 2), (1, 8)):
                _same(model.coarsen(model.coarsen(fine, k), m), model.coarsen(fine, k * m), self.tolerance)

    # What people see

    @for_many_seeds
    def test_layers_keep_the_laws_of_layers(self, model: Model, seed: int) -> None:
        replica = sample_map(model, [self.scans(seed, 3), self.scans(seed + 1, 3)], self.lattice)
        for name, layer in layers_of(model).items():
            assert (layer.name, bool(layer.unit), bool(layer.description)) == (name, True, True)
            check_layer(layer, replica, name in self.gaps)

    @for_many_seeds
    def test_occupied_is_a_share(self, model: Model, seed: int) -> None:
        replica = sample_map(model, [self.scans(seed, 3), self.scans(seed + 1, 3)], self.lattice)
        values = check_layer(model.occupied, replica, model.occupied.name in self.gaps)
        assert ((values >= 0) & (values <= 1) | np.isnan(values)).all()

    def test_a_picture_shows_one_of_its_layers(self, model: Model) -> None:
        assert model.picture_layer in model.layers

    # Settings

    def test_a_store_can_make_it_again(self, model: Model) -> None:
        written = json.loads(json.dumps(model.settings(), allow_nan=False))
        again = make_model(model.name, written)
        assert (type(again), again.cell, again.settings()) == (type(model), model.cell, model.settings())
        assert again == model or not is_dataclass(model), "settings() leaves something out"
        scans = self.scans(1, 4)
        assert encode(self._map(again, scans).delta()) == encode(self._map(model, scans).delta())

    def test_a_setting_that_there_is_not_is_refused(self, model: Model) -> None:
        with pytest.raises(InputError):
            make_model(model.name, {**model.settings(), "no_such_setting": 1})

    def _map(self, model: Model, scans: list[Scan]) -> Mapper:
        mapper = Mapper("r", self.lattice, model)
        for scan in scans:
            mapper.integrate(scan)
        return mapper

    def _cells(self, model: Model, seed: int, robots: int) -> list[Array]:
        """(M,) cells of each robot over the tiles that any of them touched, some unknown."""
        deltas = [self._map(model, self.scans(seed + k, 3)).delta() for k in range(robots)]
        keys = sorted({tile.key for delta in deltas for tile in delta.tiles})
        return [np.concatenate([_dense(delta, key, self.lattice) for key in keys]) for delta in deltas]

    def _tiles(self, model: Model, seed: int) -> list[Array]:
        """(T, T) cells of one robot's tiles."""
        delta = self._map(model, self.scans(seed, 4)).delta()
        side = self.lattice.tile_cells
        return [_dense(delta, tile.key, self.lattice).reshape(side, side) for tile in delta.tiles]


class _OneTile:
    """The harshest window: all but the robot's own tile goes."""

    def __init__(self, lattice: Lattice) -> None:
        self._lattice = lattice

    def around(self, east_m: float, north_m: float) -> Area:
        x, y, _ = self._lattice.tile_at(east_m, north_m)
        return rectangle(x, y, x + 1, y + 1)


def _dense(delta: Delta, key: TileKey, lattice: Lattice) -> Array:
    """(T²,) cells of a tile, unknown where the delta has none."""
    parts = [tile for tile in delta.tiles if tile.key == key]
    out = np.zeros(lattice.tile_cells**2, delta.tiles[0].cells.dtype)
    for part in parts:
        out[part.at] = part.cells
    return out


def _states(delta: Delta) -> dict[tuple[TileKey, int], Any]:
    return {(t.key, int(at)): cell for t in delta.tiles for at, cell in zip(t.at, t.cells, strict=True)}


def _content(delta: Delta) -> bytes:
    return encode(replace(delta, revision=0, stamp_ns=0))


def _claimed(claim: bool, name: str) -> None:
    if not claim:
        pytest.skip(f"the model does not claim it ({name} = False)")


def _same(one: Array, other: Array, tolerance: float = 0.0) -> None:
    """Assert that two arrays of cells are equal, field by field."""
    for name in one.dtype.names or ():
        slack = tolerance if one.dtype[name].kind == "f" else 0.0
        np.testing.assert_allclose(one[name], other[name], rtol=slack, atol=slack, err_msg=f"field {name}")
