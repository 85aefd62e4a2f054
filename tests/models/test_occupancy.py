"""The occupancy model: its formulas by hand, its laws, and what becomes of bad readings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from terrafuse.errors import InputError
from terrafuse.export.looks import look_of
from terrafuse.kernels import occupancy
from terrafuse.kernels.occupancy import CELL, MOST_UPDATES, READING, take, take_reference
from terrafuse.kernels.occupancy_sonar import MAX_CONE_CELLS, evidence, ticks_of
from terrafuse.kernels.rays import MAX_RAY_CELLS
from terrafuse.lattice import Lattice
from terrafuse.mapper import Mapper
from terrafuse.models import make_model
from terrafuse.models.occupancy import FREE, OCCUPIED, UNDECIDED, Occupancy
from terrafuse.replica import Replica
from terrafuse.testing.deltas import SECOND_NS, deltas_of
from terrafuse.types import Array, Beam, Pose, Scan
from terrafuse.views import cells_in, chosen_layers, mosaic

LATTICE = Lattice(1.0, 20.0)
HIT, MISS = 8473, -4055
"""ln(0.7/0.3) = ln 2.33333 = 0.847298 and ln(0.4/0.6) = -ln 1.5 = -0.405465, in ticks of 1/10,000."""


def at(east_m: float, north_m: float, up_m: float = 0.0, yaw_rad: float = 0.0) -> Pose:
    return Pose.from_quaternion((east_m, north_m, up_m), (0, 0, math.sin(yaw_rad / 2), math.cos(yaw_rad / 2)))


def rays(*ends: Sequence[float], misses: Sequence[Sequence[float]] | None = None, **options: object) -> Scan:
    """A scan by a sensor in the middle of cell (0, 0), facing east."""
    missed = None if misses is None else np.array(misses, np.float64).reshape(-1, 3)
    scan = Scan(SECOND_NS, np.array(ends, np.float64).reshape(-1, 3), at(0.5, 0.5), missed)
    return replace(scan, **options)


def map_of(*scans: Scan, model: Occupancy | None = None, lattice: Lattice = LATTICE) -> Replica:
    mapper = Mapper("r1", lattice, model or Occupancy())
    for scan in scans:
        mapper.integrate(scan)
    replica = Replica(lattice, mapper.model)
    replica.apply(mapper.delta())
    return replica


def sums(replica: Replica) -> dict[tuple[int, int], int]:
    """Ticks of the known cells (i, j) from -20 to 20."""
    cells = cells_in(replica, (-20, -20, 20, 20), frozenset(replica.keys))
    j, i = np.nonzero(cells["updates"])
    return {(int(a) - 20, int(b) - 20): int(cells["sum"][b, a]) for a, b in zip(i, j, strict=True)}


def values(replica: Replica, name: str) -> Array:
    """A layer over cells (0, 0) to (9, 9), [j, i]."""
    return mosaic(replica, chosen_layers(replica, [name]), (0, 0, 10, 10))[name]


# --- log-odds --------------------------------------------------------------------------------------------------------


def test_log_odds_are_the_logarithm_of_the_odds() -> None:
    """ln(p/(1-p)): 0 of 0.5, ln(1/9) = -2.197225 of 0.1, ln 99 = 4.595120 of 0.99."""
    assert [occupancy.ticks(p) for p in (0.5, 0.1, 0.99)] == [0, -21972, 45951]
    assert (occupancy.ticks(0.7), occupancy.ticks(0.4)) == (HIT, MISS)


@pytest.mark.parametrize("p", [0.5, 0.1, 0.99])
def test_probability_of_log_odds_of_p_is_p(p: float) -> None:
    """As OctoMap's tests state it."""
    assert occupancy.probability(np.array(occupancy.ticks(p) / occupancy.TICKS_PER_NAT)) == pytest.approx(p, abs=2.5e-5)


