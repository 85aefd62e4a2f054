"""What rounding may change, by layer, and what it may not."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from terrafuse.errors import InputError
from terrafuse.exchange.codec import decode, encode, heading
from terrafuse.exchange.delta import Delta
from terrafuse.exchange.profiles import PROFILES, report
from terrafuse.exchange.profiles.base import at_level, level, level_above, level_below, steps
from terrafuse.kernels import absorb
from terrafuse.lattice import Lattice
from terrafuse.mapper import Mapper
from terrafuse.models import make_model
from terrafuse.models.base import Model, Reading, fold
from terrafuse.models.grey import lower, upper
from terrafuse.testing.scans import cloud, lidar, mixed_scans, sonar
from terrafuse.tile import opaque
from terrafuse.types import Array, Floats

LATTICE = Lattice(0.5, 4.0)
KINDS = {"elevation": (cloud,), "terrain": (lidar, cloud), "occupancy": (lidar, sonar), "grey": (sonar,)}
CASES = [(model, profile) for model in PROFILES for profile in ("full", "lean")]
SEEDS = st.integers(0, 2**31)


def contribution(model: Model, seed: int, factor: int = 1) -> Array:
    """(M,) known cells of a robot's own map, coarsened."""
    mapper = Mapper("r", LATTICE, model)
    for scan in mixed_scans(seed, 3, KINDS[model.name]):
        mapper.integrate(scan)
    cells = np.concatenate([mapper.coarse(key, factor).reshape(-1) for key in mapper.keys])
    return cells[model.known(cells)]


def layer(model: Model, name: str, cells: Array) -> Floats:
    return model.layers[name].compute(cells.reshape(1, -1), Reading(LATTICE, int(cells["stamp"].max(initial=0))))[0]


def rounded(model: Model, profile: str, cells: Array) -> Array:
    return PROFILES[model.name][profile].report(cells, model, LATTICE)


