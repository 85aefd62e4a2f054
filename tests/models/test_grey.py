"""The grey model: layers, both modes, both ways back to a robot, and the map of several robots."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from terrafuse.errors import InputError
from terrafuse.kernels.grey import CELL, FULL
from terrafuse.lattice import Lattice
from terrafuse.mapper import Mapper
from terrafuse.models import fold, make_model
from terrafuse.models.grey import local_view
from terrafuse.replica import Replica
from terrafuse.testing.deltas import SECOND_NS, deltas_of
from terrafuse.types import Array, Beam, Pose, Scan, TileKey
from terrafuse.views import chosen_layers, mosaic
from tests.models.soccer import LATTICE, TEAM, field, ring_scan, team_scans

COARSE = Lattice(0.5, 4.0)
BEAM = Beam(half_angle_rad=0.2, range_error_m=0.4, max_range_m=10.0)
HOME = Pose.identity().shifted(0.25, 0.25)
"""In the middle of cell (0, 0)."""


def sonar(range_m: float, stamp_s: int = 1, beam: Beam = BEAM, echo: bool = True) -> Scan:
    """One sonar that looks east."""
    end, none = np.array([[range_m, 0.0, 0.0]]), np.empty((0, 3))
    return Scan(stamp_s * SECOND_NS, end if echo else none, HOME, none if echo else end, beam=beam)


def row(*scans: Scan, **model_settings: object) -> dict[str, Array]:
    """The layers of cells (0, 0) to (7, 0), which lie on the axis at 0, 0.5, … 3.5 m, after these scans."""
    mapper = Mapper("r1", COARSE, make_model("grey", model_settings))
    for scan in scans:
        mapper.integrate(scan)
    replica = Replica(COARSE, mapper.model)
    replica.apply(mapper.delta())
    return {name: array[0] for name, array in mosaic(replica, chosen_layers(replica, None), (0, 0, 8, 1)).items()}


def test_the_table_of_intervals_on_the_axis_of_a_sonar() -> None:
    """r = 2, Δr = 0.4, ρ_v = 1.5, v = 1, Γ(0) = 1.

    ρ = 1 ≤ 1.6: [0, 1 - Δ(1)], Δ(1) = 1 - (1 + tanh(-1))/2 = 0.8808.
    ρ = 2: [Δ(2), 1], Δ(2) = 1 - (1 + tanh 1)/2 = 0.1192, f₁ = 1. ρ = 1.5 ≤ 1.6: Δ = ½. ρ = 2.5 ≥ 2.4: nothing.
    """
    layers = row(sonar(2.0))
    assert layers["a"][:5] == pytest.approx([0, 0, 0, 0, 0.1192], abs=1e-4)
    assert layers["b"][2:5] == pytest.approx([0.1192, 0.5, 1.0], abs=1e-4)
    assert layers["white"][2:5] == pytest.approx([0.0596, 0.25, 0.5596], abs=1e-4)
    assert layers["information"][2:5] == pytest.approx([0.8808, 0.5, 0.1192], abs=1e-4)
    assert layers["stamp"][2] == 1.0
    for name, values in layers.items():
        assert np.isnan(values[5:]).all(), name


def test_reliability_scales_what_is_believed() -> None:
    """v = 0.5 of the model times 0.8 of the beam: b = 1 - 0.4 · 0.8808."""
    layers = row(sonar(2.0, beam=replace(BEAM, reliability=0.8)), reliability=0.5)
    assert layers["b"][2] == pytest.approx(1 - 0.4 * 0.8808, abs=1e-4)


def test_a_reading_at_maximum_range_clears_and_marks_nothing() -> None:
    for scan in (sonar(3.0, echo=False), sonar(3.0, beam=replace(BEAM, max_range_m=3.0))):
        layers = row(scan, rho_v_m=3.0)
        assert (layers["a"][:6] == 0).all()
        assert (layers["b"][:6] < 1).all()  # up to 3 - 0.4 m
        assert np.isnan(layers["white"][6:]).all()


def test_the_band_is_never_narrower_than_a_cell() -> None:
    """A range error of 1 mm in cells of 0.5 m: the cell in which the reading ends is marked. A setting is obeyed."""
    exact = replace(BEAM, range_error_m=0.001)
    assert row(sonar(2.2, beam=exact))["white"][4] > 0.5
    assert np.isnan(row(sonar(2.2, beam=exact), delta_r_m=0.001)["white"][5:]).all()
    # 0.4 of the beam is more than half a diagonal, 0.5 · √½ = 0.354: ρ = 2 with r = 2.38 is just in the band
    assert 0.5 < row(sonar(2.38))["white"][4] < row(sonar(2.38), delta_r_m=0.8)["white"][4]


def test_contradiction_leaves_no_information_but_is_known() -> None:
    """Occupied [0.1192, 1], then free [0, b]: [0, 1]; seen, and white ½. A third look counts as the first."""
    one = row(sonar(2.0), sonar(3.0, 2))
    assert (one["a"][4], one["b"][4], one["white"][4], one["information"][4]) == (0, 1, 0.5, 0)
    assert one["stamp"][4] == 2.0
    assert row(sonar(2.0), sonar(3.0, 2), sonar(2.0, 3))["a"][4] == pytest.approx(0.1192, abs=1e-4)


def test_a_stable_world_gathers_and_a_changing_one_forgets() -> None:
    """A weak look after a strong one: [max a, max b] in the stable mode, what the last one says in the changing one."""
    weak = sonar(2.3, 2)  # ρ = 2 at 0.3 of Δr = 0.4: f₁ = 1 - 0.5625 = 0.4375; · 0.1192 = 0.05215
    assert row(sonar(2.0), weak)["a"][4] == pytest.approx(0.1192, abs=1e-4)
    assert row(sonar(2.0), weak, mode="changing")["a"][4] == pytest.approx(0.0522, abs=1e-4)
    moved = row(sonar(2.0), sonar(3.4, 2), mode="changing")
    assert moved["white"][4] < 0.5  # who was there is gone, at once
    assert row(sonar(2.0), sonar(3.4, 2))["white"][4] == 0.5


def test_a_late_scan_does_not_replace_a_newer_one() -> None:
    late = row(sonar(3.4, 5), sonar(2.0, 4), mode="changing")
    assert late["white"][4] < 0.5
    assert late["stamp"][4] == 5.0


def test_sonars_of_one_scan_are_fused_before_they_replace() -> None:
    """Two sonars see one cell occupied, more and less: the scan says [max a, 1], in the changing mode, too."""
    ends = np.array([[2.0, 0.0, 0.0], [2.3, 0.0, 0.0]])
    both = Scan(SECOND_NS, ends, HOME, beam=BEAM)
    assert row(both, mode="changing")["a"][4] == pytest.approx(0.1192, abs=1e-4)


# --- several robots --------------------------------------------------------------------------------------------------


def records(*intervals: tuple[float, float, int]) -> Array:
    """Cells of (a, b, stamp); stamp 0 makes an unknown one."""
    cells = np.zeros(len(intervals), CELL)
    for cell, (a, b, stamp) in zip(cells, intervals, strict=True):
        cell["a"], cell["c"] = round(a * FULL), FULL - round(b * FULL)
        cell["stamp"], cell["revision"] = stamp, min(stamp, 1)
    return cells


def test_the_fold_goes_by_name_whatever_the_stamps() -> None:
    """Fig. 2: r1 ∘ r2, then r3. ([0.6, 1] ∘ [0, 0.3]) ∘ [0.6, 1] = [0, 1] ∘ [0.6, 1] = [0.6, 1], but by the stamps
    ([0.6, 1] ∘ [0.6, 1]) ∘ [0, 0.3] = [0, 1]."""
    model = make_model("grey")
    r1, r2, r3 = records((0.6, 1, 10)), records((0, 0.3, 30)), records((0.6, 1, 20))
    assert fold(model, [r1, r2, r3], COARSE).tolist() == [(round(0.6 * FULL), 0, 1, 30)]
    assert fold(model, [r1, r3, r2], COARSE).tolist() == [(0, 0, 1, 30)]


TEAM_DELTAS = [d for name in TEAM for d in deltas_of(name, team_scans(name), LATTICE, make_model("grey"), every=4)]


def digest_of(deltas: list) -> str:
    replica = Replica(LATTICE, make_model("grey"))
    for delta in deltas:
        replica.apply(delta)
    return replica.digest()


EXPECTED = digest_of(TEAM_DELTAS)


@given(st.permutations(TEAM_DELTAS), st.lists(st.sampled_from(TEAM_DELTAS), max_size=5))
@settings(max_examples=30)
def test_any_order_and_repetition_gives_the_same_bytes(order: list, again: list) -> None:
    assert digest_of(order + again) == EXPECTED


def test_three_robots_map_the_papers_field() -> None:
    """Where the team drove it is free; walls and opponents that they heard are occupied."""
    replica = Replica(LATTICE, make_model("grey"))
    for delta in TEAM_DELTAS:
        replica.apply(delta)
    white = field(make_model("grey").layers["white"].compute(replica.cells(TileKey(0, 0)), replica.reading))
    for x, y in ((1.1, 2.6), (2.3, 2.3), (4.4, 3.9), (3.5, 6.2)):
        assert white[int(y / 0.25), int(x / 0.25)] < 0.4, (x, y)
    assert np.nanmax(white[:, 0]) > 0.6  # the left wall, 1.3 m from r1
    opponent = white[int(4.2 / 0.25) - 1 : int(4.2 / 0.25) + 2, int(3.2 / 0.25) - 1 : int(3.2 / 0.25) + 2]
    assert np.nanmax(opponent) > 0.55
    assert 0.7 < np.isfinite(white).mean() < 1


# --- the fused map comes back ----------------------------------------------------------------------------------------


def test_in_a_stable_world_intervals_come_back() -> None:
    """Free twice: [min a, min b] = [0, 0.4], white 0.2; the other's alone; a contradiction: [0.2, 0.9]; neither."""
    own = records((0, 0.6, 1), (0, 1, 0), (0.4, 0.9, 1), (0, 1, 0))
    others = records((0, 0.4, 2), (0.5, 1, 2), (0.2, 0.4, 2), (0, 1, 0))
    before = own.tobytes(), others.tobytes()
    view = local_view(own, others, "stable")
    assert view == pytest.approx([0.2, 0.75, 0.55, np.nan], abs=1e-4, nan_ok=True)
    assert (own.tobytes(), others.tobytes()) == before


