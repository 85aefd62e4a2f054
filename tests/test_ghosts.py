"""The elevation model's dynamic rule: what moves leaves no ghost, what stays appears.

Scans come from a world whose truth is known. Each story is told three times: on one large tile, on small tiles whose
borders cross the scene, and on small tiles that are paged out to disk while the robot is away.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from terrafuse.kernels import absorb, evidence
from terrafuse.lattice import Lattice
from terrafuse.mapper import Mapper
from terrafuse.models import Reading, fold, make_model
from terrafuse.replica import Replica
from terrafuse.store.behind import WriteBehind
from terrafuse.store.sqlite import SqliteStore
from terrafuse.testing.analytic.boxes import Box, Car, Pit
from terrafuse.testing.analytic.ground import Ground
from terrafuse.testing.analytic.scene import Lidar, Scene, covered, scan, truth
from terrafuse.types import Array, Bounds, Floats, Pose, Scan, TileKey
from terrafuse.views import chosen_layers, mosaic
from terrafuse.window import Tiles3x3

NS = 1_000_000_000
GHOST_M = 0.1

ONE_TILE, SMALL_TILES = Lattice(0.2, 40.0), Lattice(0.2, 4.0)
STAGE = ONE_TILE.cell_window(Bounds(-6.0, 3.4, 6.0, 6.8))
"""The road north of the robot. Borders of the small tiles, at x = -4, 0, 4 and y = 4, cross it; the large ones' too, at
x = 0."""

LIDAR = Lidar(beams=128, columns=400, lowest_deg=-48.0, highest_deg=-5.0, max_range_m=14.0, noise_m=0.01)
"""On a mast of 3 m it hits every cell of the stage in each scan: what a test finds is the rule's doing, not a gap in
what was looked at."""
MAST_M = 3.0

GROUND = Ground(2.0, slope_east=0.05, slope_north=-0.03, wave_m=0.05, wave_length_m=25.0)
HERE, AWAY = 0.0, 24.0
"""Two places on the x axis. From the far one the stage is out of reach, and its tiles are out of the window."""


@dataclass(frozen=True)
class Story:
    """A scene, and the robot's looks at it: (time, x)."""

    scene: Scene
    looks: tuple[tuple[float, float], ...]


def car(enters_s: float, parks_s: tuple[float, float] = (0.0, 0.0)) -> Car:
    """It comes over the road at 4 m/s and is at x = 0, on the border of two tiles, after 3 s."""
    return Car((-12.0, 5.1), (12.0, 5.1), enters_s, 4.0, parks_s)


PIT = Box(0.3, 5.1, 3.1, 2.1, top_m=1.4)
"""The bottom of a hole some 0.45 m deep."""

DRIVES_THROUGH = Story(
    Scene(GROUND, cars=(car(2.0),)),
    ((0, HERE), (1, 0.1), *((2.5 + 0.5 * k, 0.1 * (k % 3)) for k in range(11)), (9, AWAY), (10, 0.05), (11, HERE)),
)
FIRST_SEEN_DRIVING = Story(DRIVES_THROUGH.scene, DRIVES_THROUGH.looks[4:])
"""The robot starts while the car is there: what the car covers was never seen before."""

PARKS = Story(
    Scene(GROUND, cars=(car(2.0, parks_s=(5.0, 50.0)),)),
    ((0, HERE), (1, AWAY), (10, HERE), (11, 0.1)),
)
LEAVES = Story(PARKS.scene, (*PARKS.looks, (20, AWAY), (60, 0.05), (61, HERE)))
FIRST_SEEN_PARKED = Story(PARKS.scene, LEAVES.looks[2:])

PIT_OPENS = Story(Scene(GROUND, pits=(Pit(PIT, 5.0, 50.0),)), PARKS.looks)
PIT_CLOSES = Story(PIT_OPENS.scene, LEAVES.looks)
FIRST_SEEN_OPEN = Story(PIT_OPENS.scene, LEAVES.looks[2:])


