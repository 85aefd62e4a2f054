"""What odometry and GNSS read of the truth: by hand without noise, by their spread with it."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from terrafuse.errors import InputError
from terrafuse.navigate.ekf import arc
from terrafuse.navigate.readings import DIFFERENTIAL, NO_FIX, SINGLE, GnssModel, GnssNoise, OdometryNoise
from terrafuse.simulate.gnss import Gnss
from terrafuse.simulate.odometry import Flaws, Odometer, drawn_flaws, way
from terrafuse.simulate.regions import Region, StaticLayer

SECOND_NS = 1_000_000_000
SILENT = OdometryNoise(forward_m=0, up_m=0, turn_rad=0, turn_share=0, scale=0, bias_rad_per_m=0)
ORIGIN = np.zeros(3)


def test_a_way_by_hand() -> None:
    """From (1, 2) heading east to (2, 3) heading north: a quarter of a circle of radius 1, π/2 long, to the left."""
    assert way(np.array([1, 2, 0]), 0.0, np.array([2, 3, 0.5]), pi / 2) == pytest.approx((pi / 2, pi / 2, 0.5))
    # Backwards: from there to here, heading north and then east.
    assert way(np.array([2, 3, 0]), pi / 2, np.array([1, 2, 0]), 0.0) == pytest.approx((-pi / 2, -pi / 2, 0))
    # Sideways slip is not noticed.
    assert way(ORIGIN, 0.0, np.array([3.0, 1.0, 0]), 0.0) == pytest.approx((3.0, 0.0, 0.0))


@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(-pi, pi))
def test_a_way_is_the_inverse_of_an_arc(forward: float, turn: float, yaw: float) -> None:
    there = np.append(arc(forward, turn, yaw)[0], 0.0)
    assert way(ORIGIN, yaw, there, yaw + turn)[:2] == pytest.approx((forward, turn), abs=1e-9)


def test_flaws_by_hand() -> None:
    """True 10.2 m with a scale of 2 % are read as 10 m; on each, 0.01 rad to the left go unseen: -0.1 is read."""
    rng = np.random.default_rng(0)
    odometer = Odometer(ORIGIN, 0.0, SILENT, Flaws(0.02, 0.01), rng)
    read = odometer.read(5, np.array([10.2, 0, 0.3]), 0.0)
    assert (read.stamp_ns, read.forward_m, read.turn_rad, read.up_m) == pytest.approx((5, 10.0, -0.1, 0.3))
    # The next reading starts where this one ended.
    assert odometer.read(6, np.array([10.2, 0, 0.3]), 0.5).forward_m == 0


def test_noise_spreads_as_told() -> None:
    """4 m and 1 rad at a time: way 0.02·√4, turn √(0.005²·4 + 0.02²·1), climb 0.01·√4. 2000 readings, within 6 %."""
    rng, noise = np.random.default_rng(1), OdometryNoise()
    there = np.append(arc(4.0, 1.0, 0.0)[0], 0.0)
    reads = [Odometer(ORIGIN, 0.0, noise, Flaws(0, 0), rng).read(1, there, 1.0) for _ in range(2000)]
    values = np.array([(read.forward_m, read.turn_rad, read.up_m) for read in reads])
    assert values.mean(axis=0) == pytest.approx([4.0, 1.0, 0.0], abs=0.005)
    assert values.std(axis=0) == pytest.approx([0.04, 0.02236, 0.02], rel=0.06)


def test_a_robot_that_stands_reads_nothing() -> None:
    odometer = Odometer(ORIGIN, 1.0, OdometryNoise(), Flaws(0.01, 0.01), np.random.default_rng(2))
    read = odometer.read(1, ORIGIN, 1.0)
    assert (read.forward_m, read.turn_rad, read.up_m) == (0, 0, 0)


def test_drift_grows_with_the_way() -> None:
    """100 m straight on, 200 robots: the ends spread by scale (1 m) and noise (0.02·√100 = 0.2 m) lengthwise."""
    rng, noise = np.random.default_rng(3), OdometryNoise()
    read = []
    for _ in range(200):
        odometer = Odometer(ORIGIN, 0.0, noise, drawn_flaws(noise, rng), rng)
        steps = [odometer.read(k, np.array([float(k), 0, 0]), 0.0).forward_m for k in range(1, 101)]
        read.append(sum(steps))
    # √(1² + 0.2²) = 1.02, within four standard deviations of a spread from 200: 1/√400 = 5 % each.
    assert np.std(read) == pytest.approx(1.02, rel=0.2)


def fixes(quality: int, count: int, seed: int, every_s: float = 1.0, model: GnssModel | None = None) -> np.ndarray:
    gnss = Gnss(model or GnssModel(), lambda x, y: quality, np.random.default_rng(seed))
    here = np.array([10.0, 20.0, 30.0])
    return np.array([gnss.read(round(k * every_s * SECOND_NS), here).position_m - here for k in range(count)])


def test_a_single_fix_errs_by_two_and_a_half_metres_and_slowly() -> None:
    """√(0.7² + 2.4²) = 2.5 east and north, 1.5 times as much up. A second later 99 % of 2.4² is the same error."""
    first = np.array([fixes(SINGLE, 2, seed) for seed in range(2000)])
    assert first[:, 0].std(axis=0) == pytest.approx([2.5, 2.5, 3.75], rel=0.06)
    assert first[:, 1].std(axis=0) == pytest.approx([2.5, 2.5, 3.75], rel=0.06)
    # Var of the difference: 2·0.49 + 2·5.76·(1 - exp(-1/100)) = 0.98 + 0.1146 = 1.0946.
    assert np.diff(first, axis=1)[:, 0, :2].std(axis=0) == pytest.approx([1.0462, 1.0462], rel=0.06)


def test_the_slow_error_forgets_itself() -> None:
    """With τ = 100 s, after 100 s a correlation of exp(-1)·2.4²/2.5² = 0.339 is left."""
    pairs = np.array([fixes(SINGLE, 2, seed, every_s=100.0)[:, 0] for seed in range(3000)])
    assert np.corrcoef(pairs.T)[0, 1] == pytest.approx(0.339, abs=0.06)


def test_a_differential_fix_errs_by_a_decimetre_each_time_anew() -> None:
    errors = fixes(DIFFERENTIAL, 3000, 4)
    assert errors.std(axis=0) == pytest.approx([0.1, 0.1, 0.15], rel=0.06)
    assert abs(np.corrcoef(errors[:-1, 0], errors[1:, 0])[0, 1]) < 0.08


def square(corner_m: float, side_m: float, value: int) -> Region:
    """From (corner, 0) to the east and north."""
    east_m = corner_m + side_m
    return Region(value, ((corner_m, 0.0), (east_m, 0.0), (east_m, side_m), (corner_m, side_m)))


def test_quality_follows_the_layer() -> None:
    """Differential, but single on a square, and none on one within it."""
    layer = StaticLayer(2, (square(0.0, 9.0, value=1), square(3.0, 6.0, value=0)))
    gnss = Gnss(GnssModel(), layer.at, np.random.default_rng(5))
    read = [gnss.read(k, np.array([x, 4.5, 0.0])) for k, x in enumerate([-1.0, 1.0, 4.5, 8.0, 10.0])]
    assert [fix.quality for fix in read] == [2, 1, NO_FIX, NO_FIX, 2]
    assert [bool(np.isfinite(fix.position_m).all()) for fix in read] == [True, True, False, False, True]


def test_quality_does_not_change_the_numbers_drawn() -> None:
    """A robot that comes through a gap has the same fixes after it as one that did not."""
    ways = []
    for gap_at_m in (100.0, 3.0):
        gnss = Gnss(GnssModel(), StaticLayer(2, (square(gap_at_m, 3.0, value=0),)).at, np.random.default_rng(6))
        ways.append([gnss.read(k * SECOND_NS, np.array([k, 1.0, 0.0])).position_m for k in range(10)])
    assert np.isnan(ways[1][3:6]).all()
    assert np.delete(ways[0], [3, 4, 5], axis=0).tolist() == np.delete(ways[1], [3, 4, 5], axis=0).tolist()


def test_outliers_are_as_frequent_and_as_far_as_told() -> None:
    gnss = Gnss(GnssModel(), lambda x, y: 2, np.random.default_rng(7), outlier_chance=0.2, outlier_m=50.0)
    off = np.hypot(*np.array([gnss.read(k, ORIGIN).position_m[:2] for k in range(2000)]).T)
    far = off > 10
    assert far.mean() == pytest.approx(0.2, abs=0.045)
    assert off[far].mean() == pytest.approx(50.0, abs=0.1)


def test_an_unknown_quality_is_refused() -> None:
    with pytest.raises(InputError, match="quality 7"):
        fixes(7, 1, 0)
    assert fixes(7, 1, 0, model=GnssModel({7: GnssNoise(0.0, 0.0)})).tolist() == [[0.0, 0.0, 0.0]]
