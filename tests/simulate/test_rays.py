"""What rays meet: against every triangle tried in float64, against numbers worked out by hand, far from the origin."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from terrafuse.errors import InputError, MissingExtra
from terrafuse.kernels.casting import NONE, bodies_reference, finish
from terrafuse.simulate.blocks import Block
from terrafuse.simulate.mesh import mesh_of
from terrafuse.simulate.movers import bodies, body
from terrafuse.simulate.rays import SHARE, RayCaster, first_hits_reference
from terrafuse.simulate.terrain import flat
from terrafuse.simulate.world import World
from terrafuse.types import Array, Bounds
from tests.simulate.places import directions, hamlet, places, room

pytest.importorskip("embreex")

UP = np.array([0.0, 0.0, 1.0])


@pytest.mark.parametrize("origin", [(0.0, 0.0), (500_000.0, 5_400_000.0)])
def test_ranges_are_those_of_the_reference(origin: tuple[float, float]) -> None:
    world, rng = hamlet(*origin), np.random.default_rng(0)
    rays = directions(rng, 1500)
    starts = places(rng, world, len(rays), (12.0, 20.0))
    ranges = RayCaster(world).cast(starts, rays, 200.0).ranges_m
    expected = first_hits_reference(mesh_of(world), starts, rays)
    np.testing.assert_array_equal(np.isfinite(ranges), np.isfinite(expected))
    hit = np.isfinite(ranges)
    assert hit.sum() > 300
    # Float64 steps at 5,400 km are 1 nm, and the reference adds up a few of them at slanting incidence.
    np.testing.assert_allclose(ranges[hit], expected[hit], atol=1e-6 if origin[0] else 1e-10)


def test_a_range_is_exact_where_float32_is_not() -> None:
    """A wall 1.3 m beside the sensor, 1 km from the middle, met at a slope of 1 in 50: 1.3·√(50² + 1) m.

    Float32 has steps of 0.06 mm there: rounding to one errs by up to 0.03 mm across the ray, 1.5 mm along it, and wall
    and sensor are both rounded.
    """
    bounds = Bounds(-1500.0, -1500.0, 1500.0, 1500.0)
    wall = Block("wall", 1002.423, -956.0, 200.0, 2.0, np.pi / 2, -1.0, 5.0, 5.0)
    caster = RayCaster(World("wall", bounds, flat(bounds), furniture=(wall,)))
    ray = np.array([[1.0, 50.0, 0.0]]) / np.sqrt(2501.0)
    hits = caster.cast([1000.123, -1000.456, 1.3], ray, 100.0)
    assert hits.ranges_m[0] == pytest.approx((1002.423 - 1.0 - 1000.123) * np.sqrt(2501.0), abs=1e-10)
    np.testing.assert_allclose(hits.normals[0], [-1, 0, 0], atol=1e-12)


def test_edges_are_where_they_should_be_to_a_tenth_of_a_millimetre() -> None:
    """Straight down 0.1 mm within and without the four edges of a block 1 km from the middle, turned at random."""
    rng, bounds = np.random.default_rng(7), Bounds(-1500.0, -1500.0, 1500.0, 1500.0)
    for _ in range(20):
        (x, y), yaw = rng.uniform(800, 1000, 2), rng.uniform(0, 7)
        block = Block("wall", x, y, 7.3, 3.1, yaw, -1.0, 2.0, 2.0)
        caster = RayCaster(World("block", bounds, flat(bounds), furniture=(block,)))
        for edge in ((7.3 / 2, 0.0), (-7.3 / 2, 0.0), (0.0, 3.1 / 2), (0.0, -3.1 / 2)):
            grown = 1 + np.array([-1e-4, 1e-4]) / np.hypot(*edge)
            u, v = np.outer(edge, grown)
            turned = [x + u * np.cos(yaw) - v * np.sin(yaw), y + u * np.sin(yaw) + v * np.cos(yaw)]
            starts = np.stack([*turned, np.full(2, 100.0)], axis=1)
            np.testing.assert_allclose(caster.cast(starts, np.tile(-UP, (2, 1)), 200.0).ranges_m, [98.0, 100.0])


def test_no_ray_slips_through_where_triangles_meet() -> None:
    """Straight down on corners and edges of the terrain's net."""
    world = hamlet()
    x, y = np.meshgrid(np.arange(-36.0, 36.1, 2.0), np.arange(-36.0, 36.1, 2.0))
    starts = np.stack([x.ravel(), y.ravel(), np.full(x.size, 50.0)], axis=1)
    assert np.isfinite(RayCaster(world).cast(starts, np.tile(-UP, (x.size, 1)), 100.0).ranges_m).all()


def test_normals_face_the_ray_and_have_unit_length() -> None:
    world, rng = hamlet(), np.random.default_rng(1)
    rays = directions(rng, 2000)
    hits = RayCaster(world).cast(places(rng, world, len(rays), (2.0, 20.0)), rays, 200.0, body("car", 5, 5, 3.0, 0.4))
    hit = np.isfinite(hits.ranges_m)
    np.testing.assert_allclose(np.linalg.norm(hits.normals[hit], axis=1), 1.0, atol=1e-12)
    assert (np.einsum("ij,ij->i", hits.normals, rays)[hit] <= 0).all()
    assert (hits.normals[~hit] == 0).all()


