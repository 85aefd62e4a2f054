"""The pose filter: each equation by hand, each outcome of a fix, and its honesty about its own errors."""

from __future__ import annotations

import re
from collections.abc import Callable
from math import cos, pi, sin, sqrt
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from terrafuse.errors import InputError
from terrafuse.navigate.alignment import Alignment, at_fix
from terrafuse.navigate.ekf import (
    BIAS,
    SCALE,
    STATES,
    YAW,
    Estimate,
    arc,
    corrected,
    first_estimate,
    innovation,
    moved,
    waited,
    wrapped,
)
from terrafuse.navigate.pose_filter import PoseFilter, nees, rotation
from terrafuse.navigate.readings import DIFFERENTIAL, NO_FIX, SINGLE, Fix, GnssModel, GnssNoise, Odometry, OdometryNoise
from terrafuse.simulate.gnss import Gnss
from terrafuse.simulate.odometry import Odometer, drawn_flaws
from terrafuse.types import Floats, checked_pose

DOCS = Path(__file__).parents[2] / "docs"
SECOND_NS = 1_000_000_000
NOISE = OdometryNoise()
GNSS = GnssModel()
ORIGIN = np.zeros(3)


def start(yaw_rad: float = 0.0, sigma_m: float = 0.0, yaw_sigma_rad: float = 0.0) -> Estimate:
    return first_estimate(0, ORIGIN, yaw_rad, sigma_m, yaw_sigma_rad, NOISE)


def fix_at(x: float, y: float, z: float = 0.0, quality: int = DIFFERENTIAL, stamp_ns: int = 0) -> Fix:
    return Fix(stamp_ns, np.array([x, y, z]), quality)


# The equations


def test_waiting_by_hand() -> None:
    """Eq. 1: after 100 s (τ) exp(-1) of m is left. From m = 2 known exactly: 2/e, variance 1 - 1/e²."""
    mean, covariance = np.zeros(STATES), np.zeros((STATES, STATES))
    mean[6] = 2.0
    covariance[0, 7] = covariance[7, 0] = 0.5
    after = waited(Estimate(0, mean, covariance), 100 * SECOND_NS, GNSS)
    assert after.stamp_ns == 100 * SECOND_NS
    assert after.mean[6] == pytest.approx(2 * 0.36787944)
    assert np.diag(after.covariance)[6:] == pytest.approx([1 - 0.13533528] * 3)
    assert after.covariance[0, 7] == pytest.approx(0.5 * 0.36787944)


def test_a_quarter_circle_by_hand() -> None:
    """Eqs. 2, 3: a way of π/2 m while turning π/2 has radius 1: from heading east to (1, 1), heading north.

    A way of 2 m without a turn, heading north: (0, 2).
    """
    step, _ = arc(pi / 2, pi / 2, 0.0)
    assert step == pytest.approx([1.0, 1.0])
    assert arc(2.0, 0.0, pi / 2)[0] == pytest.approx([0.0, 2.0])
    assert arc(-2.0, 0.0, 0.0)[0] == pytest.approx([-2.0, 0.0])


@given(st.floats(-5, 5), st.floats(-3, 3), st.floats(-pi, pi))
def test_the_derivative_by_the_turn_is_that_of_the_arc(forward: float, turn: float, yaw: float) -> None:
    d = 1e-6
    numeric = (arc(forward, turn + d, yaw)[0] - arc(forward, turn - d, yaw)[0]) / (2 * d)
    assert arc(forward, turn, yaw)[1] == pytest.approx(numeric, abs=1e-8)


