"""The grey paper's formulas against numbers worked out by hand, and the kernels against their references."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from terrafuse.kernels import grey
from terrafuse.types import Array, Floats

FULL = grey.FULL
ALPHA = math.radians(22.5)
EMPTY = {"a": 0, "c": 0}


# --- formulas --------------------------------------------------------------------------------------------------------


def test_eq_1_angle_confidence() -> None:
    """Γ(θ) = 1 - 21 θ², for |θ| ≤ α/2 = 11.25° = 0.19635 rad."""
    assert grey.angle_confidence(0.0, ALPHA) == 1.0
    assert grey.angle_confidence(0.1, ALPHA) == pytest.approx(0.79)  # 1 - 21 · 0.01
    assert grey.angle_confidence(-0.1, ALPHA) == pytest.approx(0.79)
    # 0.19635² = 0.0385533; · 21 = 0.80962
    assert grey.angle_confidence(ALPHA / 2, ALPHA) == pytest.approx(0.19038, abs=1e-5)
    assert grey.angle_confidence(0.2, ALPHA) == 0.0  # outside the cone, though 1 - 21 · 0.04 = 0.16
    assert grey.angle_confidence(0.2, 0.5) == pytest.approx(0.16)
    assert grey.angle_confidence(0.24, 0.5) == 0.0  # 1 - 21 · 0.0576 = -0.21, clamped


def test_eq_2_distance_confidence() -> None:
    """Δ(ρ) = 1 - (1 + tanh(2(ρ - ρ_v)))/2."""
    assert grey.distance_confidence(1.5, 1.5) == 0.5  # tanh 0 = 0
    # ρ - ρ_v = 0.5: tanh 1 = (e² - 1)/(e² + 1) = 6.3891/8.3891 = 0.7616; 1 - 1.7616/2
    assert grey.distance_confidence(2.0, 1.5) == pytest.approx(0.1192, abs=5e-5)
    # ρ - ρ_v = -0.5: tanh(-1) = -0.7616; 1 - 0.2384/2
    assert grey.distance_confidence(1.0, 1.5) == pytest.approx(0.8808, abs=5e-5)
    # ρ = 0, ρ_v = 1: tanh(-2) = -(e⁴ - 1)/(e⁴ + 1) = -53.598/55.598 = -0.9640; 1 - 0.0360/2
    assert grey.distance_confidence(0.0, 1.0) == pytest.approx(0.9820, abs=5e-5)


def test_eq_3_band_confidence() -> None:
    """f₁(ρ, r) = 1 - ((ρ - r)/Δr)² within Δr of the reading, 0 from there on."""
    assert grey.band_confidence(2.0, 2.0, 0.2) == 1.0
    assert grey.band_confidence(1.9, 2.0, 0.2) == pytest.approx(0.75)  # 1 - (0.1/0.2)²
    assert grey.band_confidence(2.15, 2.0, 0.2) == pytest.approx(0.4375)  # 1 - 0.75²
    assert grey.band_confidence(2.25, 2.0, 0.25) == 0.0  # Δr away
    assert grey.band_confidence(1.5, 2.0, 0.2) == 0.0


SONAR = grey.Sonar(opening_angle_rad=0.5, rho_v_m=1.5, delta_r_m=0.2, reliability=0.5)


def interval(rho: float, theta: float, echo: bool = True) -> tuple[float, float]:
    a, b = grey.interval(np.array([rho]), np.array([theta]), 2.0, echo, SONAR)
    return float(a[0]), float(b[0])


def test_eqs_7_and_8_before_the_reading_a_cell_is_free() -> None:
    """ρ = 1 ≤ 2 - 0.2: [0, 1 - v Γ Δ] with v = ½, Γ(0.1) = 0.79, Δ(1) = 0.8808: 1 - 0.3479."""
    assert interval(1.0, 0.1) == pytest.approx((0.0, 0.6521), abs=5e-5)
    assert interval(1.0, 0.1, echo=False) == pytest.approx((0.0, 0.6521), abs=5e-5)


def test_eqs_7_and_8_around_the_reading_a_cell_is_occupied() -> None:
    """ρ = 1.9 in the band: [v f₁ Γ Δ, 1] with f₁ = 0.75, Γ(0) = 1 and Δ(1.9) = 1/(1 + e^1.6) = 1/5.9530 = 0.16798."""
    assert interval(1.9, 0.0) == pytest.approx((0.06299, 1.0), abs=5e-5)
    assert interval(1.9, 0.0, echo=False) == (0.0, 1.0)  # at maximum range nothing was met


def test_eqs_7_and_8_behind_the_reading_and_beside_the_cone_nothing_is_known() -> None:
    assert interval(2.5, 0.0) == (0.0, 1.0)
    assert interval(1.0, 0.3) == (0.0, 1.0)


def test_the_white_value_of_eq_9() -> None:
    """[1 - v Γ Δ]/2 before, [1 + v f₁ Γ Δ]/2 around, ½ behind: with the numbers above."""
    white = [sum(interval(rho, theta)) / 2 for rho, theta in ((1.0, 0.1), (1.9, 0.0), (2.5, 0.0))]
    assert white == pytest.approx([(1 - 0.3479) / 2, (1 + 0.06299) / 2, 0.5], abs=5e-5)


# --- fusing ----------------------------------------------------------------------------------------------------------


def ab(a: float, b: float) -> tuple[int, int]:
    """[a, b] in ticks; percents are not whole ticks, but these are nearest and compare alike."""
    return round(a * FULL), round(b * FULL)


def fuse(one: tuple[int, int], other: tuple[int, int]) -> tuple[int, int]:
    """By the kernel, as [a, b] in ticks."""
    cells = [np.array([(a, FULL - b, 1, 1)], grey.CELL) for a, b in (one, other)]
    grey.fuse(*cells)
    return int(cells[0]["a"][0]), FULL - int(cells[0]["c"][0])


@pytest.mark.parametrize(
    ("one", "other", "result"),
    [
        # either carries no information: [max a, min b]
        ((0.0, 1.0), (0.3, 0.9), (0.3, 0.9)),
        ((0.2, 0.8), (0.3, 0.9), (0.3, 0.8)),
        ((0.4, 0.6), (0.1, 0.5), (0.4, 0.5)),
        # … which would be [0.4, 0.2]: widened to [min a, max b]
        ((0.4, 0.6), (0.0, 0.2), (0.0, 0.6)),
        # both over ½: [max a, max b]
        ((0.4, 0.9), (0.6, 0.8), (0.6, 0.9)),
        # both under ½: [min a, min b]
        ((0.1, 0.5), (0.2, 0.4), (0.1, 0.4)),
        # one on each side: [min a, max b]
        ((0.4, 0.9), (0.2, 0.4), (0.2, 0.9)),
        ((0.7, 1.0), (0.0, 0.2), (0.0, 1.0)),
    ],
)
def test_the_four_cases_of_fusing(
    one: tuple[float, float], other: tuple[float, float], result: tuple[float, float]
) -> None:
    assert fuse(ab(*one), ab(*other)) == ab(*result)
    assert fuse(ab(*other), ab(*one)) == ab(*result)


INTERVALS = st.tuples(st.integers(0, FULL), st.integers(0, FULL)).map(sorted).map(tuple) | st.integers(
    0, FULL // 2
).map(lambda a: (a, FULL - a))  # symmetric ones: Θ_M is exactly ½


@given(INTERVALS, INTERVALS)
def test_fusing_equals_its_reference(one: tuple[int, int], other: tuple[int, int]) -> None:
    assert fuse(one, other) == grey.fused_reference(one, other)


@given(INTERVALS, INTERVALS)
def test_fusing_is_commutative_and_stays_an_interval(one: tuple[int, int], other: tuple[int, int]) -> None:
    a, b = fuse(one, other)
    assert (a, b) == fuse(other, one)
    assert 0 <= a <= b <= FULL


@given(INTERVALS)
def test_fusing_is_idempotent(one: tuple[int, int]) -> None:
    assert fuse(one, one) == one


@given(INTERVALS)
def test_the_unknown_is_neutral(one: tuple[int, int]) -> None:
    assert fuse(one, (0, FULL)) == one


def test_fusing_is_not_associative() -> None:
    """Occupied, occupied, free: two that agree outweigh nothing, and what a contradiction wiped out comes back.

    ([0.6, 1] ∘ [0.6, 1]) ∘ [0, 0.3] = [0.6, 1] ∘ [0, 0.3] = [0, 1], but
    [0.6, 1] ∘ ([0.6, 1] ∘ [0, 0.3]) = [0.6, 1] ∘ [0, 1]   = [0.6, 1].
    """
    occupied, free = ab(0.6, 1.0), ab(0.0, 0.3)
    assert fuse(fuse(occupied, occupied), free) == (0, FULL)
    assert fuse(occupied, fuse(occupied, free)) == occupied


# --- the kernels -----------------------------------------------------------------------------------------------------


def random_beams(seed: int, count: int) -> Floats:
    rng = np.random.default_rng(seed)
    heading = rng.uniform(-np.pi, np.pi, count)
    beams = np.empty((count, 6))
    beams[:, :2] = rng.uniform(-0.5, 0.5, (count, 2))
    beams[:, grey.AXIS_X], beams[:, grey.AXIS_Y] = np.cos(heading), np.sin(heading)
    beams[:, grey.READING] = rng.uniform(0.05, 3.0, count)
    beams[:, grey.ECHO] = rng.random(count) < 0.7
    return beams


def observed(beams: Floats, sonar: grey.Sonar, cells_per_m: float, scratch: grey.Scratch, first_slot: int) -> Array:
    """What the kernel says, as rows i, j, a, c."""
    origin = len(scratch.grid) // 2
    count = grey.observe(beams, sonar, cells_per_m, -origin, -origin, first_slot, scratch)
    columns = (scratch.i, scratch.j, scratch.records["a"], scratch.records["c"])
    return np.stack([column[:count].astype(np.int64) for column in columns], axis=1)


@given(
    seed=st.integers(0, 2**32),
    opening=st.floats(0.1, 1.0),
    rho_v=st.floats(0.2, 4.0),
    delta_r=st.floats(0.02, 0.5),
    cells_per_m=st.sampled_from([4.0, 10.0, 20.0]),
)
@settings(max_examples=40)
def test_observing_equals_its_reference(
    seed: int, opening: float, rho_v: float, delta_r: float, cells_per_m: float
) -> None:
    """One beam, within a tick: 1/(1 + e⁴ˣ) and the paper's tanh differ in the last bit."""
    sonar, beams = grey.Sonar(opening, rho_v, delta_r, 0.9), random_beams(seed, 1)
    found = {(i, j): (a, FULL - c) for i, j, a, c in observed(beams, sonar, cells_per_m, grey.new_scratch(256), 1)}
    expected = grey.observe_reference(beams, sonar, cells_per_m)
    for cell in found.keys() | expected.keys():
        assert found.get(cell, (0, FULL)) == pytest.approx(expected.get(cell, (0, FULL)), abs=1)


