"""Small scenarios for tests: a village of 120 m, two robots, a few seconds."""

from __future__ import annotations

from pathlib import Path

from terrafuse.simulate.scenario import Loaded
from terrafuse.simulate.scenario.read import read_scenario

SMALL = """
title: Small village
duration_s: 6
frame_s: 1
world: {kind: village, side_m: 120}
map:
  model: terrain
  resolution_m: 0.5
  tile_m: 10
  window: centred?cells=40
  global_factor: 10
  prior_building_height_m: 10
radio: {range_m: 500, report_s: 1}
robots:
  - count: 2
    pose: {kind: filtered}
    behaviour: {kind: patrol}
    sensors:
      - kind: lidar
        rate_hz: 5
        dropout: 0.01
        description:
          name: small
          max_range_m: 15
          min_range_m: 0.5
          noise_sigma_m: 0.02
          ring: {count: 180, step_deg: 2, elevations_deg: [-25, -10, -4, 0, 4, 10, 20, 30]}
          mounting: {z_m: 1.2, x_m: 0.1, yaw_deg: 10, pitch_deg: 2}
"""


def small(text: str = SMALL) -> Loaded:
    return read_scenario(text, "small.yaml", "small", Path())