@pytest.mark.parametrize(("name", "profile"), CASES)
@given(seed=SEEDS, factor=st.sampled_from([1, 4]))
@settings(max_examples=25, deadline=None)
def test_rounding_is_a_projection(name: str, profile: str, seed: int, factor: int) -> None:
    model = make_model(name)
    cells = contribution(model, seed, factor)
    once = rounded(model, profile, cells)
    assert (opaque(rounded(model, profile, once)) == opaque(once)).all()
    assert model.check(once) is None
    for field in ("stamp", "revision"):
        np.testing.assert_array_equal(once[field], cells[field])
    some = np.random.default_rng(seed).permutation(len(cells))[: len(cells) // 2]
    assert (opaque(rounded(model, profile, cells[some])) == opaque(once)[some]).all()


@pytest.mark.parametrize(("name", "profile"), CASES)
def test_unknown_stays_unknown(name: str, profile: str) -> None:
    model = make_model(name)
    cells = np.concatenate([np.zeros(3, model.cell), contribution(model, 1), np.zeros(2, model.cell)])
    once = rounded(model, profile, cells)
    np.testing.assert_array_equal(model.known(once), model.known(cells))
    assert (opaque(once)[:3] == opaque(cells)[:3]).all()


@pytest.mark.parametrize(("name", "profile"), CASES)
@given(seed=SEEDS)
@settings(max_examples=15, deadline=None)
def test_rounded_cells_travel_short_and_without_loss(name: str, profile: str, seed: int) -> None:
    model = make_model(name)
    mapper = Mapper("r1", LATTICE, model)
    for scan in mixed_scans(seed, 3, KINDS[name]):
        mapper.integrate(scan)
    delta = report(mapper.delta(), profile, model)
    message = encode(delta)
    again = decode(message, model.cell)
    assert heading(message).form in (profile, "lean")
    assert encode(again) == message
    assert [tile.key for tile in again.tiles] == [tile.key for tile in delta.tiles]
    for one, other in zip(again.tiles, delta.tiles, strict=True):
        assert (opaque(one.cells) == opaque(other.cells)).all()
        np.testing.assert_array_equal(one.at, other.at)


def test_cells_that_are_not_rounded_travel_exact() -> None:
    model = make_model("elevation")
    mapper = Mapper("r1", LATTICE, model)
    for scan in mixed_scans(3, 3, (cloud,)):
        mapper.integrate(scan)
    whole = mapper.delta()
    assert heading(encode(whole)).form == "exact"
    assert report(whole, "exact", model) is whole
    short = report(whole, "lean", model)
    assert heading(encode(short)).form == "lean"
    mixed = Delta(*(getattr(whole, name) for name in ("map", "robot", "since", "revision", "stamp_ns")),
                  (*short.tiles[:-1], whole.tiles[-1]))  # fmt: skip
    assert heading(encode(mixed)).form == "exact"


def test_a_profile_that_there_is_not() -> None:
    model = make_model("grey")
    delta = Mapper("r1", LATTICE, model).delta()
    with pytest.raises(InputError, match=r"no profile 'fat'.*exact, full, lean"):
        report(delta, "fat", model)


# --- bounds, as docs/delta-format.md states them ----------------------------------------------------------------------

CM = 0.005 + 1e-9
Bound = tuple[str, Callable[[Floats], Any]]
"""A layer, and by how much each of its values may be off."""


def always(most: float) -> Callable[[Floats], Any]:
    return lambda values: most


def share(most: float, least: float = 0.0) -> Callable[[Floats], Any]:
    return lambda values: most * abs(values) + least + 1e-12


BOUNDS: dict[tuple[str, str], Sequence[Bound]] = {
    ("elevation", "full"): [
        ("z_max", always(CM)), ("z_min", always(CM)), ("n", share(1 / 16)), ("changes", always(0)),
        ("dynamic", always(0)),
    ],
    ("elevation", "lean"): [("height", always(CM)), ("state", always(0)), ("n", share(1 / 3))],
    ("terrain", "full"): [
        ("height", always(CM)), ("gradient_x", always(0.005 + 1e-6)), ("gradient_y", always(0.005 + 1e-6)),
        ("gradient_error", share(1 / 16, 2**-17)), ("occupation", always(0.005 + 1e-6)),
        # Half a step of 255/4096, and the share of it that rounding to a level adds.
        ("confidence", share(1 / 32, (1 + 1 / 32) * 255 * 2**-13)), ("gps_quality", always(0)),
        ("communications", always(0)),
    ],
    ("terrain", "lean"): [
        ("height", always(CM)), ("confidence", share(1 / 5, (1 + 1 / 5) * 255 * 2**-13)), ("gps_quality", always(0)),
    ],
    ("occupancy", "full"): [("log_odds", always(0.025 + 1e-9)), ("updates", share(1 / 8))],
    ("occupancy", "lean"): [("log_odds", always(0.05 + 1e-9)), ("updates", share(1))],
    ("grey", "full"): [("a", always(1 / 255)), ("b", always(1 / 255)), ("white", always(1 / 510))],
    ("grey", "lean"): [("a", always(1 / 15)), ("b", always(1 / 15)), ("white", always(1 / 30))],
}  # fmt: skip


def assert_near(found: Floats, true: Floats, most: Any) -> None:
    np.testing.assert_array_equal(np.isnan(found), np.isnan(true))
    assert (np.nan_to_num(abs(found - true)) <= most).all()


@pytest.mark.parametrize(("name", "profile"), CASES)
@given(seed=SEEDS, factor=st.sampled_from([1, 4]))
@settings(max_examples=25, deadline=None)
@example(seed=245, factor=4)
def test_layers_are_off_by_no_more_than_stated(name: str, profile: str, seed: int, factor: int) -> None:
    model = make_model(name)
    cells = contribution(model, seed, factor)
    once = rounded(model, profile, cells)
    for what, most in [*BOUNDS[name, profile], ("stamp", always(0))]:
        true = layer(model, what, cells)
        assert_near(layer(model, what, once), true, most(np.nan_to_num(true)))


@given(seed=SEEDS, factor=st.sampled_from([1, 4]))
@settings(max_examples=50, deadline=None)
def test_variance_and_mean_of_elevation(seed: int, factor: int) -> None:
    model = make_model("elevation")
    cells = contribution(model, seed, factor)
    once = rounded(model, "full", cells)
    assert_variance_and_mean(model, cells, once)


def assert_variance_and_mean(model: Model, cells: Array, once: Array) -> None:
    """Variance: to 1/8 from 0.04 m² on; below, it may be less by 1 cm · the range. Mean: 5 mm, 15 mm from there on."""
    mean, var = layer(model, "z_mean", cells), layer(model, "z_var", cells)
    reach = layer(model, "z_max", cells) - layer(model, "z_min", cells)
    found = layer(model, "z_var", once)
    tall = var >= 0.04 - 1e-6
    assert_near(layer(model, "z_mean", once), mean, np.where(tall, 3 * CM, CM))
    assert (found <= var * (1 + 1 / 16) + 1e-6).all()
    assert (found >= np.where(tall, var * (1 - 1 / 8), var * (1 - 1 / 8) - 0.01 * (reach + 0.01)) - 1e-6).all()


POINTS = st.lists(st.floats(-10_000, 10_000, width=32), min_size=1, max_size=8) | st.lists(
    st.sampled_from([0.0, 0.001, 0.004, 0.0051, 0.3, 2.0, 3.0, 3.004, 9.99]), min_size=1, max_size=40
)


@given(st.lists(POINTS, min_size=1, max_size=6), st.sampled_from([0.0, 500.0, -10_000.0]))
@settings(max_examples=300, deadline=None)
def test_any_points_make_cells_that_can_be(stacks: list[list[float]], up_m: float) -> None:
    model = make_model("elevation")
    cells = np.zeros(len(stacks), model.cell)
    for cell, heights in zip(cells, stacks, strict=True):
        z = [round((height + up_m if abs(height + up_m) < 10_000 else height) * 200_000) for height in heights]
        square = sum(one * one for one in z)
        cell["n"], cell["z_min"], cell["z_max"], cell["z_sum"] = len(z), min(z), max(z), sum(z)
        cell["sq_hi"], cell["sq_lo"], cell["merges"], cell["revision"] = square >> 64, square % 2**64, 1, 1
    assert model.check(cells) is None
    for profile in ("full", "lean"):
        once = rounded(model, profile, cells)
        assert model.check(once) is None
        assert (opaque(rounded(model, profile, once)) == opaque(once)).all()
        assert_near(layer(model, "height", rounded(model, "lean", cells)), layer(model, "height", cells), CM)
        if profile == "full":
            assert_near(layer(model, "z_max", once), layer(model, "z_max", cells), CM)
            assert_variance_and_mean(model, cells, once)


# --- and of what is folded of several robots' cells -------------------------------------------------------------------


def met(model: Model, seed: int) -> list[Array]:
    """(M,) cells of each of three robots at places that at least one of them knows."""
    found = []
    for k in range(3):
        mapper = Mapper("r", LATTICE, model)
        for scan in mixed_scans(seed + k, 3, KINDS[model.name]):
            mapper.integrate(scan)
        found.append({(tile.key, at): cell for tile in mapper.delta().tiles
                      for at, cell in zip(tile.at.tolist(), tile.cells, strict=True)})  # fmt: skip
    places = sorted(set().union(*found))
    none = np.zeros((), model.cell)
    return [np.array([one.get(place, none) for place in places], model.cell) for one in found]


def folds(model: Model, profile: str, robots: list[Array]) -> tuple[Array, Array]:
    """Of what robots hold, and of what they report."""
    return fold(model, robots, LATTICE), fold(model, [rounded(model, profile, cells) for cells in robots], LATTICE)


@pytest.mark.parametrize(("profile", "weight"), [("full", 1 / 16), ("lean", 1 / 3)])
@given(seed=SEEDS)
@settings(max_examples=25, deadline=None)
def test_folded_heights(profile: str, weight: float, seed: int) -> None:
    """A mean of means whose weights are off by a share moves by that share of what robots disagree by."""
    model = make_model("elevation", {"static": True})
    robots = met(model, seed)
    true, found = folds(model, profile, robots)
    means = np.array([layer(model, "z_mean", cells) for cells in robots])
    apart = np.nanmax(means, axis=0) - np.nanmin(means, axis=0)
    most = 3 * CM + 2 * weight / (1 - weight) * apart
    if profile == "full":
        assert_near(layer(model, "z_mean", found), layer(model, "z_mean", true), most)
        assert_near(layer(model, "z_max", found), layer(model, "z_max", true), CM)
    vertical = absorb.vertical(np.concatenate(robots), model.rules(LATTICE)).reshape(3, -1).any(axis=0)
    flat = ~vertical & (layer(model, "state", true) == 1) & (layer(model, "state", found) == 1)
    assert_near(layer(model, "height", found)[flat], layer(model, "height", true)[flat], most[flat])


@pytest.mark.parametrize(("profile", "nats"), [("full", 0.025), ("lean", 0.05)])
@given(seed=SEEDS)
@settings(max_examples=15, deadline=None)
def test_folded_log_odds(profile: str, nats: float, seed: int) -> None:
    model = make_model("occupancy")
    true, found = folds(model, profile, met(model, seed))
    assert_near(layer(model, "log_odds", found), layer(model, "log_odds", true), 3 * nats + 1e-9)


@pytest.mark.parametrize(("profile", "step"), [("full", 1 / 255), ("lean", 1 / 15)])
@given(seed=SEEDS)
@settings(max_examples=15, deadline=None)
def test_folded_intervals(profile: str, step: float, seed: int) -> None:
    """As far off as the robots' are, where no robot's white value is so near ½ that rounding changes its side."""
    model = make_model("grey", {"opening_angle_rad": 0.4})
    robots = met(model, seed)
    true, found = folds(model, profile, robots)
    sure = np.all([(abs(lower(cells) + upper(cells) - 1) > step) | ~model.known(cells) for cells in robots], axis=0)
    for end in (lower, upper):
        assert_near(end(found)[sure], end(true)[sure], step + 1e-9)


@pytest.mark.parametrize(("profile", "weight"), [("full", 1 / 32), ("lean", 1 / 5)])
@given(seed=SEEDS)
@settings(max_examples=25, deadline=None)
def test_folded_terrain(profile: str, weight: float, seed: int) -> None:
    """Where robots see one surface, nearly level, the mean by confidence; where one alone knows a cell, its own."""
    model = make_model("terrain", {"similar_angle_rad": 3.1415, "similar_height_m": 100.0, "half_life_s": None})
    robots = [np.where(cells["flags"] & 512 == 0, cells, np.zeros((), model.cell)) for cells in met(model, seed)]
    true, found = folds(model, profile, robots)
    heights = np.array([layer(model, "height", cells) for cells in robots])
    known = ~np.isnan(heights).all(axis=0)
    apart = np.nanmax(heights[:, known], axis=0) - np.nanmin(heights[:, known], axis=0)
    most = CM + 4 * weight / (1 - weight) * apart + 1e-3 * (apart > 0)
    assert_near(layer(model, "height", found)[known], layer(model, "height", true)[known], most)


# --- levels -----------------------------------------------------------------------------------------------------------


def test_levels_by_hand() -> None:
    # With 1 + 1 significant bits there are 0, 1, 2, 3, 4, 6, 8, 12, 16, ...; 5 lies between 4 and 6, and goes up.
    assert at_level(np.arange(9), 1).tolist() == [0, 1, 2, 3, 4, 6, 8, 12, 16]
    values = np.array([0, 3, 4, 5, 7, 9, 10, 14, 15])
    assert at_level(level(values, 1), 1).tolist() == [0, 3, 4, 6, 8, 8, 12, 16, 16]
    assert at_level(level_below(values, 1), 1).tolist() == [0, 3, 4, 4, 6, 8, 8, 12, 12]
    assert at_level(level_above(values, 1), 1).tolist() == [0, 3, 4, 6, 8, 12, 12, 16, 16]


@given(st.integers(0, 2**52), st.integers(0, 6))
def test_levels(value: int, bits: int) -> None:
    (below,), (near,), (above,) = (
        at_level(turn(np.array([value]), bits), bits).tolist() for turn in (level_below, level, level_above)
    )
    assert below <= value <= above
    assert near in (below, above)
    assert abs(near - value) <= value / 2 ** (bits + 1)
    assert above - value <= value / 2**bits
    for number in (below, near, above):
        assert at_level(level(np.array([number]), bits), bits).tolist() == [number]


def test_steps_are_the_nearest() -> None:
    assert steps(np.array([0.0, 0.0149, 0.0151, -0.0149, 1e300]), 0.01).tolist() == [0, 1, 2, -1, 2**44]
