"""Where a robot is and was, as it tells its stations: small posts, which go before all else.

A *pose* is msgpack, an array of [stamp_ns, east_m, north_m, up_m]; a *track* [spacing_m, [east_m, north_m, east_m,
...]], in whole metres, the earliest first: the way so far, each place about so far from the one before.
"""

from __future__ import annotations

import threading
from math import hypot, isfinite

import msgspec

from terrafuse.types import Scan

PLACE, TRACK = "pose", "track"
"""Kinds of posts."""
PLACE_S, STILL_S, TRACK_S = 0.5, 5.0, 10.0
"""How often they are posted: while the robot moves, while it stands, and as its way grows."""
SPACING_M = 20.0
MOST_PLACES = 256
"""Of a track; of a longer way every other one goes."""
FARTHEST_M = 1e8


class Place(msgspec.Struct, array_like=True, forbid_unknown_fields=True, frozen=True):
    """Fields as in the module's text."""

    stamp_ns: int
    east_m: float
    north_m: float
    up_m: float


class Told(msgspec.Struct, array_like=True, forbid_unknown_fields=True, frozen=True):
    """A track; fields as in the module's text."""

    spacing_m: float
    places_m: list[int]


encode = msgspec.msgpack.Encoder().encode
_places = msgspec.msgpack.Decoder(Place)
_tracks = msgspec.msgpack.Decoder(Told)


def decode_place(payload: bytes) -> Place:
    """Raises ValueError for anything else."""
    place = _places.decode(payload)
    if not all(isfinite(metres) and abs(metres) < FARTHEST_M for metres in (place.east_m, place.north_m, place.up_m)):
        raise ValueError(f"a place {place}")
    return place


def decode_track(payload: bytes) -> Told:
    """Raises ValueError for anything else."""
    track = _tracks.decode(payload)
    far = any(abs(metres) > FARTHEST_M for metres in track.places_m)
    if far or len(track.places_m) % 2 or len(track.places_m) > 2 * MOST_PLACES or not track.spacing_m > 0:
        raise ValueError(f"a track of {len(track.places_m)} numbers")
    return track


class Track:
    """A robot's way, as far as it is known. One thread adds, another reads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._spacing_m = SPACING_M
        self._places_m: list[tuple[float, float]] = []
        self.latest: Place | None = None

    def add(self, scan: Scan) -> None:
        """A scan in the map's frame was taken there."""
        east, north, up = (float(metres) for metres in scan.T_world_sensor.position)
        if not all(abs(metres) < FARTHEST_M for metres in (east, north, up)):
            return  # nobody would take it
        self.latest = Place(scan.stamp_ns, round(east, 2), round(north, 2), round(up, 2))
        with self._lock:
            if not self._places_m or _apart_m(self._places_m[-1], (east, north)) >= self._spacing_m:
                self._places_m.append((east, north))
            if len(self._places_m) > MOST_PLACES:
                self._places_m = self._places_m[::2]
                self._spacing_m *= 2

    def clear(self) -> None:
        """It is told anew, from the beginning."""
        with self._lock:
            self._spacing_m, self._places_m = SPACING_M, []

    def told(self) -> Told:
        with self._lock:
            return Told(self._spacing_m, [round(metres) for place in self._places_m for metres in place])


def _apart_m(one: tuple[float, float], other: tuple[float, float]) -> float:
    return hypot(one[0] - other[0], one[1] - other[1])
