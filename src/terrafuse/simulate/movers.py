"""What moves: bodies of upright boxes and cylinders, and routes on which they go by the clock."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from terrafuse.errors import InputError
from terrafuse.types import Array, Floats

BODY = np.dtype([
    ("x", "f8"), ("y", "f8"), ("bottom", "f8"), ("top", "f8"),
    ("half_length", "f8"), ("half_width", "f8"), ("cos", "f8"), ("sin", "f8"), ("round", "u1"),
])  # fmt: skip
"""An upright box, or cylinder where `round` (half_length is its radius), in the world, metres."""
NO_BODIES = np.empty(0, BODY)


@dataclass(frozen=True)
class Part:
    """A box, or a `round` cylinder of diameter `length_m`, in its body's frame: x ahead, z from the ground."""

    length_m: float
    width_m: float
    bottom_m: float
    top_m: float
    x_m: float = 0.0
    y_m: float = 0.0
    round: bool = False


def cylinder(diameter_m: float, bottom_m: float, top_m: float) -> Part:
    return Part(diameter_m, diameter_m, bottom_m, top_m, round=True)


SHAPES: dict[str, tuple[Part, ...]] = {
    "car": (Part(4.4, 1.8, 0.2, 0.9), Part(2.3, 1.6, 0.9, 1.5, x_m=-0.3)),
    "van": (Part(5.2, 2.0, 0.25, 2.3),),
    "person": (cylinder(0.5, 0.0, 1.75),),
    "summit_xl": (Part(0.72, 0.61, 0.0, 0.5),),
    "nomad": (cylinder(0.534, 0.0, 0.8),),
    "soccer": (cylinder(0.4, 0.0, 0.6),),
    "drone": (cylinder(0.8, -0.1, 0.1),),
    "ball": (cylinder(0.22, 0.0, 0.22),),
}
"""What bodies consist of, by name; robots' are those of `motion.BODIES`. A drone's heights count from its middle."""


def body(shape: str | Sequence[Part], x_m: float, y_m: float, z_m: float, yaw_rad: float) -> Array:
    """(K,) BODY of a shape that stands upright at (x, y), its z = 0 at `z_m`, turned from east to north."""
    return all_of([shape], np.array([[x_m, y_m, z_m, yaw_rad]]))


def all_of(shapes: Sequence[str | Sequence[Part]], places: Floats) -> Array:
    """(K,) BODY of several such bodies; of each shape a row (x, y, z, yaw) of `places`."""
    tables = [_parts(shape) for shape in shapes]
    return _place(bodies(tables), places.repeat([len(table) for table in tables], axis=0))


def bodies(parts: Iterable[Array]) -> Array:
    """All of these as one array of BODY."""
    # As bytes: NumPy takes far longer to agree with itself on the fields' types.
    return np.frombuffer(bytearray(b"".join(part.tobytes() for part in parts)), BODY)


def _parts(shape: str | Sequence[Part]) -> Array:
    if not isinstance(shape, str):
        return _table(tuple(shape))
    if shape not in SHAPES:
        raise InputError(f"shape '{shape}': there are {', '.join(SHAPES)}")
    return _table(SHAPES[shape])


@cache
def _table(parts: tuple[Part, ...]) -> Array:
    rows = [(p.x_m, p.y_m, p.bottom_m, p.top_m, p.length_m / 2, p.width_m / 2, 1.0, 0.0, p.round) for p in parts]
    return np.array(rows, BODY)


def _place(parts: Array, places: Floats) -> Array:
    """Parts (K,), each in the frame of its body, moved to the body's place (K, 4); in place."""
    x_m, y_m, z_m, yaw_rad = places.T
    c, s, ahead, aside = np.cos(yaw_rad), np.sin(yaw_rad), parts["x"].copy(), parts["y"].copy()
    parts["x"] = x_m + c * ahead - s * aside
    parts["y"] = y_m + s * ahead + c * aside
    parts["bottom"] += z_m
    parts["top"] += z_m
    parts["cos"], parts["sin"] = c, s
    return parts


@dataclass(frozen=True, eq=False)
class Route:
    """At `times_s` (K,), rising, it is at `places_m` (K, 2), and goes straight between; it looks where it goes, and
    while it stands, where it went. Before the first and after the last time it is not there, unless it `repeats`."""

    times_s: Floats
    places_m: Floats
    repeats: bool = False

    def __post_init__(self) -> None:
        if len(self.times_s) < 2 or self.places_m.shape != (len(self.times_s), 2):
            raise InputError(f"a route of {len(self.times_s)} times and places {self.places_m.shape}: give two or more")
        if not (np.isfinite(self.times_s).all() and np.isfinite(self.places_m).all()):
            raise InputError("a route's times and places must be finite numbers")
        if not (np.diff(self.times_s) > 0).all():
            raise InputError(f"a route's times {self.times_s.tolist()} do not rise")
        # As lists: what is asked for at each tick is one leg of each route.
        lists = {"_headings": _headings(self.places_m), "_times": self.times_s, "_places": self.places_m}
        for name, array in lists.items():
            object.__setattr__(self, name, array.tolist())

    def at(self, time_s: float) -> tuple[float, float, float] | None:
        """(x, y, yaw) at a time; None where it is not there."""
        times, places = self._times, self._places  # type: ignore[attr-defined]
        first, last = times[0], times[-1]
        if self.repeats:
            time_s = first + (time_s - first) % (last - first)
        if not first <= time_s <= last:
            return None
        leg = min(bisect_right(times, time_s) - 1, len(times) - 2)
        share = (time_s - times[leg]) / (times[leg + 1] - times[leg])
        (x0, y0), (x1, y1) = places[leg : leg + 2]
        return x0 + share * (x1 - x0), y0 + share * (y1 - y0), self._headings[leg]  # type: ignore[attr-defined]


def _headings(places_m: Floats) -> Floats:
    """(K - 1,): of each leg; where it stands, of the leg before, or of the first one that moves."""
    steps = np.diff(places_m, axis=0)
    moves = np.hypot(*steps.T) > 1e-9
    leg = np.maximum.accumulate(np.where(moves, np.arange(len(steps)), -1))
    leg[leg < 0] = np.argmax(moves)
    return np.asarray(np.arctan2(steps[leg, 1], steps[leg, 0]))


def drive(
    places_m: Sequence[tuple[float, float]],
    speed_m_s: float,
    start_s: float = 0.0,
    waits_s: Mapping[int, float] | None = None,
    repeats: bool = False,
) -> Route:
    """A route through places at one speed, with a stop of so many seconds at some of them (by their number)."""
    if not (math.isfinite(speed_m_s) and speed_m_s > 0):
        raise InputError(f"speed {speed_m_s} m/s: give a positive number")
    waits, now = waits_s or {}, start_s
    times: list[float] = []
    stops: list[tuple[float, float]] = []
    for number, place in enumerate(places_m):
        if stops:
            now += math.dist(stops[-1], place) / speed_m_s
        times.append(now)
        stops.append(place)
        if waits.get(number, 0.0) > 0:
            now += waits[number]
            times.append(now)
            stops.append(place)
    return Route(np.array(times), np.array(stops, np.float64), repeats)


@dataclass(frozen=True, eq=False)
class Mover:
    """Something of a shape (a key of SHAPES) that goes along a route on the ground."""

    name: str
    shape: str
    route: Route

    def __post_init__(self) -> None:
        _parts(self.shape)