def test_in_a_changing_world_only_white_values_come_back() -> None:
    """Θ_M of the others where the robot itself knows nothing; its own elsewhere."""
    own = records((0, 0.6, 1), (0, 1, 0), (0.4, 0.9, 1), (0, 1, 0))
    others = records((0, 0.4, 2), (0.5, 1, 2), (0.2, 0.4, 2), (0, 1, 0))
    view = local_view(own, others, "changing")
    assert view == pytest.approx([0.3, 0.75, 0.65, np.nan], abs=1e-4, nan_ok=True)


def test_what_comes_back_is_never_reported() -> None:
    """A robot reports the same whether or not it looked at the fused map in between."""
    model, reports = make_model("grey"), []
    for looks in (False, True):
        mapper, replica = Mapper("r1", LATTICE, model), Replica(LATTICE, model, without=["r1"])
        for delta in TEAM_DELTAS:
            replica.apply(delta)
        for scan in team_scans("r1"):
            mapper.integrate(scan)
            if looks:
                for tile in mapper.delta().tiles:
                    local_view(tile.cells, replica.cells(tile.key).reshape(-1)[tile.at], "stable")
        reports.append(mapper.delta().identity)
    assert reports[0] == reports[1]


# --- coarsening and bad input ----------------------------------------------------------------------------------------


