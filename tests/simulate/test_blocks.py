"""What stands: roofs, houses, walls, regions, and worlds made of plans."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from terrafuse.errors import InputError
from terrafuse.lattice import Lattice
from terrafuse.rosmap import read_map
from terrafuse.simulate import truth
from terrafuse.simulate.blocks import ROOFS, Block, corners_of, overlap, top_at, triangles_of
from terrafuse.simulate.houses import HOUSES, House, Wall, house_blocks, wall_blocks
from terrafuse.simulate.regions import Region, StaticLayer
from terrafuse.simulate.terrain import Terrain, flat
from terrafuse.simulate.world import World
from terrafuse.simulate.worlds import image_world, ros_map_world
from terrafuse.simulate.worlds.imported import merged
from terrafuse.types import Bounds

GROUND = flat(Bounds(-50, -50, 50, 50), 7.0)


def block(roof: str, length: float = 10.0, width: float = 6.0, yaw: float = 0.0) -> Block:
    return Block("house", 0.0, 0.0, length, width, yaw, -1.0, 3.0, 6.0, roof)


@pytest.mark.parametrize(
    ("roof", "tops"),
    [
        ("flat", (6, 6, 6, 6)),
        # Over the middle; half way to the side wall: half as high; by the gable's wall: still 6.
        ("gable", (6, 4.5, 6, 6)),
        # Slope 1: 3 m from the ridge to the walls. At u = 4 it is 1 m from the wall of the end, so at 3 + 1.
        ("hip", (6, 4.5, 4, 6)),
    ],
)
def test_roofs_are_as_high_as_worked_out(roof: str, tops: tuple[float, ...]) -> None:
    u, v = np.array([0.0, 0.0, 4.0, 1.0]), np.array([0.0, 1.5, 0.0, 0.0])
    assert top_at(block(roof), u, v).tolist() == list(tops)
    assert top_at(block(roof), 5.01, 0.0) == -np.inf
    c, s = math.cos(0.7), math.sin(0.7)
    np.testing.assert_allclose(top_at(block(roof, yaw=0.7), c * u - s * v, s * u + c * v), tops, atol=1e-12)


@pytest.mark.parametrize("roof", ROOFS)
def test_solids_are_closed_but_for_their_foot_and_face_outward(roof: str) -> None:
    """Each edge is run through once each way, but those of the foot; and the volume, by the divergence theorem, is that
    worked out by hand: 10·6·4 m³ of walls, and 10·6·3 (flat), half of that (gable), or 4·6·3/2 + 6·6·3/3 (hip)."""
    faces = triangles_of([block(roof)])
    edges: dict[tuple[tuple[float, ...], tuple[float, ...]], int] = {}
    for face in faces.round(9).tolist():
        for a, b in zip(face, face[1:] + face[:1], strict=True):
            edges[tuple(a), tuple(b)] = edges.get((tuple(a), tuple(b)), 0) + 1
    assert set(edges.values()) == {1}
    single = [(a, b) for a, b in edges if (b, a) not in edges]
    assert {a[2] for edge in single for a in edge} == {-1.0}
    from_foot = faces - np.array([0, 0, -1.0])
    volume = np.einsum("ij,ij->i", from_foot[:, 0], np.cross(from_foot[:, 1], from_foot[:, 2])).sum() / 6
    assert volume == pytest.approx(240 + {"flat": 180, "gable": 90, "hip": 72}[roof])


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10**6))
def test_blocks_overlap_where_a_place_is_in_both(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.linspace(-9, 9, 181), np.linspace(-9, 9, 181))
    one, other = (
        Block("a", *rng.uniform(-4, 4, 2), *rng.uniform(1, 5, 2), rng.uniform(0, 7), 0.0, 1.0, 1.0) for _ in range(2)
    )
    both = np.isfinite(top_at(one, x, y)) & np.isfinite(top_at(other, x, y))
    if both.any():
        assert overlap(one, other)
    if not overlap(one, other):
        assert not both.any()


@pytest.mark.parametrize("shape", HOUSES)
def test_a_house_is_as_high_as_it_says_and_within_its_outline(shape: str) -> None:
    house = House(3.0, -2.0, 12.0, 8.0, 9.0, 0.4, shape)
    blocks = house_blocks(house, GROUND)
    assert max(b.top_m for b in blocks) == 7.0 + 9.0
    assert all(b.bottom_m == 6.5 for b in blocks)
    outline = Block("outline", 3.0, -2.0, 12.0 + 1e-9, 8.0 + 1e-9, 0.4, 0.0, 1.0, 1.0)
    for part in blocks:
        assert np.isfinite(top_at(outline, *corners_of(part).T)).all()


def test_houses_and_walls_follow_the_ground() -> None:
    """Ground that rises 1 in 5 to the east: under a house of 10 m from x = 5 it is 1 to 3 m high, 2 in the middle. A
    wall of 12 m is cut in 3 pieces of 4 m, with grounds of 0.4, 1.2, 2 m at their middles."""
    slope = Terrain(0.0, -20.0, 40.0, np.array([[0.0, 8.0], [0.0, 8.0]]))
    (one,) = house_blocks(House(10.0, 0.0, 10.0, 6.0, 5.0), slope)
    assert (one.bottom_m, one.top_m) == pytest.approx((1.0 - 0.5, 2.0 + 5.0))
    pieces = wall_blocks(Wall(0.0, 0.0, 12.0, 0.0, 1.5), slope)
    assert [p.top_m for p in pieces] == pytest.approx([1.9, 2.7, 3.5])
    assert [p.bottom_m for p in pieces] == pytest.approx([-0.5, 0.3, 1.1])
    assert [p.length_m for p in pieces] == pytest.approx([4.0] * 3)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: House(0, 0, 0, 5, 5), "give finite numbers and positive sides"),
        (lambda: House(0, 0, 5, 5, math.nan), "give finite numbers and positive sides"),
        (lambda: House(0, 0, 5, 5, 5, shape="igloo"), "house shape 'igloo': there are box, l, gabled, hipped, tower"),
        (lambda: Wall(1, 1, 1, 1, 2), "two different places"),
        (lambda: Block("x", 0, 0, 1, 1, 0, 0, 2, 1), "let them rise"),
        (lambda: Block("x", 0, 0, 1, -1, 0, 0, 1, 1), "give positive sides"),
        (lambda: Block("x", 0, 0, 1, 1, 0, 0, 1, 1, "dome"), "roof 'dome': there are flat, gable, hip"),
        (lambda: Block("x", 0, 0, 1, 2, 0, 0, 1, 2, "hip"), "swap the sides"),
        (
            lambda: World("w", Bounds(-50, -50, 50, 51), GROUND.__class__(-50, -50, 100, np.zeros((2, 2)))),
            "does not cover",
        ),
        (
            lambda: World("w", Bounds(-9, -9, 9, 9), GROUND, gps_quality=StaticLayer(3)),
            "gps_quality 3: give one of 0, 1, 2",
        ),
        (lambda: World("w", Bounds(-9, -9, 9, 9), GROUND, (House(99, 0, 5, 5, 5),)).blocks, "off the terrain"),
        (lambda: Region(1, ((0, 0), (1, 1))), "a region of 2 corners"),
        (lambda: ros_map_world("nowhere.yaml"), "nowhere.yaml: can.t be read as text: there is no such file"),
        (lambda: image_world("nowhere.png", 0.1), "nowhere.png: no such file"),
    ],
)
def test_what_can_not_stand_is_refused(make: object, says: str) -> None:
    with pytest.raises(InputError, match=says):
        make()  # type: ignore[operator]


@given(st.integers(0, 10**6), st.integers(1, 12), st.integers(1, 12))
def test_rectangles_tile_a_mask(seed: int, rows: int, columns: int) -> None:
    mask = np.random.default_rng(seed).random((rows, columns)) < 0.6
    count = np.zeros(mask.shape, int)
    for i0, j0, i1, j1 in merged(mask):
        count[j0:j1, i0:i1] += 1
    np.testing.assert_array_equal(count, mask)


def test_a_full_mask_is_one_rectangle() -> None:
    assert merged(np.ones((3, 5), bool)).tolist() == [[0, 0, 5, 3]]


@pytest.mark.parametrize("name", ["tb3_sandbox", "map_circular"])
def test_a_ros_maps_world_is_occupied_where_the_map_is(recordings: Path, name: str) -> None:
    """On a lattice whose cells are the map's pixels."""
    file = recordings / f"maps/nav2/{name}.yaml"
    plan, world = read_map(file), ros_map_world(file)
    r = plan.placement.resolution_m
    i, j = round(plan.placement.east_m / r), round(plan.placement.north_m / r)
    assert (i * r, j * r) == pytest.approx((plan.placement.east_m, plan.placement.north_m), abs=1e-9)
    rows, columns = plan.grey.shape
    found = truth.occupied(world, Lattice(r, 100 * r), (i, j, i + columns, j + rows), (0.1, 1.0))
    np.testing.assert_array_equal(found[::-1], plan.probability >= plan.meaning.occupied_thresh)