def test_moving_straight_by_hand() -> None:
    """Eqs. 2 to 5, measured 4 m ahead to the east, 0.1 m up, no turn. Scale 0.5 %, bias known to be 0.

    x = 1.005·4 = 4.02, z = 0.1. Variances with σ_s = 0.01, σ_b = 0.0005, σ_ψ = 0.1 rad at the start:
      x: (4·0.01)² from scale + 0.02²·4 random = 0.0016 + 0.0016 = 0.0032
      ψ: 0.1² + (4·0.0005)² + 0.005²·4 = 0.01 + 4e-6 + 1e-4 = 0.010104
      y: (4.02·0.1)² from yaw + (2.01·4·0.0005)² from bias + 2.01²·1e-4 random, as a turn bends the way by half
         = 0.16160400 + 0.0000161604 + 0.00040401 = 0.1620241704
      y and ψ: 4.02·0.01 + 2.01·4·0.0005·4·0.0005 + 2.01·1e-4 = 0.0402 + 8.04e-6 + 2.01e-4 = 0.04040904
      z: 0.01²·4 = 0.0004
    """
    before = start(yaw_sigma_rad=0.1)
    before.mean[SCALE] = 0.005
    after = moved(before, Odometry(0, 4.0, 0.0, 0.1), NOISE)
    assert after.mean[:4] == pytest.approx([4.02, 0.0, 0.1, 0.0])
    P = after.covariance
    assert np.diag(P)[:4] == pytest.approx([0.0032, 0.1620241704, 0.0004, 0.010104])
    assert P[1, YAW] == P[YAW, 1] == pytest.approx(0.04040904)
    assert P[0, SCALE] == pytest.approx(4 * 0.01**2)
    assert P[YAW, BIAS] == pytest.approx(4 * 0.0005**2)


def test_the_noise_of_a_turn_by_hand() -> None:
    """Eq. 4: turning 1 rad on the spot: variance 0.02²·1. The place stays known."""
    after = moved(start(), Odometry(0, 0.0, 1.0), NOISE)
    assert after.mean[YAW] == 1.0
    assert np.diag(after.covariance)[:4] == pytest.approx([0, 0, 0, 0.0004])


def test_a_bias_turns_by_hand() -> None:
    """A bias of 0.1 rad/m over 5π m is a quarter turn, unseen by odometry: radius 10 m, so (10, 10), heading north."""
    before = start()
    before.mean[BIAS] = 0.1
    after = moved(before, Odometry(0, 5 * pi, 0.0), NOISE)
    assert after.mean[:2] == pytest.approx([10.0, 10.0])
    assert after.mean[YAW] == pytest.approx(pi / 2)


@given(
    st.lists(st.floats(-0.5, 0.5), min_size=6, max_size=6),
    st.floats(-2, 2),
    st.floats(-1, 1),
)
def test_the_covariance_goes_by_the_derivatives_of_the_motion(state: list[float], forward: float, turn: float) -> None:
    """Without noise, P' = F P Fᵀ with the numeric derivative of the motion itself."""
    silent = OdometryNoise(forward_m=0, up_m=0, turn_rad=0, turn_share=0)
    mean = np.concatenate([state, np.zeros(3)])
    odometry = Odometry(0, forward, turn, 0.1)

    def motion(at: Floats) -> Floats:
        return moved(Estimate(0, at, np.eye(STATES)), odometry, silent).mean

    steps = np.eye(STATES) * 1e-6
    F = np.column_stack([(motion(mean + step) - motion(mean - step)) / 2e-6 for step in steps])
    rng = np.random.default_rng(1)
    root = rng.normal(size=(STATES, STATES))
    P = root @ root.T
    assert moved(Estimate(0, mean, P), odometry, silent).covariance == pytest.approx(F @ P @ F.T, abs=1e-5)


def test_a_fix_by_hand() -> None:
    """Eqs. 6 to 9: x known to 0.3 m, a differential fix (0.1 m) 0.5 m further east.

    S = 0.09 + 0.01 = 0.1, K = 0.9; x = 0.45, variance 0.09·0.1 = 0.009; distance² = 0.25/0.1 = 2.5.
    Up the fix errs by 0.15 m: S = 0.09 + 0.0225 = 0.1125, K = 0.8.
    """
    before = start(sigma_m=0.3)
    found = innovation(before, fix_at(0.5, 0.0, 0.0), GNSS)
    assert np.diag(found.S) == pytest.approx([0.1, 0.1, 0.1125])
    assert found.distance2 == pytest.approx(2.5)
    after = corrected(before, found)
    assert after.mean[:3] == pytest.approx([0.45, 0.0, 0.0])
    assert np.diag(after.covariance)[:3] == pytest.approx([0.009, 0.009, 0.018])
    assert innovation(before, fix_at(0.0, 0.0, 0.9), GNSS).distance2 == pytest.approx(0.81 / 0.1125)