def test_evidence_adds_and_is_read_as_a_probability() -> None:
    """A hit and a miss: 0.8473 - 0.4055 = 0.4418, p = 1/(1 + e^-0.4418) = 1/1.642878 = 0.608688."""
    replica = map_of(rays((2, 0, 0)), rays((4, 0, 0)))
    assert sums(replica)[2, 0] == HIT + MISS
    assert values(replica, "log_odds")[0, 2] == pytest.approx(0.4418)
    assert values(replica, "occupancy")[0, 2] == pytest.approx(0.608688, abs=1e-6)


def test_the_sum_goes_on_where_what_is_read_stops() -> None:
    """Ten hits are 84,730 ticks, read as 5: p = 1/(1 + e^-5) = 0.993307. Nine misses leave 48,235, read as they are."""
    hits = [rays((2, 0, 0))] * 10
    replica = map_of(*hits)
    assert sums(replica)[2, 0] == 84_730
    assert values(replica, "log_odds")[0, 2] == 5.0
    assert values(replica, "occupancy")[0, 2] == pytest.approx(0.993307, abs=1e-6)
    assert values(map_of(*hits, *[rays((4, 0, 0))] * 9), "log_odds")[0, 2] == pytest.approx(4.8235)


def test_states() -> None:
    """One hit, p = 0.7, is occupied; one miss, 0.4, undecided; two, 1/(1 + e^0.811) = 0.308, free; nobody's is NaN."""
    state = values(map_of(rays((3, 0, 0)), rays((2, 0, 0))), "state")
    assert state[0, :4].tolist() == [FREE, FREE, UNDECIDED, OCCUPIED]
    assert np.isnan(state[0, 4])


@pytest.mark.parametrize(("ticks", "state"), [(-6191, FREE), (-6190, UNDECIDED), (6190, UNDECIDED), (6191, OCCUPIED)])
def test_states_change_at_035_and_065(ticks: int, state: int) -> None:
    """ln(0.35/0.65) = -0.6190392."""
    cells = np.zeros((1, 1), CELL)
    cells["sum"], cells["updates"] = ticks, 2
    assert Occupancy().state(cells)[0, 0] == state


def test_the_maximum_range_is_100_m() -> None:
    """From the middle of cell (0, 0): 99 m away is a hit in cell 99; 101 m away clears up to 100 m, in cell 100."""
    lattice = Lattice(1.0, 200.0)
    assert (cells_of_row(rays((99, 0, 0)), lattice)[98:102] == [MISS, HIT, 0, 0]).all()
    assert (cells_of_row(rays((101, 0, 0)), lattice)[98:102] == [MISS, MISS, MISS, 0]).all()


def cells_of_row(scan: Scan, lattice: Lattice) -> Array:
    """The sums of the cells (0, 0) to (199, 0)."""
    replica = map_of(scan, lattice=lattice)
    return cells_in(replica, (0, 0, 200, 1), frozenset(replica.keys))["sum"][0]


def test_what_layers_say_of_a_cell() -> None:
    first, second = rays((2, 0, 0)), rays((2, 0, 0), stamp_ns=3 * SECOND_NS)
    replica = map_of(first, second)
    assert values(replica, "updates")[0, 2] == 2
    assert values(replica, "stamp")[0, 2] == pytest.approx(3.0)
    assert replica.model.occupied.name == replica.model.picture_layer == "occupancy"
    for name in replica.model.layers:
        assert np.isnan(values(replica, name)[5, 5])


# --- rays ------------------------------------------------------------------------------------------------------------


def test_a_ray_clears_what_it_crosses_and_marks_where_it_ends() -> None:
    assert sums(map_of(rays((3, 0, 0)))) == {(0, 0): MISS, (1, 0): MISS, (2, 0): MISS, (3, 0): HIT}


def test_within_a_scan_hits_win_and_each_cell_counts_once() -> None:
    """Three rays hit (2, 0), two more pass through it: one hit."""
    ends = [(2, 0, 0), (2, 0.1, 0), (2, -0.1, 0), (4, 0, 0), (5, 0, 0)]
    for scan in (rays(*ends), rays(*ends[::-1])):
        replica = map_of(scan)
        assert sums(replica)[2, 0] == HIT
        assert sums(replica)[0, 0] == MISS
        assert np.nanmax(values(replica, "updates")) == 1