@pytest.mark.parametrize("name", ["testmap", "depot"])
def test_walls_cover_as_much_as_the_maps_black_pixels(recordings: Path, name: str) -> None:
    """Also where the map lies askew, as testmap does."""
    file = recordings / f"maps/nav2/{name}.yaml"
    plan, world = read_map(file), ros_map_world(file)
    black = (plan.probability >= plan.meaning.occupied_thresh).sum()
    area = sum(b.length_m * b.width_m for b in world.blocks)
    assert area == pytest.approx(black * plan.placement.resolution_m**2)


def test_a_turned_ros_map_is_turned_about_its_corner(tmp_path: Path) -> None:
    """Two pixels of 1 m, the right one black, turned by 90° about (10, 20): the black one is 1.5 m north of the corner
    and half a metre west."""
    (tmp_path / "plan.pgm").write_bytes(b"P5\n2 1\n255\n\xfe\x00")
    (tmp_path / "plan.yaml").write_text(
        f"image: plan.pgm\nresolution: 1.0\norigin: [10, 20, {math.pi / 2}]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    pytest.importorskip("PIL")
    (wall,) = ros_map_world(tmp_path / "plan.yaml", height_m=3.0).blocks
    assert (wall.x_m, wall.y_m) == pytest.approx((9.5, 21.5))
    assert wall.top_m == 3.0
    (same,) = image_world(tmp_path / "plan.pgm", 0.5).blocks
    assert (same.x_m, same.y_m, same.length_m) == pytest.approx((0.75, 0.25, 0.5))
    with pytest.raises(InputError, match="walls 0 m high"):
        image_world(tmp_path / "plan.pgm", 0.5, height_m=0)
