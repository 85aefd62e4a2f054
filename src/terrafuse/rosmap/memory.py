"""A ROS map as a note in the store that it was imported into, so that an export is the same files again.

Cells hold what a map says; the note holds how it said it: which of the greys that mean free it used, what its numbers
look like, how far it reached into the unknown.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from terrafuse.rosmap.meaning import Meaning
from terrafuse.rosmap.types import Placement, RosMap
from terrafuse.types import Array

NOTE = "ros_map"


def remember(ros_map: RosMap) -> dict[str, Any]:
    """Plain JSON. Greys become whole ones: an exporter asks again whether one still says what its cell says."""
    opaque = ros_map.opaque
    return {
        "placement": asdict(ros_map.placement),
        "meaning": asdict(ros_map.meaning),
        "shape": list(ros_map.grey.shape),
        "grey": _packed(np.floor(ros_map.grey.astype(np.float64) + 0.5).astype(np.uint8)),
        "opaque": None if opaque is None else _packed(np.packbits(opaque)),
    }


def recall(note: Mapping[str, Any]) -> RosMap:
    shape = tuple(note["shape"])
    grey = _unpacked(note["grey"]).reshape(shape)
    opaque = None
    if note["opaque"] is not None:
        opaque = np.unpackbits(_unpacked(note["opaque"]), count=grey.size).astype(bool).reshape(shape)
    return RosMap(Placement(**note["placement"]), Meaning(**note["meaning"]), grey, opaque)


def _packed(values: Array) -> str:
    return base64.b64encode(zlib.compress(values.tobytes())).decode()


def _unpacked(text: str) -> Array:
    return np.frombuffer(zlib.decompress(base64.b64decode(text)), np.uint8)