def test_a_miss_clears_up_to_its_end_and_marks_nothing() -> None:
    assert sums(map_of(rays(misses=[(2, 0, 0)]))) == {(0, 0): MISS, (1, 0): MISS, (2, 0): MISS}


def test_a_reading_at_or_beyond_the_maximum_clears_up_to_it() -> None:
    beam = Beam(max_range_m=2.0)
    for end in (2.0, 2.5, 1e6):
        assert sums(map_of(rays((end, 0, 0), beam=beam))) == {(0, 0): MISS, (1, 0): MISS, (2, 0): MISS}
        assert sums(map_of(rays((end, 0, 0)), model=Occupancy(max_range_m=2.0))) == {(k, 0): MISS for k in range(3)}
    done = Mapper("r", LATTICE, Occupancy()).integrate(rays((5, 0, 0), (1, 0, 0), beam=beam))
    assert done.dropped == {"at or beyond max_range_m: cleared up to it": 1}


def test_the_maximum_in_float32_is_still_the_maximum() -> None:
    """7·(cos 40°, sin 40°) in float32 is 6.9999997 m long: no echo."""
    end = np.array([[7 * math.cos(math.radians(40)), 7 * math.sin(math.radians(40)), 0]], np.float32)
    assert set(sums(map_of(rays(points=end, beam=Beam(max_range_m=7.0)))).values()) == {MISS}


def test_a_far_point_costs_no_more_than_the_longest_ray() -> None:
    """However large the range gate is; 4096 cells are 410 m at 0.1 m."""
    lattice = Lattice(0.1, 40.0)
    mapper = Mapper("r", lattice, Occupancy(max_range_m=1e9))
    for end in ((1e8, 0, 0), (0, -1e8, 0), (1e8, 1e8, 0)):
        assert mapper.integrate(rays(end)).cells <= 2 * MAX_RAY_CELLS
    sonar = Beam(half_angle_rad=0.2, range_error_m=0.1)
    assert mapper.integrate(rays((1e8, 0, 0), beam=sonar)).cells <= MAX_CONE_CELLS**2


def test_bad_points_are_dropped_and_counted() -> None:
    bad = [(math.nan, 0, 0), (math.inf, 0, 0), (0, 0, math.nan), (1e300, 0, 0), (1e20, 0, 0), (0, 0, 0), (0.05, 0, 0)]
    mapper = Mapper("r", LATTICE, Occupancy(min_range_m=0.1))
    done = mapper.integrate(rays(*bad, misses=[(math.nan, 0, 0), (0, 0, 0), (math.inf, 0, 0)]))
    assert done.cells == 0
    assert done.dropped == {
        "not finite or beyond the lattice": 5,
        "nearer than min_range_m": 2,
        "miss not finite, beyond the lattice or nearer than min_range_m": 3,
    }


def test_beams_may_start_elsewhere() -> None:
    """From (1, 2) off the sensor, in its frame, which is turned north: from world (0.5 - 2, 0.5 + 1)."""
    scan = rays((4, 2, 0), origins=np.array([[1.0, 2.0, 0.0]]), T_world_sensor=at(0.5, 0.5, yaw_rad=math.pi / 2))
    assert sums(map_of(scan)) == {(-2, 1): MISS, (-2, 2): MISS, (-2, 3): MISS, (-2, 4): HIT}


def test_beams_of_one_scan_start_near_each_other() -> None:
    """Else one scan could ask for any amount of memory."""
    origins = np.array([[0.0, 0, 0], [2000, 0, 0], [1000, 0, 0]])
    scan = rays((1, 0, 0), (2001, 0, 0), misses=[(1001, 0, 0)], origins=origins)
    done = Mapper("r", LATTICE, Occupancy()).integrate(scan)
    assert (done.cells, done.dropped) == (4, {"start of beam far from the others'": 1})
    with pytest.raises(InputError, match="2 points and misses has 1 origins"):
        Mapper("r", LATTICE, Occupancy()).integrate(rays((1, 0, 0), (2, 0, 0), origins=origins[:1]))


