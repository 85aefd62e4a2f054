"""Whole runs through every window: the same map, what each wastes, and what paging costs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from terrafuse.lattice import Lattice
from terrafuse.logs import open_log
from terrafuse.logs.base import parse_source
from terrafuse.mapper import Mapper
from terrafuse.models import make_model
from terrafuse.replica import Replica
from terrafuse.store.behind import MAX_WAITING, WriteBehind
from terrafuse.store.memory import MemoryStore
from terrafuse.store.sqlite import SqliteStore
from terrafuse.types import Pose, Scan
from terrafuse.window import Residency, make_window
from tests.accuracy_windows import INCH_M, Hallway, Run, distances, radius, run, scans_of

MODEL = make_model("elevation")
LATTICE = Lattice(0.5, 4.0)
REACH_M = 6.0
WINDOWS = ["tiles3x3", "nine_block", "centred?cells=30", f"radius?range_m={REACH_M}&period_s=1&speed_mps=1"]

Place = tuple[float, float]


# --- the hallway of the database paper -------------------------------------------------------------------------------

SHORT = Hallway(first_leg=200, second_leg=120)


@pytest.fixture(scope="module")
def hallway(tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, int], Run]:
    """The same run through several windows."""
    cases = [("all", 100), ("tiles3x3", 100), ("centred?cells=120", 100), ("nine_block", 100), (radius(1), 100)]
    cases += [(radius(30), 100), ("all", 25), (radius(1), 25), (radius(1), 10)]
    scans = scans_of(SHORT)
    return {case: run(scans, *case, tmp_path_factory.mktemp("run")) for case in cases}


def test_rays_end_at_the_walls() -> None:
    """From (50, 50): walls at y = 14 and 86, the end behind at x = -10; ahead the hallway ends at x = 286."""
    found = distances((50, 50), np.array([0, np.pi / 2, np.pi, -np.pi / 2, np.pi / 4]), SHORT.corners)
    np.testing.assert_allclose(found, [236, 36, 60, 36, 36 * math.sqrt(2)])


def test_every_window_gives_the_same_hallway(hallway: dict[tuple[str, int], Run]) -> None:
    for (_, block), done in hallway.items():
        if ("all", block) in hallway:
            assert done.digest == hallway["all", block].digest
    assert len({done.allocation.observed_cells for done in hallway.values()}) == 1


def test_nine_blocks_are_claimed_wherever_the_robot_comes(hallway: dict[tuple[str, int], Run]) -> None:
    """It goes from x = 50 to 250 and y = 50 to 170: through the blocks (0, 0), (1, 0), (2, 0), (2, 1).

    With their neighbours: -1 to 3 by -1 to 1 are 15 blocks, and 1 to 3 by 2 three more; nine at once.
    """
    held = hallway["nine_block", 100].allocation
    assert held.window_cells == 18 * 100 * 100
    assert held.most_window_cells == 9 * 100 * 100


def test_radius_wastes_less_than_nine_block_and_less_in_smaller_blocks(hallway: dict[tuple[str, int], Run]) -> None:
    def seen(window: str, block: int) -> float:
        return hallway[window, block].allocation.observed_of_window

    assert seen("nine_block", 100) < 0.2 < seen(radius(1), 100) < seen(radius(1), 25) < seen(radius(1), 10)
    assert seen(radius(1), 10) > 2 * seen("nine_block", 100)
    # "The efficiency of allocated space" grows as updates come more often.
    assert seen(radius(30), 100) < seen(radius(1), 100)


def test_tiles_are_allocated_when_touched_whatever_the_window_claims(hallway: dict[tuple[str, int], Run]) -> None:
    assert len({done.allocation.allocated_cells for (_, block), done in hallway.items() if block == 100}) == 1
    for done in hallway.values():
        held = done.allocation
        assert held.observed_cells <= held.allocated_cells <= held.window_cells
        assert held.most_allocated_cells <= held.most_window_cells
    nothing_claimed = hallway["all", 100].allocation
    assert nothing_claimed.window_cells == nothing_claimed.allocated_cells


@pytest.mark.parametrize("block", [100, 25, 10])
def test_nothing_is_touched_outside_what_can_be_seen(hallway: dict[tuple[str, int], Run], block: int) -> None:
    """What the window claimed is where it was, and no tile beside."""
    lattice = Lattice(INCH_M, block * INCH_M)
    window = Residency(make_window(radius(1), lattice))
    for x, y, _ in SHORT.way:
        window.move(x * INCH_M, y * INCH_M)
    assert hallway[radius(1), block].allocation.window_cells == len(window.visited) * block**2


def test_a_window_that_moves_at_every_scan_commits_now_and_then(hallway: dict[tuple[str, int], Run]) -> None:
    scans = len(SHORT.way)
    moves = Residency(make_window(radius(1), Lattice(INCH_M, 10 * INCH_M)))
    moved = sum(moves.move(x * INCH_M, y * INCH_M) for x, y, _ in SHORT.way)
    paging = hallway[radius(1), 10].paging
    assert moved > scans / 4
    assert paging.evictions > 300
    assert paging.commits < moved / 10
    assert paging.loads > 50  # it came back


# --- anywhere --------------------------------------------------------------------------------------------------------


def look(places: Sequence[Place], seed: int = 0, points: int = 60) -> list[Scan]:
    """A scan at each place, up to REACH_M around."""
    rng = np.random.default_rng(seed)
    scans = []
    for k, (east_m, north_m) in enumerate(places):
        far, way = REACH_M * np.sqrt(rng.uniform(0, 1, points)), rng.uniform(0, 2 * np.pi, points)
        cloud = np.column_stack([far * np.cos(way), far * np.sin(way), rng.normal(0, 0.01, points)])
        scans.append(Scan(k * 1_000_000_000, cloud, Pose.identity().shifted(east_m, north_m)))
    return scans


def whole(scans: Sequence[Scan], lattice: Lattice = LATTICE) -> str:
    mapper = Mapper("r", lattice, MODEL)
    for scan in scans:
        mapper.integrate(scan)
    replica = Replica(lattice, MODEL)
    replica.apply(mapper.delta())
    return replica.digest()


def paged(scans: Sequence[Scan], window: str, store: MemoryStore | SqliteStore, lattice: Lattice = LATTICE) -> Mapper:
    archive = WriteBehind(store)
    mapper = Mapper("r", lattice, MODEL, make_window(window, lattice), archive)
    for scan in scans:
        mapper.integrate(scan)
    mapper.commit()
    archive.close()
    return mapper


steps = st.tuples(st.floats(-4, 4), st.floats(-4, 4))


@pytest.mark.parametrize("window", WINDOWS)
@given(walk=st.lists(steps, min_size=1, max_size=25), back=st.booleans(), seed=st.integers(0, 99))
@settings(max_examples=15)
def test_every_window_gives_the_map_of_none(window: str, walk: list[Place], back: bool, seed: int) -> None:
    way = np.cumsum(np.array(walk), axis=0).tolist()
    scans = look(way + way[::-1] if back else way, seed)
    store = MemoryStore(LATTICE, MODEL)
    paged(scans, window, store)
    assert Replica(store=store).digest() == whole(scans)


WAYS: dict[str, list[Place]] = {
    "along a border": [(0.7 * k, 8.0 + 0.3 * (-1) ** k) for k in range(60)],
    "on a corner": [(8.0 + 0.2 * (-1) ** (k // 2), 8.0 + 0.2 * (-1) ** k) for k in range(60)],
    "there and back": [(1.5 * k, 0.4 * k) for k in [*range(40), *range(40, 0, -1)]],
    "leaps": [(60.0 * (-1) ** k, 25.0 * k) for k in range(20)],
}


@pytest.mark.parametrize("window", WINDOWS)
@pytest.mark.parametrize("way", WAYS)
def test_the_same_map_through_a_store_on_disk(window: str, way: str, tmp_path: Path) -> None:
    scans = look(WAYS[way])
    with SqliteStore.create(tmp_path / "map.db", LATTICE, MODEL) as store:
        paging = paged(scans, window, store).paging
        assert Replica(store=store).digest() == whole(scans)
    if way in ("there and back", "leaps"):
        assert paging.evictions > 10
    if way == "there and back":
        assert paging.loads > 0
    if way == "on a corner" and window != "nine_block":
        assert paging.loads == 0  # nothing that the next scan needs goes


def test_coming_back_reads_each_tile_about_once(tmp_path: Path) -> None:
    for window in WINDOWS:
        with SqliteStore.create(tmp_path / f"{window.partition('?')[0]}.db", LATTICE, MODEL) as store:
            mapper = paged(look(WAYS["there and back"]), window, store)
            assert mapper.paging.loads <= 1.2 * len(mapper.keys)


# --- what paging costs -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("window", WINDOWS)
def test_standing_still_writes_nothing(window: str) -> None:
    mapper = Mapper("r", LATTICE, MODEL, make_window(window, LATTICE), MemoryStore(LATTICE, MODEL))
    for scan in look([(8.0, 8.0)] * 50):
        mapper.integrate(scan)
    assert (mapper.paging.commits, mapper.paging.writes, mapper.paging.evictions) == (0, 0, 0)


@pytest.mark.parametrize("window", WINDOWS)
def test_a_commit_leaves_in_memory_only_what_is_inside_or_just_seen(window: str) -> None:
    mapper = Mapper("r", LATTICE, MODEL, make_window(window, LATTICE), MemoryStore(LATTICE, MODEL))
    inside = Residency(make_window(window, LATTICE))
    tile_bytes = MODEL.tile(LATTICE).nbytes
    for scan in look([(1.1 * k, 0.7 * k) for k in range(60)]):
        touched = mapper.integrate(scan).tiles
        inside.move(*scan.T_world_sensor.position[:2].tolist())
        # What waits to be written is less than a quarter of all.
        assert mapper.resident_bytes * 3 / 4 <= tile_bytes * (len(inside.area) + touched)
        mapper.commit()
        assert mapper.resident_bytes <= tile_bytes * (len(inside.area) + touched)


def test_a_robot_drives_on_while_the_store_is_busy(tmp_path: Path) -> None:
    """Nothing on the sensing path waits for a write: here none can end before the drive does."""
    scans = look([(1.0 * k, 0.0) for k in range(60)])
    with SqliteStore.create(tmp_path / "map.db", LATTICE, MODEL) as store:
        archive = WriteBehind(store)
        mapper = Mapper("r", LATTICE, MODEL, make_window(WINDOWS[-1], LATTICE), archive)
        with store._lock:  # the writer can't get on
            for scan in scans:
                mapper.integrate(scan)
            assert 5 < mapper.paging.commits <= MAX_WAITING
            assert mapper.paging.evictions > 20
        mapper.commit()
        archive.close()
        assert Replica(store=store).digest() == whole(scans)


@pytest.mark.parametrize("window", ["nine_block", "centred?cells=200", "radius?range_m=80&speed_mps=10"])
def test_a_real_drive_is_the_same_through_every_window(window: str, recordings: Path, tmp_path: Path) -> None:
    source = f"{recordings / 'lidar3d/patchworkpp_kitti'}?poses=poses_velo_first6.txt&calib=identity"
    scans = [record for record in open_log(parse_source(source)).scans() if isinstance(record, Scan)]
    lattice = Lattice(0.5, 8.0)
    with SqliteStore.create(tmp_path / "map.db", lattice, MODEL) as store:
        mapper = paged(scans, window, store, lattice)
        assert Replica(store=store).digest() == whole(scans, lattice)
        assert mapper.allocation().observed_cells == sum(
            int((Replica(store=store).cells(key)["n"] > 0).sum()) for key in store.keys()
        )