@cache
def scans_of(story: Story) -> tuple[Scan, ...]:
    rng = np.random.default_rng(7)
    out = []
    for time_s, x in story.looks:
        pose = Pose.identity().shifted(x, 0.0, float(GROUND.height(x, 0.0)) + MAST_M)
        out.append(Scan(round(time_s * NS), scan(story.scene, LIDAR, pose, time_s, rng), pose))
    return tuple(out)


@pytest.fixture(params=["one tile", "borders", "paged"])
def mapped(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Callable[..., Replica]]:
    """Maps a story, in the way of the parameter."""
    ways = {"one tile": on_one_tile, "borders": over_borders, "paged": lambda s, **k: paged(s, tmp_path, **k)}
    return ways[request.param]


def on_one_tile(story: Story, static: bool = False) -> Replica:
    return resident(story, ONE_TILE, static)


def over_borders(story: Story, static: bool = False) -> Replica:
    return resident(story, SMALL_TILES, static)


@cache
def resident(story: Story, lattice: Lattice, static: bool) -> Replica:
    """The map of a robot that keeps all tiles in memory."""
    mapper = Mapper("r1", lattice, make_model("elevation", {"static": static}))
    for look in scans_of(story):
        mapper.integrate(look)
    replica = Replica(lattice, mapper.model)
    replica.apply(mapper.delta())
    return replica


def paged(story: Story, folder: Path, static: bool = False) -> Replica:
    """The map of a robot with a window of 3×3 small tiles, over an SQLite store that is written behind it."""
    model = make_model("elevation", {"static": static})
    with SqliteStore.create(folder / f"{hash((story, static))}.db", SMALL_TILES, model) as store:
        archive = WriteBehind(store)
        mapper = Mapper("r1", SMALL_TILES, model, Tiles3x3(SMALL_TILES), archive)
        for look in scans_of(story):
            mapper.integrate(look)
        # The story is worth its name only if the stage went out to the disk and came back.
        if any(x == AWAY for _, x in story.looks[:-1]):
            assert mapper.paging.evictions > 8
            assert mapper.paging.loads > 8
        replica = Replica(SMALL_TILES, model)
        replica.apply(mapper.delta())
        archive.close()
    return replica


def on_stage(replica: Replica, *names: str) -> list[Floats]:
    layers = mosaic(replica, chosen_layers(replica, names), STAGE)
    return [layers[name] for name in names]


def ground() -> Floats:
    return truth(Scene(GROUND), ONE_TILE, STAGE)


def footprint(story: Story, grown_m: float = 0.0) -> Array:
    """The stage's cells under the car or over the pit at 10 s, by their centres."""
    return covered(story.scene, ONE_TILE, STAGE, grown_m, time_s=10.0)


def ghosts(replica: Replica) -> int:
    (height,) = on_stage(replica, "height")
    assert not np.isnan(height).any()
    return int((height - ground() > GHOST_M).sum())


def dents(replica: Replica) -> int:
    (height,) = on_stage(replica, "height")
    return int((ground() - height > GHOST_M).sum())


# --- up: a car -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("story", [DRIVES_THROUGH, FIRST_SEEN_DRIVING], ids=["ground seen first", "car seen first"])
def test_a_car_that_drives_through_leaves_nothing(mapped: Callable[..., Replica], story: Story) -> None:
    assert ghosts(mapped(story)) == 0
    assert ghosts(mapped(story, static=True)) > 200


def test_a_car_that_drives_through_is_told_by_the_cells_that_it_crossed(mapped: Callable[..., Replica]) -> None:
    changes, dynamic = on_stage(mapped(DRIVES_THROUGH), "changes", "dynamic")
    y = ONE_TILE.cell_centre(np.arange(STAGE[1], STAGE[3]))
    lane = abs(y - 5.1) < 0.8
    assert changes[lane].min() >= 1  # the car came, and mostly went
    assert changes[y < 4.0].max() == 0
    assert dynamic[lane].min() > dynamic[y < 4.0].max()