def test_only_a_slice_of_heights_counts() -> None:
    """The sensor is 1 m up and the slice ±0.25 m. A ray to the ground 4 m away leaves the slice after 1 m; one that
    rises 0.2 m in 3 m stays in it."""
    ground, wall = (4.0, 0, -1.0), (0, 3.0, 0.2)
    scan = rays(ground, wall, T_world_sensor=at(0.5, 0.5, up_m=1.0))
    assert sums(map_of(scan)) == {
        (0, 0): MISS, (1, 0): MISS, (0, 1): MISS, (0, 2): MISS, (0, 3): HIT
    }  # fmt: skip
    done = Mapper("r", LATTICE, Occupancy()).integrate(scan)
    assert done.dropped == {"outside min_z_m to max_z_m: cleared within": 1}
    assert sums(map_of(scan, model=Occupancy(min_z_m=-1.1)))[4, 0] == HIT


def test_a_slice_above_the_sensor_begins_where_a_ray_enters_it() -> None:
    """From 0.5 to 1 m above it: a ray that rises 1:2 is in it from 1 m to 2 m away, and ends within."""
    scan = rays((2.0, 0, 1.0), (0, 5, 0))
    assert sums(map_of(scan, model=Occupancy(min_z_m=0.5, max_z_m=1.0))) == {(1, 0): MISS, (2, 0): HIT}


def test_the_slice_is_level_however_the_sensor_tilts() -> None:
    """Pitched down by 30°, a beam along its axis falls 0.5 m in each."""
    pitch = Pose.from_quaternion((0.5, 0.5, 5.0), (0, math.sin(math.radians(15)), 0, math.cos(math.radians(15))))
    assert set(sums(map_of(rays((4, 0, 0), T_world_sensor=pitch))).values()) == {MISS}


def test_a_sensor_that_is_believed_half_says_half_as_far_from_even() -> None:
    """0.7 becomes 0.6, ln 1.5 = 0.405465; 0.4 becomes 0.45, ln(0.45/0.55) = -0.200671."""
    assert sums(map_of(rays((1, 0, 0), beam=Beam(reliability=0.5)))) == {(0, 0): -2007, (1, 0): 4055}


def test_a_circular_room() -> None:
    """2 m around at 0.05 m: all that is occupied lies 2 m away within a cell, as OctoMap's tests ask of a sphere."""
    angle = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    ends = 2 * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    lattice = Lattice(0.05, 10.0)
    replica = map_of(rays(points=ends, T_world_sensor=at(0, 0)), lattice=lattice)
    cells = cells_in(replica, (-60, -60, 60, 60), frozenset(replica.keys))
    j, i = np.nonzero(cells["sum"] > 0)
    distance = np.hypot(lattice.cell_centre(i - 60), lattice.cell_centre(j - 60))
    assert distance.mean() == pytest.approx(2.0, abs=0.05)
    inner = np.hypot(*(lattice.cell_centre(np.arange(-60, 60)[s]) for s in np.ix_(range(120), range(120)))) < 1.9
    assert (cells["sum"][inner] < 0).all()


# --- sonars: Elfes' formulas -----------------------------------------------------------------------------------------

CONE = {"reading": 2.0, "echo": True, "half_angle": 0.2, "error": 0.5, "nearest": 0.25, "most_empty": 0.95}


def said(delta: float, theta: float, **changes: object) -> float:
    return float(evidence(delta, theta, *{**CONE, "most_occupied": 0.9, **changes}.values()))


def test_evidence_of_empty_before_the_echo() -> None:
    """E_r = 1 - ((1 - 0.25)/(2 - 0.5 - 0.25))² = 1 - 0.6² = 0.64, E_a = 1 - (0.1/0.2)² = 0.75: 0.48.

    p = ½(1 - 0.48) = 0.26; ln(0.26/0.74) = -1.045969."""
    assert said(1.0, 0.1) == pytest.approx(-0.48)
    assert ticks_of(-0.48) == -10460