def test_a_single_fix_is_believed_less_by_hand() -> None:
    """x known to 2.4 m, a single fix 1.0 m off: S = 5.76 + 2.4²·1 + 0.49 = 12.01.

    The place takes 5.76/12.01 of the metre, the slow error 2.4/12.01 of it, in its own unit.
    """
    after = corrected(start(sigma_m=2.4), innovation(start(sigma_m=2.4), fix_at(1, 0, quality=SINGLE), GNSS))
    assert after.mean[0] == pytest.approx(5.76 / 12.01)
    assert after.mean[6] == pytest.approx(2.4 / 12.01)
    assert after.covariance[0, 0] == pytest.approx(5.76 - 5.76**2 / 12.01)
    assert after.covariance[0, 6] == pytest.approx(-5.76 * 2.4 / 12.01)


def test_many_single_fixes_do_not_make_a_sure_place() -> None:
    """A hundred fixes within a second share one slow error: 2.4 m of it stay; of white, 0.7/√100 would."""
    filter_ = PoseFilter(start(sigma_m=100.0))
    for k in range(100):
        filter_.take(fix_at(0, 0, quality=SINGLE, stamp_ns=k * SECOND_NS // 100))
    assert sqrt(filter_.estimate.covariance[0, 0]) == pytest.approx(2.4, abs=0.03)


def test_a_fix_turns_the_heading_too() -> None:
    """10 m ahead with a heading known to 0.1 rad, then 0.5 m to the left: the heading must have been 0.05 more."""
    filter_ = PoseFilter(start(yaw_sigma_rad=0.1))
    filter_.move(Odometry(1, 10.0, 0.0))
    filter_.take(fix_at(10.0, 0.5, stamp_ns=1))
    assert filter_.estimate.mean[YAW] == pytest.approx(0.05, abs=0.005)


def test_rotation_by_hand() -> None:
    """Nose down by 0.1: ahead leads down. Right side down by 0.1: left leads up. Heading north: ahead is north."""
    assert rotation(0, 0.1, 0) @ [1, 0, 0] == pytest.approx([cos(0.1), 0, -sin(0.1)])
    assert rotation(0.1, 0, 0) @ [0, 1, 0] == pytest.approx([0, cos(0.1), sin(0.1)])
    assert rotation(0, 0, pi / 2) @ [1, 0, 0] == pytest.approx([0, 1, 0])
    assert rotation(0, 0.1, pi / 2) @ [1, 0, 0] == pytest.approx([0, cos(0.1), -sin(0.1)])


def test_the_pose_and_its_covariance() -> None:
    filter_ = PoseFilter(first_estimate(7, np.array([1.0, 2.0, 3.0]), pi / 2, [0.1, 0.2, 0.3], 0.4, NOISE))
    pose = filter_.pose(0.01, 0.02, tilt_sigma_rad=0.5)
    checked_pose(pose.T_world_base.matrix)
    assert pose.stamp_ns == 7
    assert pose.T_world_base.position.tolist() == [1, 2, 3]
    # x, y, z, roll, pitch, yaw
    assert np.diag(pose.covariance) == pytest.approx([0.01, 0.04, 0.09, 0.25, 0.25, 0.16])
    filter_.move(Odometry(8, 1.0, 0.0))
    turned = filter_.pose().covariance
    assert turned[0, 5] == filter_.estimate.covariance[0, YAW] != 0
    assert (turned == turned.T).all()


@given(st.floats(-100, 100))
def test_wrapped_angles_look_the_same_way(angle: float) -> None:
    assert -pi <= wrapped(angle) <= pi
    assert (cos(wrapped(angle)), sin(wrapped(angle))) == pytest.approx((cos(angle), sin(angle)), abs=1e-9)


def test_nees_by_hand() -> None:
    """0.2 m off with σ 0.1 is 4; the heading off by 0.1 beyond a full turn with σ 0.1 is 1."""
    estimate = first_estimate(0, np.array([0.2, 0, 0]), pi - 0.05, 0.1, 0.1, NOISE)
    assert nees(estimate, ORIGIN, -pi + 0.05) == pytest.approx(5.0)


# What becomes of fixes


def test_what_becomes_of_each_fix_is_counted() -> None:
    filter_ = PoseFilter(start(sigma_m=0.1))
    filter_.move(Odometry(100, 0.0, 0.0))
    before = filter_.estimate.mean.tolist()
    assert filter_.take(fix_at(0, 0, quality=NO_FIX, stamp_ns=100)) == "no_fix"
    assert filter_.take(fix_at(np.nan, 0, stamp_ns=100)) == "not_finite"
    assert filter_.take(fix_at(0, 0, stamp_ns=99)) == "late"
    assert filter_.take(fix_at(5.0, 0, stamp_ns=100)) == "gated"
    assert filter_.estimate.mean.tolist() == before
    assert filter_.take(fix_at(0.1, 0, stamp_ns=100)) == "used"
    assert filter_.counts == {"no_fix": 1, "not_finite": 1, "late": 1, "gated": 1, "used": 1}


def test_the_gate_by_hand() -> None:
    """S = 0.1² + 0.1² = 0.02: the gate of 16.27 lies at √(16.27·0.02) = 0.5704 m."""
    for off_m, outcome in ((0.570, "used"), (0.571, "gated")):
        assert PoseFilter(start(sigma_m=0.1)).take(fix_at(off_m, 0)) == outcome


def test_what_can_t_be_used_is_refused() -> None:
    filter_ = PoseFilter(start())
    filter_.move(Odometry(5, 0.0, 0.0))
    with pytest.raises(InputError, match="quality 3"):
        filter_.take(fix_at(0, 0, quality=3, stamp_ns=5))
    with pytest.raises(InputError, match="NaN"):
        filter_.move(Odometry(6, np.nan, 0.0))
    with pytest.raises(InputError, match="4 after 5"):
        filter_.move(Odometry(4, 0.0, 0.0))


# Alignment


def test_a_start_at_a_fix_by_hand() -> None:
    """Eq. 11: the place errs by 0.49 + 5.76 = 6.25 m², up by 1.5² as much; with m it hangs together by -2.4."""
    P = at_fix(fix_at(3, 4, quality=SINGLE), 0.0, 1.0, NOISE, GNSS).covariance
    assert np.diag(P)[:3] == pytest.approx([6.25, 6.25, 14.0625])
    assert P[0, 6] == P[7, 1] == pytest.approx(-2.4)
    assert P[2, 8] == pytest.approx(-3.6)


def test_two_fixes_and_the_way_between_give_the_heading() -> None:
    """3 m ahead led 3 m to the north: the robot looks north. √(2·0.01)/3 = 0.047 rad is sure enough, /1 is not."""
    alignment = Alignment(NOISE, GNSS)
    assert alignment.take(fix_at(10, 20)) is None
    alignment.move(Odometry(1, 1.0, 0.0))
    assert alignment.take(fix_at(10, 21, stamp_ns=1)) is None
    alignment.move(Odometry(2, 2.0, 0.0))
    found = alignment.take(fix_at(10, 23, stamp_ns=2))
    assert found is not None
    assert found.mean[:2] == pytest.approx([10, 23], abs=0.01)
    assert found.mean[YAW] == pytest.approx(pi / 2, abs=0.001)
    # Over three fixes, the middle one adds little: 0.0471 from the ends alone.
    assert 0.04 < sqrt(found.covariance[YAW, YAW]) < 0.0475


def test_what_says_nothing_does_not_disturb_an_alignment() -> None:
    quiet, disturbed = (Alignment(NOISE, GNSS) for _ in range(2))
    for k in range(4):
        now_ns = k * SECOND_NS
        for alignment in (quiet, disturbed):
            alignment.move(Odometry(now_ns, 1.0, 0.0))
        for fix in (fix_at(9, 9, quality=NO_FIX, stamp_ns=now_ns), fix_at(np.nan, 9, stamp_ns=now_ns)):
            assert disturbed.take(fix) is None
        found = [alignment.take(fix_at(k, 0, stamp_ns=now_ns)) for alignment in (quiet, disturbed)]
        assert disturbed.take(fix_at(9, 9, stamp_ns=now_ns - 1)) is None
        if found[0] is not None and found[1] is not None:
            assert found[0].mean.tolist() == found[1].mean.tolist()
            return
    raise AssertionError("no heading was found")


def test_standing_still_no_heading_is_found() -> None:
    alignment = Alignment(NOISE, GNSS)
    for k in range(100):
        assert alignment.take(fix_at(0.3 * (k % 7), 0.0, stamp_ns=k)) is None


def test_a_robot_that_was_carried_away_finds_itself_again() -> None:
    """Lifted 200 m to the north and turned by a right angle: after ten fixes it knows, some metres later also where."""
    filter_ = PoseFilter(start(sigma_m=0.1, yaw_sigma_rad=0.05))
    outcomes = []
    for k in range(60):
        filter_.move(Odometry(k * SECOND_NS, 1.0, 0.0))
        outcomes.append(filter_.take(fix_at(0.0, 200.0 + k, stamp_ns=k * SECOND_NS)))
        assert filter_.lost == (9 <= k < outcomes.index("realigned") if "realigned" in outcomes else k >= 9)
    assert outcomes[:10] == ["gated"] * 10
    assert set(outcomes[outcomes.index("realigned") + 1 :]) == {"used"}
    assert filter_.estimate.mean[:2] == pytest.approx([0.0, 259.0], abs=0.2)
    assert filter_.estimate.mean[YAW] == pytest.approx(pi / 2, abs=0.05)


# Honesty: normalised errors against the truth

RUNS = 30
Quality = Callable[[float], int]
PATTERNS: dict[str, Quality] = {
    "differential": lambda t: 2,
    "single": lambda t: 1,
    "none": lambda t: 0,
    "a long outage": lambda t: 2 if t < 60 or t > 240 else 0,
    "single, with gaps": lambda t: 1 if t % 80 < 40 else 0,
    "all in turn": lambda t: int(t // 30) % 3,
}


def chi2_bounds(degrees: int, z: float = 2.576) -> tuple[float, float]:
    """Between these lie 99 % of χ²: Wilson and Hilferty's k(1 - 2/9k ± z√(2/9k))³, within 0.1 % for k ≥ 100."""
    k = 2 / (9 * degrees)
    low, high = (degrees * (1 - k + sign * z * sqrt(k)) ** 3 for sign in (-1, 1))
    return low, high


def test_the_bounds_by_table() -> None:
    """99 % of χ² with 100 degrees of freedom lie between 67.33 and 140.17."""
    assert chi2_bounds(100) == pytest.approx((67.33, 140.17), abs=0.05)


def truth(k: int) -> tuple[Floats, float]:
    """Rounds of a figure of eight through hills, at 1 m/s and 1 Hz: place and heading after k steps."""
    turn = 0.06 * np.where(np.arange(k) // 105 % 2 == 0, 1.0, -1.0)
    yaw = np.concatenate([[0.5], 0.5 + np.cumsum(turn)])
    h = turn / 2
    chord = np.sin(h) / h
    x, y = (chord * f(yaw[:-1] + h) for f in (np.cos, np.sin))
    return np.array([x.sum(), y.sum(), 3 * sin(k / 20)]), float(yaw[-1])


TRUTH = [truth(k) for k in range(301)]


def run(
    seed: int, quality_at_s: Quality, outlier_chance: float = 0.0, believed: GnssModel = GNSS
) -> tuple[PoseFilter, list[float]]:
    """A robot for 300 s, with a fix a second; and the normalised error every 30 s."""
    rng = np.random.default_rng(seed)
    flaws = drawn_flaws(NOISE, rng)
    position, yaw = TRUTH[0]
    now_s = 0.0
    odometer = Odometer(position, yaw, NOISE, flaws, rng)
    gnss = Gnss(GNSS, lambda x, y: quality_at_s(now_s), rng, outlier_chance)
    guess_m, guess_rad = position + 0.1 * rng.normal(size=3), yaw + 0.02 * rng.normal()
    filter_ = PoseFilter(first_estimate(0, guess_m, guess_rad, 0.1, 0.02, NOISE), NOISE, believed)
    errors = []
    for k, (position, yaw) in enumerate(TRUTH[1:], start=1):
        now_s = float(k)
        filter_.move(odometer.read(k * SECOND_NS, position, yaw))
        filter_.take(gnss.read(k * SECOND_NS, position))
        if k % 30 == 0:
            errors.append(nees(filter_.estimate, position, yaw))
    return filter_, errors


@pytest.mark.parametrize("pattern", PATTERNS)
def test_the_filter_errs_as_much_as_it_says(pattern: str) -> None:
    """At each of ten times, the sum over the runs of NEES is χ² of 4·RUNS degrees of freedom."""
    errors = np.array([run(seed, PATTERNS[pattern])[1] for seed in range(RUNS)])
    low, high = chi2_bounds(4 * RUNS)
    sums = errors.sum(axis=0)
    assert low < np.median(sums) < high
    # Ten looks at 99 %: one outside is to be expected now and then, two are not.
    assert ((sums < low) | (sums > high)).sum() <= 1, sums
    low, high = chi2_bounds(4 * RUNS * 10)
    # Looks at one run hang together, so their spread is wider than that of as many runs.
    assert low * 0.85 < errors.sum() < high * 1.15


def test_a_filter_that_takes_slow_errors_for_white_ones_is_found_out() -> None:
    """As large, but believed to be new at each fix: the filter grows far too sure, and the bounds show it."""
    believed = GnssModel({SINGLE: GnssNoise(2.5, 0.0)})
    errors = np.array([run(seed, PATTERNS["single"], believed=believed)[1] for seed in range(10)])
    assert (errors.sum(axis=0) > 2 * chi2_bounds(40)[1]).all()


def test_outliers_do_no_harm() -> None:
    """One fix in ten is 50 m off. Nothing comes through, and the errors stay what the filter says."""
    runs = [run(seed, PATTERNS["differential"], 0.1) for seed in range(10)]
    assert sum(filter_.counts["gated"] for filter_, _ in runs) > 200
    assert not any(filter_.counts["realigned"] for filter_, _ in runs)
    low, high = chi2_bounds(40)
    last = [errors[-1] for _, errors in runs]
    assert low < sum(last) < high


def test_fixes_help() -> None:
    """After 300 s: centimetres with differential fixes, a metre or two with single ones, more without."""
    sigmas = [
        sqrt(np.trace(run(1, PATTERNS[name])[0].estimate.covariance[:2, :2]))
        for name in ("differential", "single", "none")
    ]
    assert sigmas[0] < 0.1 < sigmas[1] < 3 < sigmas[2]


def test_the_same_seed_gives_the_same_bytes() -> None:
    one, two = (run(3, PATTERNS["all in turn"])[0].estimate for _ in range(2))
    assert (one.mean.tobytes(), one.covariance.tobytes()) == (two.mean.tobytes(), two.covariance.tobytes())


def test_an_aligned_filter_is_honest_too() -> None:
    """From nothing but fixes and a way: the errors right after alignment are χ², single fixes or differential ones."""
    for quality in (SINGLE, DIFFERENTIAL):
        errors = [_aligned(seed, quality) for seed in range(RUNS)]
        low, high = chi2_bounds(4 * RUNS)
        assert low < sum(errors) < high, quality


def _aligned(seed: int, quality: int) -> float:
    rng = np.random.default_rng(100 + seed)
    turned = rng.uniform(-pi, pi)
    c, s = cos(turned), sin(turned)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    way = [(turn @ position, yaw + turned) for position, yaw in TRUTH]
    odometer = Odometer(*way[0], NOISE, drawn_flaws(NOISE, rng), rng)
    gnss, alignment = Gnss(GNSS, lambda x, y: quality, rng), Alignment(NOISE, GNSS)
    for k, (position, yaw) in enumerate(way[1:], start=1):
        alignment.move(odometer.read(k * SECOND_NS, position, yaw))
        found = alignment.take(gnss.read(k * SECOND_NS, position))
        if found is not None:
            return nees(found, position, yaw)
    raise AssertionError("no heading was found")


def test_the_python_of_the_page_runs(capsys: pytest.CaptureFixture[str]) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", (DOCS / "navigation.md").read_text(), re.DOTALL)
    exec(compile(code, "navigation.md", "exec"), {})
    assert capsys.readouterr().out.startswith("used\n[1.01")


def test_a_model_of_ones_own() -> None:
    """Qualities and their errors are data: a third one, of 2 cm."""
    model = GnssModel({**GNSS.qualities, 3: GnssNoise(0.02, 0.0)})
    filter_ = PoseFilter(start(sigma_m=1.0), gnss=model)
    assert filter_.take(fix_at(0.1, 0, quality=3)) == "used"
    assert sqrt(filter_.estimate.covariance[0, 0]) == pytest.approx(0.02, abs=1e-4)