def test_a_wall_survives_coarsening_and_unseen_ground_is_not_free() -> None:
    """Three cells of [0, 0.2] and one of [0.6, 1] are [0.6, 1]; three of [0, 0.2] and an unknown one are [0, 1]."""
    free, wall, unknown = (0, 0.2, 1), (0.6, 1, 1), (0, 1, 0)
    fine = records(free, wall, free, unknown, free, free, free, free).reshape(2, 4)
    coarse = make_model("grey").coarsen(fine, 2)
    assert [(c["a"], FULL - c["c"]) for c in coarse[0]] == [(round(0.6 * FULL), FULL), (0, FULL)]


@given(st.integers(0, 2**32))
def test_coarsening_in_two_steps_is_coarsening_at_once(seed: int) -> None:
    rng, model = np.random.default_rng(seed), make_model("grey")
    a, b = np.sort(rng.integers(0, FULL + 1, (2, 12, 12)), axis=0)
    cells = np.zeros((12, 12), CELL)
    cells["a"], cells["c"], cells["stamp"], cells["revision"] = a, FULL - b, rng.integers(0, 9, (12, 12)), 1
    cells[rng.random((12, 12)) < 0.2] = np.zeros((), CELL)
    np.testing.assert_array_equal(model.coarsen(model.coarsen(cells, 2), 3), model.coarsen(cells, 6))


