"""A robot's own map: deltas, paging, going on from an archive."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from terrafuse.errors import InputError, PoseError
from terrafuse.lattice import MAX_CELL, MAX_TILE_CELLS, Lattice
from terrafuse.mapper import Mapper
from terrafuse.models import make_model
from terrafuse.replica import Replica
from terrafuse.store.behind import WriteBehind
from terrafuse.store.memory import MemoryStore
from terrafuse.store.sqlite import SqliteStore
from terrafuse.testing.deltas import SECOND_NS, random_scans
from terrafuse.types import Pose, Scan
from terrafuse.window import KeepAll, Tiles3x3

MODEL = make_model("elevation")


def drive(scans: int, step_m: float, seed: int = 0, reach_m: float = 25.0, points: int = 3000) -> list[Scan]:
    """Scans of a robot that goes east in a straight line, looking `reach_m` around."""
    rng = np.random.default_rng(seed)
    out = []
    for k in range(scans):
        xy = rng.uniform(-reach_m, reach_m, (points, 2))
        z = rng.normal(0, 0.02, points) - 1 + rng.choice([0.0, 0.0, 0.8], points)
        pose = Pose.identity().shifted(k * step_m, 0.3 * np.sin(k), 1.0)
        out.append(Scan(k * SECOND_NS, np.column_stack([xy, z]).astype(np.float32), pose))
    return out


def unpaged(scans: list[Scan], lattice: Lattice) -> str:
    mapper = Mapper("r1", lattice, MODEL)
    for scan in scans:
        mapper.integrate(scan)
    replica = Replica(lattice, MODEL)
    replica.apply(mapper.delta(0))
    return replica.digest()


def test_a_long_drive_stays_under_a_bound_and_equals_the_unpaged_map(tmp_path: Path) -> None:
    """2 km at 0.1 m: resident tiles never exceed what the window and one move of it can touch.

    With reach R and tiles of T the window of 3 tiles and the scans since it last moved (at most 1.5 T apart) lie within
    1.5 T + 2 R + 3 T east-west and 2 R + 3 T north-south.
    """
    lattice, reach_m = Lattice(0.1), 25.0
    scans = drive(200, 10.0, reach_m=reach_m)
    bound = np.ceil((4.5 * 40 + 2 * reach_m) / 40) * np.ceil((3 * 40 + 2 * reach_m) / 40)
    with SqliteStore.create(tmp_path / "map.db", lattice, MODEL) as store:
        archive = WriteBehind(store)
        mapper = Mapper("r1", lattice, MODEL, Tiles3x3(lattice), archive)
        most = []
        for scan in scans:
            mapper.integrate(scan)
            most.append(mapper.resident_bytes)
        mapper.commit()
        archive.close()
        tile_bytes = MODEL.tile(lattice).nbytes
        assert mapper.paging.most_resident <= bound
        assert max(most) <= bound * tile_bytes
        assert max(most[150:]) <= max(most[:50])  # it does not grow with distance
        assert len(mapper.keys) > 3 * mapper.paging.most_resident
        # Straight on, no tile comes back.
        assert mapper.paging.loads == 0
        assert Replica(store=store).digest() == unpaged(scans, lattice)


def test_walking_along_a_border_does_not_thrash() -> None:
    """To and fro over a tile border for 400 scans: the window moves once, and nothing is ever loaded again."""
    lattice = Lattice(0.5)
    rng = np.random.default_rng(3)
    mapper = Mapper("r1", lattice, MODEL, Tiles3x3(lattice), MemoryStore(lattice, MODEL))
    for k in range(400):
        points = rng.uniform(-15, 15, (200, 3)) * (1, 1, 0.01)
        pose = Pose.identity().shifted(40.0 + 2 * np.sin(k), 40.0 + 2 * np.cos(1.7 * k))
        mapper.integrate(Scan(k, points, pose))
    assert mapper.paging.loads == 0
    assert mapper.paging.evictions == 0


def test_coming_back_loads_what_was_there() -> None:
    lattice = Lattice(0.5)
    there = drive(40, 10.0)
    scans = there + [Scan(s.stamp_ns + 100 * SECOND_NS, s.points, s.T_world_sensor) for s in there[::-1]]
    store = MemoryStore(lattice, MODEL)
    mapper = Mapper("r1", lattice, MODEL, Tiles3x3(lattice), store)
    for scan in scans:
        mapper.integrate(scan)
    mapper.commit()
    assert mapper.paging.loads > 10
    assert Replica(store=store).digest() == unpaged(scans, lattice)


def test_deltas_reach_back_to_tiles_that_left() -> None:
    lattice = Lattice(0.5)
    mapper = Mapper("r1", lattice, MODEL, Tiles3x3(lattice), MemoryStore(lattice, MODEL))
    for scan in drive(40, 10.0):
        mapper.integrate(scan)
    assert mapper.paging.evictions > 0
    replica = Replica(lattice, MODEL)
    replica.apply(mapper.delta(0))
    assert replica.digest() == unpaged(drive(40, 10.0), lattice)


@given(cuts=st.lists(st.integers(0, 12), max_size=6), seed=st.integers(0, 1000))
@settings(max_examples=25)
def test_delta_since_holds_exactly_what_changed(cuts: list[int], seed: int) -> None:
    """Whatever was asked before, delta(since) has the cells whose revision is newer, as they are now."""
    lattice = Lattice(0.5, 4.0)
    mapper, plain = Mapper("r1", lattice, MODEL), Mapper("r1", lattice, MODEL)
    for scan in random_scans(seed, 12):
        mapper.integrate(scan)
        plain.integrate(scan)
        for since in cuts:
            mapper.delta(since)
    whole = {tile.key: tile for tile in plain.delta(0).tiles}
    for since in (0, 5, 11, 12):
        got = {tile.key: tile for tile in mapper.delta(since).tiles}
        for key, tile in whole.items():
            newer = tile.cells["revision"] > since
            if newer.any():
                np.testing.assert_array_equal(got[key].at, tile.at[newer])
                np.testing.assert_array_equal(got[key].cells, tile.cells[newer])
            else:
                assert key not in got


def test_a_restarted_robot_goes_on_where_its_archive_ends(tmp_path: Path) -> None:
    lattice, scans = Lattice(0.5), drive(30, 8.0)
    with SqliteStore.create(tmp_path / "map.db", lattice, MODEL) as store:
        first = Mapper("r1", lattice, MODEL, Tiles3x3(lattice), store)
        for scan in scans[:17]:
            first.integrate(scan)  # what was not committed by paging is lost with the process
    with SqliteStore.open(tmp_path / "map.db") as store:
        second = Mapper("r1", lattice, MODEL, Tiles3x3(lattice), store)
        assert 0 < second.revision < 17
        for scan in scans[second.revision :]:
            second.integrate(scan)
        second.commit()
        assert Replica(store=store).digest() == unpaged(scans, lattice)


def test_scans_without_points_are_revisions_too() -> None:
    mapper = Mapper("r1", Lattice(0.5), MODEL)
    done = mapper.integrate(Scan(0, np.full((5, 3), np.nan), Pose.identity()))
    assert (done.cells, done.points, dict(done.dropped)) == (0, 5, {"not finite": 5})
    assert mapper.integrate(Scan(0, np.empty((0, 3)), Pose.identity())).cells == 0
    assert mapper.revision == 2
    assert mapper.delta(0).tiles == ()


def test_scans_are_checked() -> None:
    mapper = Mapper("r1", Lattice(0.5), MODEL)
    with pytest.raises(InputError, match=r"points are \(N, 3\), not \(3, 2\)"):
        mapper.integrate(Scan(0, np.zeros((3, 2)), Pose.identity()))
    with pytest.raises(InputError, match="stamp -1"):
        mapper.integrate(Scan(-1, np.zeros((3, 3)), Pose.identity()))
    assert mapper.revision == 0
    whole = mapper.integrate(Scan(0, np.array([[1, 2, 3]]), Pose.identity()))
    assert whole.cells == 1


def test_a_cells_stamp_never_runs_backwards() -> None:
    mapper = Mapper("r1", Lattice(0.5), MODEL)
    for stamp_ns in (5, 3):
        mapper.integrate(Scan(stamp_ns, np.array([[0.1, 0.1, 0.0]]), Pose.identity()))
    assert mapper.delta(0).tiles[0].cells["stamp"].tolist() == [5]


@pytest.mark.parametrize("name", ["", "a\nb", "x" * 201])
def test_robot_names_are_checked(name: str) -> None:
    with pytest.raises(InputError, match="robot name"):
        Mapper(name, Lattice(0.5), MODEL)


def test_a_window_that_drops_needs_an_archive() -> None:
    with pytest.raises(InputError, match="archive"):
        Mapper("r1", Lattice(0.5), MODEL, Tiles3x3(Lattice(0.5)))
    Mapper("r1", Lattice(0.5), MODEL, KeepAll(Lattice(0.5)))


def test_a_load_that_fails_loses_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    lattice, store = Lattice(0.5), MemoryStore(Lattice(0.5), MODEL)
    spot = Scan(0, np.full((50, 3), 0.1), Pose.identity())
    first = Mapper("r1", lattice, MODEL, Tiles3x3(Lattice(0.5)), store)
    first.integrate(spot)
    first.commit()
    second = Mapper("r1", lattice, MODEL, Tiles3x3(Lattice(0.5)), store)
    with monkeypatch.context() as broken:
        broken.setattr(store, "load", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            second.integrate(spot)
    second.integrate(spot)
    second.commit()
    assert Replica(store=store).cells(second.keys[0])["n"].sum() == 100


def test_a_mapper_on_a_busy_archive_sees_what_still_waits(tmp_path: Path) -> None:
    static = make_model("elevation", {"static": True})
    with SqliteStore.create(tmp_path / "map.db", Lattice(0.5), static) as store:
        archive = WriteBehind(store)
        with store._lock:  # the writer can't get on
            for scan in random_scans(1, 2):
                mapper = Mapper("r1", Lattice(0.5), static, Tiles3x3(Lattice(0.5)), archive)
                mapper.integrate(scan)
                mapper.commit()
        archive.close()
        assert store.revision("r1") == 2
        assert sum(Replica(store=store).cells(key)["n"].sum() for key in store.keys()) == 120


def test_clouds_in_world_coordinates_page_too() -> None:
    """Airborne tiles have no sensor pose: the window follows what they cover."""
    lattice = Lattice(0.5)
    mapper = Mapper("air", lattice, MODEL, Tiles3x3(lattice), MemoryStore(lattice, MODEL))
    for k in range(10):
        corner = np.array([500_000 + 400 * k, 4_000_000, 0])
        points = corner + np.random.default_rng(k).uniform(0, 30, (100, 3))
        mapper.integrate(Scan(k, points, Pose.identity()))
    assert mapper.paging.most_resident <= 4
    assert mapper.paging.evictions >= 9


@pytest.mark.parametrize("model", ["elevation", "terrain"])
@pytest.mark.parametrize("sign", [1, -1])
def test_nothing_is_mapped_beyond_the_lattice(model: str, sign: int) -> None:
    """As far out as a sensor may be, it maps what is around it, and drops what lies beyond; none may be further out."""
    lattice = Lattice(0.5)
    furthest_m = (MAX_CELL - MAX_TILE_CELLS) * lattice.resolution_m
    mapper = Mapper("r1", lattice, make_model(model, {"max_range_m": 1e8}))
    points = np.array([[sign * 1.0, 0.0, 0.0], [sign * 45.0, 0.0, 0.0], [sign * 1e6, 0.0, 0.0]])
    done = mapper.integrate(Scan(0, points, Pose.identity().shifted(sign * furthest_m, 0.0)))
    assert (done.cells, done.dropped["beyond the lattice"]) == (2, 1)
    assert sum(len(tile.at) for tile in mapper.delta().tiles) == 2
    with pytest.raises(InputError, match=r"position .* lies beyond the lattice"):
        mapper.integrate(Scan(1, points, Pose.identity().shifted(sign * (furthest_m + 1.0), 0.0)))


def test_a_scan_that_touches_a_tile_beyond_the_lattice_is_refused() -> None:
    """2**40 cells are 274,877,906.944 tiles of 4000: the cells from −2**40 on lie in one that reaches beyond."""
    lattice = Lattice(5e-5, 0.2)
    mapper = Mapper("r1", lattice, MODEL)
    cell_m = -(MAX_CELL - 10) * lattice.resolution_m
    with pytest.raises(InputError, match="sees places beyond the lattice"):
        mapper.integrate(Scan(0, np.array([[cell_m, 0.0, 0.0]]), Pose.identity()))
    assert (mapper.revision, mapper.keys) == (0, [])


@pytest.mark.parametrize("matrix", [np.diag([2.0, 2, 2, 1]), np.full((4, 4), np.nan)])
def test_poses_are_checked(matrix: np.ndarray) -> None:
    mapper = Mapper("r1", Lattice(0.5), MODEL)
    with pytest.raises(PoseError, match="pose of robot 'r1' at stamp 0"):
        mapper.integrate(Scan(0, np.zeros((1, 3)), Pose(matrix)))
    with pytest.raises(InputError, match="beyond the lattice"):
        mapper.integrate(Scan(0, np.zeros((1, 3)), Pose.identity().shifted(1e15, 0)))