def test_evidence_of_occupied_about_the_echo() -> None:
    """O_r = 1 - ((2.2 - 2)/0.5)² = 0.84, O_a = 0.75: 0.63. p = ½(1 + 0.63) = 0.815; ln(0.815/0.185) = 1.482832."""
    assert said(2.2, 0.1) == pytest.approx(0.63)
    assert ticks_of(0.63) == 14828


def test_evidence_ends_with_the_cone() -> None:
    assert said(1.0, 0.2) == said(2.0, 0.2) == 0.0
    assert said(1.5, 0.0) == said(2.5, 0.0) == said(3.0, 0.0) == 0.0
    assert said(0.2, 0.0) == 0.0  # nearer than R_min nothing is known


def test_evidence_stays_below_certainty() -> None:
    """E = O = 1 on the axis, at R_min and at the echo."""
    assert said(0.25, 0.0) == -0.95
    assert said(2.0, 0.0) == 0.9


def test_a_reading_at_the_maximum_marks_nothing() -> None:
    assert said(1.0, 0.1, echo=False) == pytest.approx(-0.48)
    assert said(2.0, 0.0, echo=False) == 0.0


SONAR = Beam(half_angle_rad=0.1, range_error_m=0.5, max_range_m=7.0)
"""In cells of 1 m it holds, on its axis, those up to 5 m away: 0.1 rad is 0.5 m there."""


def test_a_sonar_in_the_map() -> None:
    """r = 3, ε = 0.5, R_min = 0. On the axis, δ = 0: 1, limited to 0.95, ln(1.95/0.05) = 3.663562. δ = 1: 1 - (1/2.5)²
    = 0.84, ln(1.84/0.16) = 2.442347. δ = 2: 0.36, ln(1.36/0.64) = 0.753772. δ = 3: 1, limited to 0.9, ln 19 = 2.944439.
    """
    expected = {(0, 0): -36636, (1, 0): -24423, (2, 0): -7538, (3, 0): 29444}
    assert sums(map_of(rays((3, 0, 0), beam=SONAR))) == expected
    half = sums(map_of(rays((3, 0, 0), beam=replace(SONAR, reliability=0.5))))
    assert half[3, 0] == 9694  # evidence 0.45: ln(1.45/0.55) = 0.969401


def test_every_reading_of_a_ring_counts() -> None:
    """So it makes no difference whether sonars fire in one scan or in turn."""
    angles = np.arange(16) * np.pi / 8
    ends = 4 * np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])
    wide = Beam(half_angle_rad=0.25, range_error_m=0.5, max_range_m=7.0)
    together = map_of(rays(*ends, beam=wide), lattice=Lattice(0.5, 20.0))
    apart = map_of(*(rays(end, beam=wide) for end in ends), lattice=Lattice(0.5, 20.0))
    assert together.digest() == apart.digest()
    assert values(together, "updates")[1, 1] == 16  # every sonar hears its own cell


def test_a_sonar_that_looks_straight_up_says_nothing() -> None:
    assert sums(map_of(rays((0, 0, 3), beam=SONAR))) == {}


def test_a_band_is_at_least_a_cell_wide() -> None:
    """Of a centimetre about a reading there is mostly no cell's centre: 2.3 m ends in cell 2, whose centre is at 2."""
    assert sums(map_of(rays((2.3, 0, 0), beam=replace(SONAR, range_error_m=0.01))))[2, 0] > 0


# --- nav2's range sensor layer: facts stated by its tests; 254 is p > ½, and 0, where something was seen, p < ½ -------


def nav2(*readings: tuple[float, float, float]) -> dict[tuple[int, int], int]:
    """A sonar of 10° in the middle of each cell (x, y), facing east, reads r; range error half a cell."""
    beam = Beam(half_angle_rad=math.radians(5), range_error_m=0.5, max_range_m=7.0)
    return sums(map_of(*(rays((r, 0, 0), T_world_sensor=at(x + 0.5, y + 0.5), beam=beam) for x, y, r in readings)))


def test_nav2_an_echo_marks_and_a_reading_at_the_maximum_clears() -> None:
    """Marked by ln 19 = 2.944; cleared by E_r = 1 - (2/6.5)² = 0.905, ln(1.905/0.095) = 3.001, the surer of the two."""
    assert nav2((2, 5, 2.0))[4, 5] > 0
    assert nav2((2, 5, 2.0), (2, 5, 7.0))[4, 5] < 0


