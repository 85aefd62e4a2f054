"""Ground that is a smooth function of (x, y): height, gradient, and where a ray meets it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from terrafuse.types import Array, Floats

CLOSE_ENOUGH_M = 1e-4
"""A ray whose next step is shorter has arrived."""


@dataclass(frozen=True)
class Hill:
    """A Gaussian hill; a negative height makes a hollow."""

    x_m: float
    y_m: float
    height_m: float
    radius_m: float
    """Standard deviation: the flank is steepest here."""


@dataclass(frozen=True)
class Ground:
    """A level, a constant slope, rolling waves and hills, added up. World frame, metres."""

    level_m: float = 0.0
    slope_east: float = 0.0
    slope_north: float = 0.0
    wave_m: float = 0.0
    """Amplitude of sin(2πx/λ)·cos(2πy/λ)."""
    wave_length_m: float = 40.0
    hills: tuple[Hill, ...] = ()

    def height(self, x: Array | float, y: Array | float) -> Floats:
        """z at (x, y), of their common shape."""
        return self.surface(x, y)[0]

    def gradient(self, x: Array | float, y: Array | float) -> tuple[Floats, Floats]:
        """(dz/dx, dz/dy) at (x, y)."""
        _, east, north = self.surface(x, y)
        return east, north

    def surface(self, x: Array | float, y: Array | float) -> tuple[Floats, Floats, Floats]:
        """z, dz/dx and dz/dy together, each of the common shape of x and y."""
        x, y = np.asarray(x, np.float64), np.asarray(y, np.float64)
        k = 2 * math.pi / self.wave_length_m
        (sin_x, cos_x), (sin_y, cos_y) = ((np.sin(k * a), np.cos(k * a)) for a in (x, y))
        z = self.level_m + self.slope_east * x + self.slope_north * y + self.wave_m * sin_x * cos_y
        east = self.slope_east + self.wave_m * k * cos_x * cos_y
        north = self.slope_north - self.wave_m * k * sin_x * sin_y
        for hill in self.hills:
            dx, dy = x - hill.x_m, y - hill.y_m
            bump = hill.height_m * np.exp((dx * dx + dy * dy) * (-0.5 / hill.radius_m**2))
            pull = bump / -(hill.radius_m**2)
            z, east, north = z + bump, east + pull * dx, north + pull * dy
        return np.asarray(z), np.asarray(east), np.asarray(north)

    @property
    def curvature(self) -> float:
        """No second derivative, in any direction, is larger: a·k² of the waves, |h|/r² of a hill, on its top."""
        waves = abs(self.wave_m) * (2 * math.pi / self.wave_length_m) ** 2
        return waves + sum(abs(hill.height_m) / hill.radius_m**2 for hill in self.hills)


def ground_ranges(ground: Ground, origin: Floats, directions: Floats, reach_m: float) -> Floats:
    """Range at which each ray first meets the ground, to 0.1 mm; inf where it does not within `reach_m`.

    `origin` (3,) above the ground, `directions` (N, 3) of unit length, both in the world. A ray that is g above the
    ground, a gap that grows at the rate g', can't touch it before h metres on, g + g'h - ½ch² = 0, with c the
    curvature's bound. Such steps never pass through the ground, and close in on it as Newton's do.
    """
    out = np.full(len(directions), np.inf)
    live, at = np.arange(len(directions)), np.zeros(len(directions))
    dx, dy, dz = directions.T.copy()
    bend = 2 * ground.curvature * (dx * dx + dy * dy)
    while len(live):
        z, east, north = ground.surface(origin[0] + dx * at, origin[1] + dy * at)
        gap = np.maximum(origin[2] + dz * at - z, 0.0)
        rate = dz - east * dx - north * dy
        with np.errstate(divide="ignore", invalid="ignore"):
            step = np.where(gap > 0, 2 * gap / (np.sqrt(rate * rate + bend * gap) - rate), 0.0)
        at = at + step
        arrived = step < CLOSE_ENOUGH_M
        out[live[arrived]] = at[arrived]
        on = ~arrived & (at < reach_m)
        live, at, bend = live[on], at[on], bend[on]
        dx, dy, dz = dx[on], dy[on], dz[on]
    out[out > reach_m] = np.inf
    return out
