"""Rays through a world: what each meets first, how far away, and how it meets it.

Embree, which works in float32, finds the triangle, in coordinates around the world's middle; the range on its plane is
then worked out in float64. So a range is as exact as the world's numbers are; only at an edge, which of two surfaces is
met is decided to float32's step: 0.03 mm at 500 m from the middle.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from terrafuse.errors import InputError, MissingExtra
from terrafuse.kernels.casting import finish
from terrafuse.simulate.mesh import Mesh, mesh_of, planes_of
from terrafuse.simulate.movers import NO_BODIES
from terrafuse.simulate.world import World
from terrafuse.types import Array, Floats

SHARE = 2_000
"""Rays that are worth a thread's waking."""


class Hits(NamedTuple):
    """Of each ray: the range at which it first meets something, inf for nothing in reach; and the surface's unit normal
    there, on the ray's side, 0 for nothing. (N,) and (N, 3)."""

    ranges_m: Floats
    normals: Floats


class RayCaster:
    """Casts rays at a world. What stands for good is taken in once; what moves is told with each call."""

    def __init__(self, world: World) -> None:
        self._centre = _centre(world)
        mesh = mesh_of(world)
        local = Mesh(mesh.vertices_m - self._centre, mesh.triangles)
        self._scene = _scene(local)
        self._planes = planes_of(local)
        self._pool: tuple[Executor, int] | None = None

    @contextmanager
    def threads(self, count: int) -> Iterator[None]:
        """Meanwhile, many rays are shared among so many threads; what comes of them is the same."""
        with ThreadPoolExecutor(max(1, count - 1)) as pool:
            self._pool = (pool, count) if count > 1 else None
            yield
        self._pool = None

    def cast(self, origins_m: Any, directions: Any, reach_m: float, bodies: Array = NO_BODIES) -> Hits:
        """`origins_m` (N, 3) or (3,) for all, and unit `directions` (N, 3), in the world; `bodies` (K,) as of
        `World.bodies(time_s)`. Raises InputError."""
        origins, directions = _checked(origins_m, directions, reach_m)
        if not len(directions):
            return Hits(np.empty(0), np.empty((0, 3)))
        starts = np.broadcast_to(origins - self._centre, directions.shape)
        hits = Hits(np.empty(len(directions)), np.empty_like(directions))
        moved = self._moved(bodies)

        def some(rays: slice) -> None:
            local, along = np.ascontiguousarray(starts[rays]), directions[rays]
            # A hit on the plane may lie a little further than float32 says.
            found = self._scene.run(local.astype(np.float32), along.astype(np.float32), dists=1.001 * reach_m + 0.01)
            finish(local, along, found, self._planes, moved, reach_m, hits.ranges_m[rays], hits.normals[rays])

        self._share(some, len(directions))
        return hits

    def _share(self, cast: Callable[[slice], None], rays: int) -> None:
        pool, threads = self._pool or (None, 1)
        parts = max(1, min(threads, rays // SHARE))
        first, *others = (slice(k * rays // parts, (k + 1) * rays // parts) for k in range(parts))
        waiting = [pool.submit(cast, some) for some in others] if pool is not None else []
        cast(first)
        for each in waiting:
            each.result()

    def _moved(self, bodies: Array) -> Array:
        """Bodies in the frame around the world's middle."""
        if not len(bodies):
            return bodies
        out = bodies.copy()
        out["x"] -= self._centre[0]
        out["y"] -= self._centre[1]
        out["bottom"] -= self._centre[2]
        out["top"] -= self._centre[2]
        return out


def _centre(world: World) -> Floats:
    west, south, east, north = world.bounds
    z = world.terrain.heights_m
    return np.round([(west + east) / 2, (south + north) / 2, (z.min() + z.max()) / 2])


def _scene(mesh: Mesh) -> Any:
    try:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene
    except ImportError as error:
        raise MissingExtra("casting rays in a simulated world", "embreex", "sim") from error
    # Robust: no ray slips through between two triangles that share an edge; it costs a tenth of the speed.
    scene = EmbreeScene(robust=True)
    TriangleMesh(scene, mesh.vertices_m.astype(np.float32), mesh.triangles)
    # The tree is built at the first ray.
    scene.run(np.zeros((1, 3), np.float32), np.array([[0, 0, 1]], np.float32))
    return scene


def _checked(origins_m: Any, directions: Any, reach_m: float) -> tuple[Floats, Floats]:
    origins, directions = np.asarray(origins_m, np.float64), np.ascontiguousarray(directions, np.float64)
    if directions.ndim != 2 or directions.shape[1] != 3 or origins.shape not in ((3,), directions.shape):
        raise InputError(
            f"rays from {origins.shape} along {directions.shape}: give (N, 3) and (N, 3), or (3,) and (N, 3)"
        )
    if not (np.isfinite(origins).all() and np.isfinite(directions).all()):
        raise InputError("rays with origins or directions that are not finite; is the pose sound?")
    if not (np.isfinite(reach_m) and reach_m > 0):
        raise InputError(f"reach {reach_m} m: give a positive number of metres")
    return origins, directions


def first_hits_reference(mesh: Mesh, origins_m: Floats, directions: Floats) -> Floats:
    """Ranges by Möller & Trumbore's test of every ray against every triangle, in float64; inf where nothing is hit."""
    a, b, c = (mesh.vertices_m[mesh.triangles[:, k]] for k in range(3))
    e1, e2 = b - a, c - a
    out = np.full(len(directions), np.inf)
    for k, (o, d) in enumerate(zip(origins_m, directions, strict=True)):
        p = np.cross(d, e2)
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = 1 / np.einsum("ij,ij->i", e1, p)
            q = np.cross(o - a, e1)
            u, v = np.einsum("ij,ij->i", o - a, p) * inverse, q @ d * inverse
            t = np.einsum("ij,ij->i", e2, q) * inverse
            hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
        out[k] = t[hit].min(initial=np.inf)
    return out
