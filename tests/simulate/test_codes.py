"""Coded pulses: what a correlator gives is worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from terrafuse.errors import InputError
from terrafuse.simulate.sensors.codes import (
    CHIPS,
    Arrivals,
    arrivals,
    chips,
    correlations,
    let_through,
    overlap_sums,
    range_of,
    walsh_hadamard,
)

H = walsh_hadamard()


def test_codes_are_walsh_hadamards_rows() -> None:
    signs = ["++++++++", "+-+-+-+-", "++--++--", "+--++--+", "++++----", "+-+--+-+", "++----++", "+--+-++-"]
    assert [["+-"[int(chip < 0)] for chip in row] for row in H] == [list(row) for row in signs]
    np.testing.assert_array_equal(H.astype(int) @ H.T.astype(int), 8 * np.eye(8, dtype=int))


def test_aligned_codes_are_orthogonal() -> None:
    for own in H:
        heard = arrivals(H, np.full(8, 24.0))
        expected = (H == own).all(axis=1)
        np.testing.assert_array_equal(correlations(own, heard, np.array([24.0]))[:, 0], expected.astype(float))
        np.testing.assert_array_equal(let_through("slots", own, heard), expected)
        assert let_through("uncoded", own, heard).all()


def test_one_chip_off_another_code_is_almost_ones_own() -> None:
    """Row 3 is row 2 one chip late, upside down: over 7 chips + + - - + + - meets - - + + - - +, -7/8."""
    assert overlap_sums(H[2], H[3])[CHIPS + 1] == -7 / 8
    late = arrivals(H[3:4], np.array([15.0]))
    np.testing.assert_array_equal(correlations(H[2], late, np.array([16.0])), [[-7 / 8]])
    assert let_through("slots", H[2], late).all()
    assert not let_through("slots", H[2], late, threshold=0.9).any()


def test_between_whole_chips_it_is_in_between() -> None:
    """Rows 0 and 4: R(-1) = (4 - 3)/8 and R(-2) = (4 - 2)/8; at -1.25, 3/4·1/8 + 1/4·2/8 = 5/32."""
    assert correlations(H[0], arrivals(H[4:5], np.array([1.25])), np.array([0.0])) == pytest.approx(5 / 32)


def test_at_random_delays_half_of_them_get_through() -> None:
    """Rows 0 and 4 overlap by |R(x)| = |x|/8 up to |x| = 4, then by (8 - |x|)/8. A receiver that looks every 8 chips
    sees a delay of δ at -δ and 8 - δ, both with the same |R|: at a quarter's threshold, δ from 2 to 6 of 8 gets
    through."""
    rng = np.random.default_rng(0)
    delays = rng.uniform(0, 800, 20_000)
    through = let_through("slots", H[0], arrivals(np.tile(H[4], (len(delays), 1)), delays), threshold=0.25)
    remainder = delays % 8
    sure = (abs(remainder - 2) > 1e-6) & (abs(remainder - 6) > 1e-6)
    np.testing.assert_array_equal(through[sure], ((remainder > 2) & (remainder < 6))[sure])
    # Three standard deviations of a share of 20,000.
    assert abs(through.mean() - 0.5) < 3 * 0.5 / np.sqrt(20_000)


def test_who_looks_at_every_lag_is_helped_only_by_a_high_threshold() -> None:
    """Of rows 2 and 3 a sliding correlator meets 7/8 at some lag, whatever the delay; of rows 0 and 4, 4/8."""
    delays = np.random.default_rng(1).integers(8, 500, 50) + 0.0
    for own, other, most in ((2, 3, 7 / 8), (0, 4, 4 / 8)):
        heard = arrivals(np.tile(H[other], (50, 1)), delays)
        assert let_through("sliding", H[own], heard, most).all()
        assert not let_through("sliding", H[own], heard, most + 0.01).any()


def test_a_weak_ping_is_heard_less() -> None:
    heard = Arrivals(H[[3, 3]], np.array([15.0, 15.0]), np.array([1.0, 0.5]))
    assert let_through("slots", H[2], heard).tolist() == [True, False]


def test_ones_own_echo_is_found_wherever_it_is() -> None:
    """A quarter of a chip's grid is at most 1/8 chip off: of row 0 at least 7/8·1 + 1/8·7/8 = 63/64 is left."""
    delays = np.random.default_rng(2).uniform(0, 500, 200)
    assert let_through("sliding", H[0], arrivals(np.tile(H[0], (200, 1)), delays), 63 / 64).all()


def test_chips_and_ranges() -> None:
    """3 m there and back are 6/343 s, 699.7 chips of 25 µs."""
    assert chips(np.array(6 / 343)) == pytest.approx(699.7085, abs=1e-4)
    assert range_of(np.array(6 / 343)) == pytest.approx(3.0)


def test_what_is_no_arrival_is_refused() -> None:
    with pytest.raises(InputError, match="2 delays with codes of shape"):
        Arrivals(H[:1], np.zeros(2), np.ones(2))
    with pytest.raises(InputError, match="receiver 'magic': there are uncoded, slots, sliding"):
        let_through("magic", H[0], arrivals(H[:1], np.zeros(1)))
    with pytest.raises(InputError, match="6 chips: give a power of 2"):
        walsh_hadamard(6)
    assert let_through("sliding", H[0], arrivals(H[:0], np.zeros(0))).shape == (0,)
