"""A city for fleets: wide streets in a nearly square net on gentle ground, large houses on both sides."""

from __future__ import annotations

import numpy as np

from terrafuse.simulate.noise import Octave
from terrafuse.simulate.quantities import Seed
from terrafuse.simulate.streets import graded
from terrafuse.simulate.terrain import rolling
from terrafuse.simulate.world import World
from terrafuse.simulate.worlds.net import Net, Plot, Side, line_streets, square, street_net

NET = Net(spacing_m=100.0, jitter_m=4.0, dropped=0.05, width_m=14.0)
PLOT = Plot(
    length_m=(14.0, 32.0),
    depth_m=(14.0, 22.0),
    setback_m=(3.0, 5.0),
    gap_m=(1.5, 5.0),
    turn_rad=0.0,
    shapes={"box": (0.6, (9.0, 45.0)), "l": (0.25, (9.0, 24.0)), "hipped": (0.15, (10.0, 18.0))},
)
HILLS = (Octave(500.0, 2.0),)
STEP_M = 4.0


def city(seed: Seed = 0, side_m: Side = 800.0) -> World:
    """A square city around the origin; nothing moves. Raises InputError for less than 50 m."""
    bounds = square(side_m)
    streets = street_net(bounds, NET, np.random.default_rng([seed, 0]))
    sited = line_streets(streets, bounds, PLOT, np.random.default_rng([seed, 1]))
    hills = rolling(bounds, STEP_M, HILLS, seed)
    terrain = graded(hills, hills, streets, level_m=12.0, blend_m=10.0)
    return World("city", bounds, terrain, tuple(one.house for one in sited), streets=streets)