def test_reach_is_where_it_ends() -> None:
    caster = RayCaster(room())
    ahead = np.array([[1.0, 0.0, 0.0]])
    assert caster.cast([0, 0, 1], ahead, 2.001).ranges_m[0] == pytest.approx(2.0)
    assert caster.cast([0, 0, 1], ahead, 1.999).ranges_m[0] == np.inf


def test_bodies_stand_before_walls() -> None:
    """A room's wall is 2 m away; a person of radius 0.25 m at 1.5 m stands before it: 1.25 m. A car's front, turned to
    the ray, is 4.4/2 m before its middle."""
    caster, ahead = RayCaster(room(20.0)), np.array([[1.0, 0.0, 0.0]])
    person = body("person", 1.5, 0.0, 0.0, 0.0)
    assert caster.cast([0, 0, 1], ahead, 30.0).ranges_m[0] == pytest.approx(10.0)
    assert caster.cast([0, 0, 1], ahead, 30.0, person).ranges_m[0] == pytest.approx(1.25)
    assert caster.cast([0, 0, 1.76], ahead, 30.0, person).ranges_m[0] == pytest.approx(10.0)
    hits = caster.cast([0, 0, 0.5], ahead, 30.0, bodies([person, body("car", 5.0, 0.3, 0.0, np.pi)])[1:])
    assert hits.ranges_m[0] == pytest.approx(5.0 - 2.2)
    np.testing.assert_allclose(hits.normals[0], [-1, 0, 0], atol=1e-12)


def test_a_sensor_does_not_see_the_body_that_it_is_in() -> None:
    own = body("nomad", 0.0, 0.0, 0.0, 0.0)
    hits = RayCaster(room()).cast([0, 0, 0.4], np.array([[0.0, 1.0, 0.0]]), 5.0, own)
    assert hits.ranges_m[0] == pytest.approx(2.0)


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 10**6))
def test_bodies_are_met_as_in_the_reference(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shapes = ["car", "person", "van", "summit_xl", "nomad"]
    there = bodies(
        body(str(rng.choice(shapes)), *rng.uniform(-6, 6, 2), rng.uniform(-1, 1), rng.uniform(0, 7)) for _ in range(5)
    )
    starts, rays = rng.uniform((-9, -9, -1), (9, 9, 3), (200, 3)), directions(rng, 200)
    rays[:30] = np.eye(3)[rng.integers(0, 3, 30)] * rng.choice([-1.0, 1.0], (30, 1))
    none = np.full(len(rays), NONE, np.int32)
    ranges = np.empty(len(rays))
    finish(starts, rays, none, np.empty((0, 4)), there, 1e9, ranges, np.empty((len(rays), 3)))
    np.testing.assert_allclose(ranges, bodies_reference(starts, rays, there), atol=1e-9)


@pytest.mark.parametrize(
    ("origins", "rays", "reach", "says"),
    [
        (np.zeros((2, 3)), np.ones((3, 3)), 1.0, r"rays from \(2, 3\) along \(3, 3\)"),
        (np.zeros(3), np.ones(3), 1.0, r"along \(3,\)"),
        (np.full(3, np.nan), np.ones((1, 3)), 1.0, "not finite"),
        (np.zeros(3), np.ones((1, 3)), 0.0, "reach 0.0 m"),
        (np.zeros(3), np.ones((1, 3)), np.inf, "reach inf m"),
    ],
)
def test_bad_rays_are_refused(origins: Array, rays: Array, reach: float, says: str) -> None:
    with pytest.raises(InputError, match=says):
        RayCaster(room()).cast(origins, rays, reach)


@pytest.mark.parametrize("count", [0, 1, SHARE, 2 * SHARE, 3 * SHARE + 7])
def test_threads_change_nothing(count: int) -> None:
    world, rng = hamlet(), np.random.default_rng(1)
    caster, rays = RayCaster(world), directions(rng, count)
    starts = places(rng, world, count, (2.0, 20.0))
    there = bodies([body("car", 5.0, -5.0, 2.0, 0.3)])
    alone = caster.cast(starts, rays, 50.0, there)
    with caster.threads(3):
        shared = caster.cast(starts, rays, 50.0, there)
    assert [part.tobytes() for part in shared] == [part.tobytes() for part in alone]


def test_no_rays_meet_nothing() -> None:
    hits = RayCaster(room()).cast(np.zeros((0, 3)), np.zeros((0, 3)), 1.0)
    assert hits.ranges_m.shape == (0,)
    assert hits.normals.shape == (0, 3)


def test_without_embree_the_message_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "embreex.rtcore_scene", None)
    with pytest.raises(MissingExtra, match=r"needs the package 'embreex': pip install 'terrafuse\[sim\]'"):
        RayCaster(room())


def test_worlds_and_their_truth_need_nothing_heavy() -> None:
    """Not even Embree, which is loaded with the first caster."""
    program = "import sys, terrafuse.simulate; print({'embreex', 'rasterio', 'PIL', 'mujoco'} & set(sys.modules))"
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "set()"
