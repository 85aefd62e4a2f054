"""How two maps differ: stores, rasters, ROS maps, in any pair."""

from __future__ import annotations

from terrafuse.compare.run import Question, compare_maps

__all__ = ["Question", "compare_maps"]