def test_nav2_a_robot_drives_east() -> None:
    """What was marked 1 m before the next sensor stays: 2.944 against 2.442 of emptiness."""
    cells = nav2((2, 5, 3.0), (4, 5, 3.0), (6, 5, 3.0))
    assert [cells[x, 5] > 0 for x in (5, 6, 7, 8, 9)] == [True, False, True, False, True]
    assert cells[6, 5] < 0
    assert cells[8, 5] < 0


def test_nav2_a_robot_drives_north() -> None:
    """Between the readings nothing was seen: nav2's costmap starts as free, ours as unknown."""
    cells = nav2((2, 3, 1.0), (2, 5, 1.0), (2, 7, 1.0))
    assert all(cells[3, y] > 0 for y in (3, 5, 7))
    assert not {(3, 4), (3, 6)} & cells.keys()


# --- kernels against their reference, and the laws -------------------------------------------------------------------


def random_cells(rng: np.random.Generator, *shape: int) -> Array:
    cells = np.zeros(shape, CELL)
    cells["sum"], cells["stamp"] = rng.integers(-(2**40), 2**40, shape), rng.integers(0, 2**62, shape)
    cells["updates"], cells["revision"] = rng.integers(1, 2**32, shape), rng.integers(1, 2**32, shape)
    cells[rng.random(shape) < 0.3] = np.zeros((), CELL)
    return cells