def test_beams_without_a_width_are_refused_with_the_remedy() -> None:
    mapper = Mapper("r1", COARSE, make_model("grey"))
    scan = Scan(0, np.ones((1, 3)), HOME)
    with pytest.raises(InputError, match="beams have no width: set the model's opening_angle_rad"):
        mapper.integrate(scan)
    wide = Mapper("r1", COARSE, make_model("grey", {"opening_angle_rad": 0.4}))
    assert wide.integrate(scan).cells > 0


def test_scans_that_do_not_fit_are_refused() -> None:
    observe = make_model("grey").observer(COARSE)
    with pytest.raises(InputError, match=r"points are \(N, 3\), not \(3,\)"):
        observe(Scan(0, np.ones(3), HOME, beam=BEAM))
    with pytest.raises(InputError, match="2 points and misses has 1 origins"):
        observe(Scan(0, np.ones((2, 3)), HOME, origins=np.zeros((1, 3)), beam=BEAM))
    with pytest.raises(InputError, match="over 500 cells"):
        observe(Scan(0, np.ones((2, 3)), HOME, beam=replace(BEAM, range_error_m=300.0)))


def test_an_empty_scan_and_one_without_a_return_touch_nothing() -> None:
    mapper = Mapper("r1", COARSE, make_model("grey"))
    assert mapper.integrate(Scan(0, np.empty((0, 3)), HOME, beam=BEAM)).cells == 0
    done = mapper.integrate(Scan(0, np.full((2, 3), np.nan), HOME, np.array([[math.inf, 0, 0]]), beam=BEAM))
    assert (done.cells, done.points, done.dropped) == (0, 2, {"not finite": 3})


def test_far_from_the_origin_and_across_tiles() -> None:
    """The same ring at UTM coordinates says the same, cell for cell."""
    near, far = Mapper("r1", COARSE, make_model("grey")), Mapper("r1", COARSE, make_model("grey"))
    scan = ring_scan(SECOND_NS, 3.1, 4.2, 0.3, [(1.5, 4.0)])
    near.integrate(scan)
    far.integrate(replace(scan, T_world_sensor=scan.T_world_sensor.shifted(512_000.0, 4_000_000.0)))
    one, other = near.delta().tiles, far.delta().tiles
    assert len(one) == len(other) > 1
    for here, there in zip(one, other, strict=True):
        assert (there.key.x - here.key.x, there.key.y - here.key.y) == (128_000, 1_000_000)
        np.testing.assert_array_equal(here.at, there.at)
        np.testing.assert_allclose(here.cells["a"], there.cells["a"], atol=2)
        np.testing.assert_allclose(here.cells["c"], there.cells["c"], atol=2)


@pytest.mark.parametrize(
    ("setting", "value", "reason"),
    [
        ("mode", "still", "give 'stable' or 'changing'"),
        ("opening_angle_rad", 0.0, "give 0 to 2π"),
        ("opening_angle_rad", 7.0, "give 0 to 2π"),
        ("delta_r_m", 0.0, "positive number of metres"),
        ("rho_v_m", -1.0, "from 0 on"),
        ("rho_v_m", math.nan, "from 0 on"),
        ("reliability", 1.5, "at most 1"),
    ],
)
def test_settings_are_checked(setting: str, value: object, reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        make_model("grey", {setting: value})
