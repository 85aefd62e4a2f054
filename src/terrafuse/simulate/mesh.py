"""What stands for good as triangles: the ground first, then the blocks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from terrafuse.simulate.blocks import triangles_of
from terrafuse.simulate.terrain import Terrain
from terrafuse.simulate.world import World
from terrafuse.types import Array, Floats


class Mesh(NamedTuple):
    """`vertices_m` (V, 3) float64 in the world, `triangles` (T, 3) int32, anticlockwise as seen from outside."""

    vertices_m: Floats
    triangles: Array


def mesh_of(world: World) -> Mesh:
    ground = terrain_mesh(world.terrain)
    faces = triangles_of(world.blocks)
    faces = faces[_areas(faces) > 0]
    numbers = len(ground.vertices_m) + np.arange(3 * len(faces), dtype=np.int32).reshape(-1, 3)
    vertices = np.concatenate([ground.vertices_m, faces.reshape(-1, 3)])
    return Mesh(vertices, np.concatenate([ground.triangles, numbers]))


def terrain_mesh(terrain: Terrain) -> Mesh:
    x, y = np.meshgrid(*terrain.axes_m)
    number = np.arange(x.size, dtype=np.int32).reshape(x.shape)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
    # Two triangles of one square are neighbours in the list: what is near is near in memory.
    triangles = np.stack([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)], axis=2)
    return Mesh(np.stack([x, y, terrain.heights_m], axis=-1).reshape(-1, 3), triangles.reshape(-1, 3))


def planes_of(mesh: Mesh) -> Floats:
    """(T, 4): unit normal n and offset n·p of each triangle's plane."""
    a, b, c = (mesh.vertices_m[mesh.triangles[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.sqrt(np.einsum("ij,ij->i", normals, normals))[:, None]
    return np.concatenate([normals, np.einsum("ij,ij->i", normals, a)[:, None]], axis=1)


def _areas(faces: Floats) -> Floats:
    return np.asarray(np.linalg.norm(np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0]), axis=1))