@given(seed=st.integers(0, 2**32), count=st.integers(2, 24))
@settings(max_examples=30)
def test_several_beams_are_fused_in_their_order(seed: int, count: int) -> None:
    """What all say is what each says alone, fused one after another; and the scratch forgets the scan before."""
    beams, sonar, scratch = random_beams(seed, count), grey.Sonar(0.4, 1.5, 0.1, 1.0), grey.new_scratch(256)
    first_slot, expected = 1, {}
    for beam in beams:
        alone = observed(beam[None], sonar, 10.0, scratch, first_slot)
        first_slot += len(alone)
        for i, j, a, c in alone.tolist():
            one = (a, FULL - c)
            expected[i, j] = grey.fused_reference(expected[i, j], one) if (i, j) in expected else one
    rows = observed(beams, sonar, 10.0, scratch, first_slot)
    assert {(i, j): (a, FULL - c) for i, j, a, c in rows.tolist()} == expected
    assert len(rows) == len(expected)


def test_cells_are_coarsened_to_the_most_occupied() -> None:
    """Free [0, 0.2] and [0, 0.4] and occupied [0.5, 1]: [0.5, 1]. All free: [0, 0.4]. One of them unknown: [0, 1]."""
    fine = np.zeros((2, 6), grey.CELL)
    fine["revision"], fine["stamp"] = 3, 7
    fine["c"] = round(0.8 * FULL)
    fine["c"][0, ::2] = round(0.6 * FULL)
    fine[1, 1] = (FULL // 2, 0, 9, 8)
    fine[1, 5] = np.zeros((), grey.CELL)
    out = np.zeros((1, 3), grey.CELL)
    grey.coarsen(fine, 2, out)
    assert out[0].tolist() == [(FULL // 2, 0, 9, 8), (0, round(0.6 * FULL), 3, 7), (0, 0, 3, 7)]


# --- aiming ----------------------------------------------------------------------------------------------------------


def aim(ends: list[tuple[float, float, float]], echoes: int, far: float = 3.0) -> tuple[Floats, dict[str, int]]:
    """Beams from the origin of a sensor at (10, 20) that looks north."""
    T_world_sensor = np.array([[0.0, -1, 0, 10], [1, 0, 0, 20], [0, 0, 1, 0], [0, 0, 0, 1]])
    beams, dropped = np.empty((len(ends), 6)), np.zeros(len(grey.DROP_REASONS), np.int64)
    points = np.array(ends, np.float64)
    count = grey.aim(points, np.zeros_like(points), echoes, T_world_sensor, 0.1, far, 10.0, beams, dropped)
    return beams[:count], {name: n for name, n in zip(grey.DROP_REASONS, dropped.tolist(), strict=True) if n}


def test_beams_are_turned_to_the_world() -> None:
    beams, dropped = aim([(2.0, 0.0, 0.0), (0.0, 1.0, 0.0)], echoes=1)
    np.testing.assert_allclose(beams, [(10, 20, 0, 1, 2, 1), (10, 20, -1, 0, 1, 0)], atol=1e-12)
    assert dropped == {}


def test_a_reading_at_maximum_range_is_no_echo() -> None:
    beams, _ = aim([(3.0, 0.0, 0.0), (float(np.float32(2.9999999)), 0.0, 0.0), (2.99, 0.0, 0.0)], echoes=3)
    np.testing.assert_array_equal(beams[:, grey.ECHO], [0, 0, 1])


def test_what_does_not_count_is_counted() -> None:
    nan, inf = float("nan"), float("inf")
    ends = [(nan, 0, 0), (inf, 0, 0), (0.05, 0, 0), (3.1, 0, 0), (0, 0, 1.0), (1e300, 0, 0), (1.0, 0, 0)]
    beams, dropped = aim(ends, echoes=len(ends))
    assert len(beams) == 1
    assert dropped == {
        "not finite": 3,  # 1e300 squared is
        "nearer than min_range_m": 1,
        "beyond max_range_m": 1,
        "straight up or down": 1,
    }
    _, dropped = aim([(154.0, 0.0, 0.0)], echoes=1, far=inf)
    assert dropped == {"over 1536 cells long": 1}
