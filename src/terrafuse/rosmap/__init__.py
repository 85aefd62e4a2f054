"""Maps of ROS map_server: an image and a YAML beside it. What its numbers mean, and the files."""

from __future__ import annotations

from terrafuse.rosmap.files import read_map, write_map
from terrafuse.rosmap.meaning import MODES, Meaning, percent, pixels, probability
from terrafuse.rosmap.types import Placement, RosMap

__all__ = [
    "MODES",
    "Meaning",
    "Placement",
    "RosMap",
    "percent",
    "pixels",
    "probability",
    "read_map",
    "write_map",
]