@given(st.integers(0, 2**32 - 1))
def test_taking_in_a_scan_equals_its_reference(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ours = random_cells(rng, 50)
    theirs, where = ours.copy(), rng.permutation(50)[:20].astype(np.int32)
    readings = np.zeros(20, READING)
    readings["ticks"], readings["updates"] = rng.integers(-50_000, 50_000, 20), rng.integers(1, 5, 20)
    take(ours, where, readings, 2**61, 7)
    take_reference(theirs, where, readings, 2**61, 7)
    assert ours.tobytes() == theirs.tobytes()


@given(st.integers(0, 2**32 - 1))
def test_fusing_adds_in_any_order_and_unknown_is_neutral(seed: int) -> None:
    a, b, c = (random_cells(np.random.default_rng((seed, k)), 40) for k in range(3))
    fuse, nothing = occupancy.fuse, np.zeros(40, CELL)
    assert fuse(a, b).tobytes() == fuse(b, a).tobytes()
    assert fuse(fuse(a, b), c).tobytes() == fuse(a, fuse(b, c)).tobytes()
    assert fuse(a, nothing).tobytes() == fuse(nothing, a).tobytes() == a.tobytes()
    np.testing.assert_array_equal(fuse(a, b)["sum"], a["sum"] + b["sum"])


def test_updates_stop_at_their_most() -> None:
    cells = np.zeros(2, CELL)
    cells["updates"] = MOST_UPDATES - 1, 5
    assert occupancy.fuse(cells, cells)["updates"].tolist() == [MOST_UPDATES, 10]


@given(st.integers(0, 2**32 - 1), st.sampled_from([(2, 2), (2, 3), (3, 2), (1, 6), (6, 2)]))
def test_coarsening_in_two_steps_is_coarsening_at_once(seed: int, steps: tuple[int, int]) -> None:
    k, m = steps
    cells = random_cells(np.random.default_rng(seed), 12, 24)
    assert occupancy.coarsen(occupancy.coarsen(cells, k), m).tobytes() == occupancy.coarsen(cells, k * m).tobytes()


@given(st.integers(0, 2**32 - 1))
def test_a_coarse_map_loses_no_wall(seed: int) -> None:
    """Whether robots coarsen first or the map is coarsened after: no coarse cell is freer than its most occupied one,
    and none is free of which a part was never seen."""
    one, two = (random_cells(np.random.default_rng((seed, k)), 12, 12) for k in range(2))
    after = occupancy.coarsen(occupancy.fuse(one.ravel(), two.ravel()).reshape(12, 12), 3)
    before = occupancy.fuse(occupancy.coarsen(one, 3).ravel(), occupancy.coarsen(two, 3).ravel()).reshape(4, 4)
    assert (before["sum"] >= after["sum"]).all()
    unseen = (one["updates"] == 0).reshape(4, 3, 4, 3).any(axis=(1, 3))
    assert (occupancy.coarsen(one, 3)["sum"][unseen] >= 0).all()


def test_coarsening_by_hand() -> None:
    """Free ones of -3 and -1 with a wall of 2, and unseen beside free: 2, and 0."""
    cells = np.zeros((2, 4), CELL)
    cells["sum"] = [[-3, -1, -5, 0], [2, -1, -5, -5]]
    cells["updates"] = [[1, 2, 3, 0], [1, 1, 1, 1]]
    coarse = occupancy.coarsen(cells, 2)
    assert coarse["sum"].tolist() == [[2, 0]]
    assert coarse["updates"].tolist() == [[5, 5]]


@given(st.integers(0, 2**32 - 1), st.integers(2, 5))
def test_robots_that_share_the_scans_make_the_map_of_one_that_made_all(seed: int, robots: int) -> None:
    """The same bytes of the global map, rays and cones, whoever made which scan."""
    rng = np.random.default_rng(seed)
    scans = [
        Scan(
            int(rng.integers(1, 9)) * SECOND_NS,
            np.column_stack([rng.uniform(-4, 4, (12, 2)), np.zeros(12)]),
            at(*rng.uniform(-5, 5, 2)),
            beam=SONAR if rng.random() < 0.3 else Beam(),
        )
        for _ in range(8)
    ]
    lattice, model = Lattice(0.5, 4.0), make_model("occupancy")
    together, shared = Replica(lattice, model), Replica(lattice, model)
    for delta in deltas_of("all", scans, lattice, model, every=3):
        together.apply(delta)
    whose = rng.integers(0, robots, len(scans))
    for robot in rng.permutation(robots):
        mine = [scan for scan, owner in zip(scans, whose, strict=True) if owner == robot]
        for delta in deltas_of(f"r{robot}", mine, lattice, model):
            shared.apply(delta)
    assert shared.digest() == together.digest()


def test_settings_are_checked() -> None:
    for wrong, message in (
        ({"hit_probability": 0.5}, "miss < 0.5 < hit"),
        ({"miss_probability": 0.0}, "miss < 0.5 < hit"),
        ({"max_empty_evidence": 1.0}, "max_empty_evidence 1.0"),
        ({"max_log_odds": 0}, "max_log_odds 0"),
        ({"free_threshold": 0.6}, "free ≤ 0.5"),
        ({"min_range_m": 200.0}, "range gate"),
        ({"max_range_m": math.inf}, "range gate"),
        ({"min_z_m": 1.0}, "slice of heights"),
    ):
        with pytest.raises(InputError, match=message):
            make_model("occupancy", wrong)
    with pytest.raises(InputError, match=r"points are \(N, 3\)"):
        Mapper("r", LATTICE, Occupancy()).integrate(rays(points=np.zeros((2, 2))))


def test_pictures_are_dark_where_it_is_occupied_and_white_where_it_is_free() -> None:
    pytest.importorskip("matplotlib")
    look = look_of(Occupancy().occupied)
    assert look.colours()(look.scale(np.array([0.3, 0.6]))([0.0, 1.0]))[:, :3].tolist() == [[1, 1, 1], [0, 0, 0]]
    assert look.unknown not in ("white", "black")


def test_a_band_that_would_take_all_memory_is_refused() -> None:
    """A range error of 3000 m is 6000 cells of 0.5 m, and 500 are the most."""
    beam = Beam(max_range_m=5.0, half_angle_rad=0.2, range_error_m=3000.0)
    scan = Scan(1, np.array([[2.0, 0.0, 0.0]]), Pose.identity(), beam=beam)
    with pytest.raises(InputError, match="a range error of 3000 m is over 500 cells"):
        make_model("occupancy").observer(Lattice(0.5, 4.0))(scan)
