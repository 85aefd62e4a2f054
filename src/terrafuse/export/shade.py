"""Hillshade: how bright a surface looks under a light, where it is known."""

from __future__ import annotations

import numpy as np

from terrafuse.types import Floats

LIGHTS = ((315.0, 0.6), (270.0, 0.2), (0.0, 0.2))
"""(azimuth in degrees from north, weight): the north-west of maps, and two beside it so that no slope is lost."""
ALTITUDE_DEG = 45.0
USUAL_SLOPE = 0.2
"""Heights are stretched or flattened until the median place has this slope: hills and fields both show their shape."""
MOST_STRETCH = 4.0


def hillshade(z: Floats, cell_m: float) -> Floats:
    """Brightness of each cell of heights z (H, W), row 0 in the south; 1 is level ground, NaN unknown."""
    east, north = _slope(z, 1) / cell_m, _slope(z, 0) / cell_m
    steep = np.hypot(east, north)[~np.isnan(z)]
    usual = float(np.median(steep)) if len(steep) else 0.0
    stretch = min(MOST_STRETCH, USUAL_SLOPE / max(usual, 1e-9))
    east, north = east * stretch, north * stretch
    up = np.sin(np.radians(ALTITUDE_DEG))
    length = np.sqrt(1 + east**2 + north**2)
    bright = np.zeros(z.shape)
    for azimuth_deg, weight in LIGHTS:
        azimuth = np.radians(azimuth_deg)
        along = np.cos(np.radians(ALTITUDE_DEG)) * (np.sin(azimuth) * east + np.cos(azimuth) * north)
        bright += weight * np.maximum(0.0, (up - along) / length) / up
    return np.where(np.isnan(z), np.nan, bright)


def _slope(z: Floats, axis: int) -> Floats:
    """Rise a cell along an axis: the mean of the steps to the known neighbours, 0 where there is none."""
    step = np.diff(z, axis=axis)
    none = [(0, 0), (0, 0)]
    before, after = list(none), list(none)
    before[axis], after[axis] = (1, 0), (0, 1)
    both = np.stack([np.pad(step, side, constant_values=np.nan) for side in (before, after)])
    known = ~np.isnan(both)
    return np.asarray(np.where(known, both, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1))