def test_a_car_that_parks_appears(mapped: Callable[..., Replica]) -> None:
    height, mean = on_stage(mapped(PARKS), "height", "z_mean")
    top = truth(PARKS.scene, ONE_TILE, STAGE, time_s=10.0)
    roof = footprint(PARKS, grown_m=-0.15)
    assert roof.sum() > 100
    assert np.abs(height - top)[roof].max() < 0.05
    assert np.abs(mean - top)[roof].max() < 0.05
    (without,) = on_stage(mapped(PARKS, static=True), "z_mean")  # somewhere between the road and the roof
    assert np.abs(without - top)[roof].mean() > 0.3


def test_the_front_of_a_parked_car_is_vertical(mapped: Callable[..., Replica]) -> None:
    state, height = on_stage(mapped(PARKS), "state", "height")
    side = footprint(PARKS, 0.01) & ~np.roll(footprint(PARKS, 0.01), 1, axis=0)  # its southernmost row
    assert (state[side] == 2).mean() > 0.9
    assert (height - ground())[side].mean() == pytest.approx(1.5, abs=0.1)


@pytest.mark.parametrize("story", [LEAVES, FIRST_SEEN_PARKED], ids=["ground seen first", "car seen first"])
def test_a_car_that_leaves_gives_the_ground_back(mapped: Callable[..., Replica], story: Story) -> None:
    replica = mapped(story)
    height, highest, state = on_stage(replica, "height", "z_max", "state")
    assert np.percentile(np.abs(height - ground()), 98) < 0.02
    assert (highest - ground()).max() < GHOST_M  # no point of the car is left in any statistic
    assert (state == 1).all()
    assert ghosts(mapped(story, static=True)) > 100


def test_the_ground_that_comes_back_is_what_was_there_before(mapped: Callable[..., Replica]) -> None:
    """n counts the points of before and after, and none of the car's."""
    (before,) = on_stage(mapped(Story(LEAVES.scene, LEAVES.looks[:1])), "n")
    (after,) = on_stage(mapped(Story(LEAVES.scene, LEAVES.looks[-2:])), "n")
    (both,) = on_stage(mapped(LEAVES), "n")
    roof = footprint(LEAVES, grown_m=-0.15)
    # Other noise moves some points over into the next cell.
    assert both[roof].mean() == pytest.approx((before + after)[roof].mean(), rel=0.05)


# --- down: a pit -----------------------------------------------------------------------------------------------------


def test_a_pit_that_opens_appears(mapped: Callable[..., Replica]) -> None:
    (height,) = on_stage(mapped(PIT_OPENS), "height")
    floor = footprint(PIT_OPENS, -0.15)
    floor &= np.roll(floor, 4, axis=0)  # its near wall hides the first cells
    assert floor.sum() > 60
    assert np.abs(height - PIT.top_m)[floor].max() < 0.05
    (without,) = on_stage(mapped(PIT_OPENS, static=True), "height")
    assert (without - PIT.top_m)[floor].mean() > 0.1


@pytest.mark.parametrize("story", [PIT_CLOSES, FIRST_SEEN_OPEN], ids=["ground seen first", "pit seen first"])
def test_a_pit_that_closes_leaves_nothing(mapped: Callable[..., Replica], story: Story) -> None:
    replica = mapped(story)
    height, state = on_stage(replica, "height", "state")
    assert ghosts(replica) == dents(replica) == 0
    # A hit on the rim of the wall, within the tolerance of the ground, does count.
    assert np.percentile(np.abs(height - ground()), 98) < 0.02
    assert (state == 1).all()
    assert dents(mapped(story, static=True)) > 60


# --- tiles -----------------------------------------------------------------------------------------------------------

STORIES = [DRIVES_THROUGH, FIRST_SEEN_DRIVING, PARKS, LEAVES, PIT_OPENS, PIT_CLOSES]


@pytest.mark.parametrize("story", STORIES)
def test_a_paged_map_equals_the_unpaged_one(story: Story, tmp_path: Path) -> None:
    whole, parted = over_borders(story), paged(story, tmp_path)
    assert whole.keys == parted.keys
    for key in whole.keys:
        assert whole.cells(key).tobytes() == parted.cells(key).tobytes()


