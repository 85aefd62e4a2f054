"""Rays: the range on the triangle that a ray hits, in float64, and the first body in front of it.

A plane n·p = d is met at t = (d - n·o)/(n·r). An upright box is met where its three slabs' spans begin to overlap
(Kay & Kajiya), an upright cylinder likewise with the span within its circle. A ray that starts in a body does not see
it.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from terrafuse.types import Array, Floats

NONE = -1
"""The triangle of a ray that hits none."""


@njit(cache=True, nogil=True)
def _slab(at, rate, low, high):
    """The span of a ray within low ≤ at + t·rate ≤ high."""
    if rate == 0.0:
        return (-np.inf, np.inf) if low <= at <= high else (np.inf, -np.inf)
    one, other = (low - at) / rate, (high - at) / rate
    return (one, other) if one < other else (other, one)


@njit(cache=True, nogil=True)
def _disc(x, y, dx, dy, radius):
    """The span of a ray over a disc around 0."""
    a, b, c = dx * dx + dy * dy, x * dx + y * dy, x * x + y * y - radius * radius
    if a == 0.0:
        return (-np.inf, np.inf) if c <= 0.0 else (np.inf, -np.inf)
    root = b * b - a * c
    if root < 0.0:
        return np.inf, -np.inf
    root = math.sqrt(root)
    return (-b - root) / a, (-b + root) / a


@njit(cache=True, nogil=True)
def meet(b, ox, oy, oz, dx, dy, dz):
    """(t, nx, ny, nz) where a ray enters body b: inf if it does not, or starts within."""
    x, y = ox - b.x, oy - b.y
    u, v = b.cos * x + b.sin * y, b.cos * y - b.sin * x
    du, dv = b.cos * dx + b.sin * dy, b.cos * dy - b.sin * dx
    low, leave = _slab(oz, dz, b.bottom, b.top)
    enter, nu, nv, nz = low, 0.0, 0.0, -math.copysign(1.0, dz)
    if b.round:
        first, last = _disc(u, v, du, dv, b.half_length)
        if first > enter:
            enter, nu, nv, nz = first, (u + first * du) / b.half_length, (v + first * dv) / b.half_length, 0.0
        leave = min(leave, last)
    else:
        first, last = _slab(u, du, -b.half_length, b.half_length)
        if first > enter:
            enter, nu, nv, nz = first, -math.copysign(1.0, du), 0.0, 0.0
        leave = min(leave, last)
        first, last = _slab(v, dv, -b.half_width, b.half_width)
        if first > enter:
            enter, nu, nv, nz = first, 0.0, -math.copysign(1.0, dv), 0.0
        leave = min(leave, last)
    if not (0.0 < enter <= leave):
        return np.inf, 0.0, 0.0, 0.0
    return enter, b.cos * nu - b.sin * nv, b.sin * nu + b.cos * nv, nz


@njit(cache=True, nogil=True)
def _near(bodies, origins, reach):
    """Numbers of the bodies that some ray may reach, with the squares of their bounding circles' radii."""
    west, east, south, north = np.inf, -np.inf, np.inf, -np.inf
    for k in range(len(origins)):
        west, east = min(west, origins[k, 0]), max(east, origins[k, 0])
        south, north = min(south, origins[k, 1]), max(north, origins[k, 1])
    out, radii2, count = np.empty(len(bodies), np.int64), np.empty(len(bodies)), 0
    for k in range(len(bodies)):
        b = bodies[k]
        radius = b.half_length if b.round else math.hypot(b.half_length, b.half_width)
        radius += 1e-9 * (1.0 + radius)
        gap_x = max(west - b.x, b.x - east, 0.0)
        gap_y = max(south - b.y, b.y - north, 0.0)
        if math.hypot(gap_x, gap_y) <= reach + radius:
            out[count], radii2[count] = k, radius * radius
            count += 1
    return out[:count], radii2[:count]


@njit(cache=True, nogil=True)
def finish(origins, directions, triangles, planes, bodies, reach, ranges, normals):
    """Ranges (N,), and normals (N, 3) against the ray, of rays whose triangles are known; inf and 0 where nothing is in
    reach. `planes` (T, 4) are n and n·p in the frame of the origins, as are `bodies`, (K,) records."""
    near, radii2 = _near(bodies, origins, reach)
    for k in range(len(directions)):
        ox, oy, oz = origins[k, 0], origins[k, 1], origins[k, 2]
        dx, dy, dz = directions[k, 0], directions[k, 1], directions[k, 2]
        t, nx, ny, nz = np.inf, 0.0, 0.0, 0.0
        number = triangles[k]
        if number != NONE:
            nx, ny, nz, offset = planes[number, 0], planes[number, 1], planes[number, 2], planes[number, 3]
            toward = nx * dx + ny * dy + nz * dz
            if toward != 0.0:
                t = max((offset - nx * ox - ny * oy - nz * oz) / toward, 0.0)
            if toward > 0.0:
                nx, ny, nz = -nx, -ny, -nz
        for m in range(len(near)):
            b = bodies[near[m]]
            # Beside the bounding circle: (x, y) × (dx, dy) is the distance times the length of the direction's shadow.
            x, y = ox - b.x, oy - b.y
            cross = x * dy - y * dx
            if cross * cross > radii2[m] * (dx * dx + dy * dy):
                continue
            body_t, bx, by, bz = meet(b, ox, oy, oz, dx, dy, dz)
            if body_t < t:
                t, nx, ny, nz = body_t, bx, by, bz
        if t > reach:
            t, nx, ny, nz = np.inf, 0.0, 0.0, 0.0
        ranges[k] = t
        normals[k, 0], normals[k, 1], normals[k, 2] = nx, ny, nz


def bodies_reference(origins: Floats, directions: Floats, bodies: Array) -> Floats:
    """(N,) range at which each ray enters the first body, inf where it enters none."""
    out = np.full(len(directions), np.inf)
    for b in bodies:
        turn = np.array([[b["cos"], b["sin"], 0], [-b["sin"], b["cos"], 0], [0, 0, 1]])
        o, d = (origins - [b["x"], b["y"], 0]) @ turn.T, directions @ turn.T
        half = np.array([b["half_length"], b["half_width"]])
        low, high = np.array([*-half, b["bottom"]]), np.array([*half, b["top"]])
        with np.errstate(divide="ignore", invalid="ignore"):
            spans = np.sort([(low - o) / d, (high - o) / d], axis=0)
            if b["round"]:
                a, h = (d[:, :2] ** 2).sum(axis=1), (o[:, :2] * d[:, :2]).sum(axis=1)
                root = np.sqrt(h * h - a * ((o[:, :2] ** 2).sum(axis=1) - half[0] ** 2))
                upright = np.where((o[:, :2] ** 2).sum(axis=1) <= half[0] ** 2, -np.inf, np.inf)
                spans[:, :, 0] = np.where(a > 0, [(-h - root) / a, (-h + root) / a], [upright, -upright])
                spans[:, :, 1] = [[-np.inf], [np.inf]]
        enter, leave = spans[0].max(axis=1), spans[1].min(axis=1)
        out = np.where((enter > 0) & (enter <= leave), np.minimum(out, enter), out)
    return out