@pytest.mark.parametrize("story", STORIES)
def test_borders_of_tiles_are_nowhere_in_a_map(story: Story) -> None:
    assert cells_on_stage(on_one_tile(story)).tobytes() == cells_on_stage(over_borders(story)).tobytes()


def cells_on_stage(replica: Replica) -> Array:
    """The stage's cell records, by the definition of a tile."""
    i0, j0, i1, j1 = STAGE
    side = replica.lattice.tile_cells
    rows = [
        [replica.cells(TileKey(i // side, j // side))[j % side, i % side] for i in range(i0, i1)] for j in range(j0, j1)
    ]
    return np.array(rows, replica.model.cell)


# --- the table of the merge ------------------------------------------------------------------------------------------

RULES = absorb.rules(False, 0.10, 0.05)
STATIC = absorb.rules(True, 0.10, 0.05)

NOTHING = ()
GROUND_AT_0 = (0.00, 0.02)
GROUND_AGAIN = (0.03,)
WALL = (0.0, 0.7, 1.4)
MORE_WALL = (0.3, 0.9, 1.6, 1.7)
ROOF = (1.50, 1.52)
FLOOR = (-0.60, -0.58)

TABLE = {
    "unknown ← flat": (NOTHING, NOTHING, GROUND_AT_0, GROUND_AT_0, NOTHING, 0),
    "unknown ← vertical": (NOTHING, NOTHING, WALL, WALL, NOTHING, 0),
    "flat ← flat, the same": (GROUND_AT_0, NOTHING, GROUND_AGAIN, GROUND_AT_0 + GROUND_AGAIN, NOTHING, 0),
    "flat ← flat, higher": (GROUND_AT_0, NOTHING, ROOF, ROOF, GROUND_AT_0, 1),
    "flat ← flat, lower": (GROUND_AT_0, NOTHING, FLOOR, FLOOR, GROUND_AT_0, 1),
    "flat ← flat, down to the cached": (ROOF, GROUND_AT_0, GROUND_AGAIN, GROUND_AT_0 + GROUND_AGAIN, NOTHING, 1),
    "flat ← flat, up to the cached": (FLOOR, GROUND_AT_0, GROUND_AGAIN, GROUND_AT_0 + GROUND_AGAIN, NOTHING, 1),
    "flat ← flat, a third height": (ROOF, GROUND_AT_0, (0.8,), (0.8,), GROUND_AT_0, 1),
    "vertical ← vertical": (WALL, GROUND_AT_0, MORE_WALL, WALL + MORE_WALL, GROUND_AT_0, 0),
    "flat ← vertical": (GROUND_AT_0, NOTHING, WALL, WALL, GROUND_AT_0, 1),
    "flat ← vertical, over the cached": (ROOF, GROUND_AT_0, WALL, WALL, GROUND_AT_0, 1),
    "flat ← vertical, under the cached": (FLOOR, GROUND_AT_0, WALL, WALL, FLOOR, 1),
    "vertical ← flat, the cached": (WALL, GROUND_AT_0, GROUND_AGAIN, GROUND_AT_0 + GROUND_AGAIN, NOTHING, 1),
    "vertical ← flat, another": (WALL, GROUND_AT_0, FLOOR, FLOOR, GROUND_AT_0, 1),
    "vertical ← flat, none cached": (WALL, NOTHING, GROUND_AGAIN, GROUND_AGAIN, NOTHING, 1),
}
"""(own, cached ground, patch) → (own, cached ground, changes), each as heights in metres."""


def record(heights_m: tuple[float, ...]) -> Array:
    """EVIDENCE of points of these heights; zeros of none."""
    return record_of_ticks([int(h) for h in evidence.ticks(np.array(heights_m))])


def record_of_ticks(heights: list[int]) -> Array:
    square = sum(h * h for h in heights)
    fields = (len(heights), min(heights, default=0), max(heights, default=0), square >> 64, sum(heights))
    return np.array((*fields, square & (2**64 - 1)), evidence.EVIDENCE)


def merged(own: Array, ground: Array, patch: Array, rules: absorb.Rules, stamp: int = 5, revision: int = 7) -> Any:
    """What `absorb.merge` makes of (K,) EVIDENCE each: the tile's two arrays, and the positions that changed."""
    k = len(own)
    surface, below = np.zeros(k, absorb.SURFACE), np.ascontiguousarray(ground).copy()
    for name in evidence.EVIDENCE.names or ():
        surface[name] = own[name]
    changed = np.empty(k + 1, np.int32)
    tile = np.array([(surface.ctypes.data, below.ctypes.data, changed.ctypes.data, 0, 0)], absorb.STATE)
    at = np.arange(k, dtype=np.int32)
    absorb.merge(tile, np.zeros(k, np.int32), at, patch, stamp, revision, rules)
    return SimpleNamespace(surface=surface, ground=below, changed=changed[: tile["count"][0]])


def assert_evidence(actual: Array, expected: Array) -> None:
    for name in evidence.EVIDENCE.names or ():
        assert actual[name] == expected[name], name


@pytest.mark.parametrize("row", TABLE)
def test_the_rows_of_the_merge(row: str) -> None:
    own, below, patch, own_after, below_after, changes = TABLE[row]
    out = merged(*(np.array([record(heights)]) for heights in (own, below, patch)), RULES)
    assert_evidence(out.surface[0], record(own_after))
    assert_evidence(out.ground[0], record(below_after))
    assert out.surface["changes"][0] == changes
    assert (out.surface["merges"][0], out.surface["stamp"][0], out.surface["revision"][0]) == (1, 5, 7)


@pytest.mark.parametrize("row", TABLE)
def test_the_static_merge_has_one_row(row: str) -> None:
    own, below, patch, *_ = TABLE[row]
    out = merged(*(np.array([record(heights)]) for heights in (own, below, patch)), STATIC)
    assert_evidence(out.surface[0], record(own + patch))
    assert out.surface["changes"][0] == 0


def test_a_row_of_the_merge_does_not_hang_on_the_zero_of_heights() -> None:
    for base in (-400.0, 8_000.0):
        for own, below, patch, own_after, below_after, changes in TABLE.values():
            lifted = [tuple(base + h for h in heights) for heights in (own, below, patch, own_after, below_after)]
            out = merged(*(np.array([record(heights)]) for heights in lifted[:3]), RULES)
            assert_evidence(out.surface[0], record(lifted[3]))
            assert_evidence(out.ground[0], record(lifted[4]))
            assert out.surface["changes"][0] == changes


LEVELS = st.sampled_from([-120_000, 0, 9_000, 15_000, 19_999, 20_000, 20_001, 160_000, 300_000, 2_000_000_000])
"""Ticks: a pit, the ground, around the tolerance of 20,000, a roof, a mountain."""
SPREADS = st.sampled_from([0, 0, 3, 2_000, 44_721, 44_722, 200_000])
"""Around the square root of the variance that makes a cell vertical: 44,721 ticks."""


@st.composite
def heights(draw: st.DrawFn, least: int = 1) -> list[int]:
    level, spread = draw(LEVELS), draw(SPREADS)
    return [level + spread * k for k in draw(st.lists(st.integers(-1, 1), min_size=least, max_size=6))]


CELLS = st.lists(st.tuples(heights(), heights(least=0), heights()), min_size=1, max_size=12)


@given(cells=CELLS, static=st.booleans())
@settings(max_examples=150)
def test_the_merge_kernel_equals_the_table(cells: list[tuple[list[int], ...]], static: bool) -> None:
    rules = STATIC if static else RULES
    own, below, patch = (np.array([record_of_ticks(cell[part]) for cell in cells]) for part in range(3))
    out = merged(own, below, patch, rules)
    for k in range(len(cells)):
        surface, ground_after, changed = absorb.absorb_reference(own[k], below[k], patch[k], rules)
        assert_evidence(out.surface[k], surface)
        assert_evidence(out.ground[k], ground_after)
        assert out.surface["changes"][k] == changed
    np.testing.assert_array_equal(out.changed, np.arange(len(cells)))


@given(cells=CELLS)
@settings(max_examples=100)
def test_a_ghost_does_not_outlive_a_look_at_the_ground(cells: list[tuple[list[int], ...]]) -> None:
    """Whatever a cell was, a flat patch leaves it within the tolerance of what was just seen."""
    own, below, patch = (np.array([record_of_ticks(cell[part]) for cell in cells]) for part in range(3))
    out = merged(own, below, patch, RULES)
    flat = ~absorb.vertical(patch, RULES)
    off_m = evidence.mean_m(out.surface) - evidence.mean_m(patch)
    assert (np.abs(off_m[flat]) <= GHOST_M + 1e-9).all()


# --- the fold --------------------------------------------------------------------------------------------------------


def cell_of(own: list[int], below: list[int], stamp: int, revision: int) -> Array:
    """A CELL record; unknown without heights."""
    cell = np.zeros((), absorb.CELL)
    if not own:
        return cell
    for name in evidence.EVIDENCE.names or ():
        cell[name] = record_of_ticks(own)[name]
        cell[f"ground_{name}"] = record_of_ticks(below)[name]
    cell["stamp"], cell["revision"], cell["merges"], cell["changes"] = stamp, revision, 3, 1
    return cell


@st.composite
def contributions(draw: st.DrawFn, stamps_differ: bool) -> list[Array]:
    """(M,) cells of each of two to four robots."""
    robots, m = draw(st.integers(2, 4)), draw(st.integers(1, 5))
    out = np.zeros((robots, m), absorb.CELL)
    for k in range(m):
        stamps = draw(st.lists(st.integers(1, 20), min_size=robots, max_size=robots, unique=stamps_differ))
        for r in range(robots):
            out[r, k] = cell_of(draw(heights(least=0)), draw(heights(least=0)), stamps[r], 1 + r)
    return list(out)


@given(cells=contributions(stamps_differ=True), random=st.randoms(use_true_random=False))
@settings(max_examples=80)
def test_the_fold_does_not_hang_on_the_order_of_its_input(cells: list[Array], random: Any) -> None:
    """Stamps decide. Where they are equal robots' names do, in whose order `fold` is given them."""
    model = make_model("elevation")
    shuffled = cells.copy()
    random.shuffle(shuffled)
    assert fold(model, cells, ONE_TILE).tobytes() == fold(model, shuffled, ONE_TILE).tobytes()


@given(cells=contributions(stamps_differ=False))
@settings(max_examples=60)
def test_a_robot_that_saw_nothing_is_neutral_in_the_fold(cells: list[Array]) -> None:
    model = make_model("elevation")
    nothing = np.zeros_like(cells[0])
    folded = fold(model, cells, ONE_TILE).tobytes()
    for place in range(len(cells) + 1):
        assert fold(model, [*cells[:place], nothing, *cells[place:]], ONE_TILE).tobytes() == folded


def test_robots_that_saw_a_car_before_and_after_one_another() -> None:
    """The newest look counts, whoever had it; ground that one robot cached serves another's."""

    def seen(own: tuple[float, ...], stamp: int, below: tuple[float, ...] = ()) -> Array:
        own_ticks, below_ticks = ([int(h) for h in evidence.ticks(np.array(part))] for part in (own, below))
        return np.array([cell_of(own_ticks, below_ticks, stamp, 1)])

    def fused(*cells: Array) -> float:
        model = make_model("elevation")
        return float(model.layers["height"].compute(fold(model, cells, ONE_TILE), Reading(ONE_TILE, 0))[0])

    assert fused(seen(GROUND_AT_0, 1), seen(WALL, 2)) == pytest.approx(1.4)
    assert fused(seen(GROUND_AT_0, 3), seen(WALL, 2)) == pytest.approx(0.01)
    assert fused(seen(WALL, 2, GROUND_AT_0), seen(GROUND_AGAIN, 3)) == pytest.approx(0.05 / 3)
    assert fused(seen(GROUND_AT_0, 1), seen(WALL, 2), seen(GROUND_AGAIN, 3)) == pytest.approx(0.05 / 3)
    assert fused(seen(GROUND_AT_0, 1), seen(FLOOR, 2), seen(GROUND_AGAIN, 3)) == pytest.approx(0.05 / 3)
