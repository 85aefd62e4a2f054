"""An animation of the station's map as it grows, with the robots on their ways.

What robots saw is in full colours, what only the prior says is paler. Robots are drawn where they truly are.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from terrafuse import views
from terrafuse.simulate import truth
from terrafuse.simulate.mission.engine import Mission
from terrafuse.simulate.mission.growing import GrowingMap
from terrafuse.simulate.mission.measures import BAND_M
from terrafuse.simulate.mission.reel import SIDE, Shot, scale_of, write_gif
from terrafuse.types import Array, Floats

MOST_FRAMES = 150
"""Beyond, every second one is dropped, and only every second one is taken from then on."""


@dataclass(frozen=True)
class Frame:
    """What a frame shows, packed."""

    time_s: float
    share: float
    values: bytes
    seen: bytes
    behind: tuple[int, ...]
    """How much of each robot's track lay behind it."""


class Film:
    """A watcher: takes a frame each `frame_s` of its scenario; `write` makes the file of them."""

    def __init__(self, mission: Mission, layer: str | None = None) -> None:
        """`layer` of the global map; the model's picture by default."""
        replica = mission.station.replica
        (self._layer,) = views.chosen_layers(replica, [layer or replica.model.picture_layer])
        self._map = GrowingMap(replica, self._layer, mission.world.bounds, SIDE)
        self._open = _open_ground(mission, self._map)
        self._every_s, self._next_s = mission.scenario.frame_s, 0.0
        self._frames: list[Frame] = []
        self._tracks: list[list[tuple[int, int]]] = [[] for _ in mission.vehicles]
        self._pixels_m = scale_of(self._map.values.shape) / self._map.pixel_m
        self._station = self._pixel(*mission.station_m)

    @property
    def share(self) -> float:
        """Share of the streets, or else of all free ground, that robots had on the station's map at the last frame."""
        return self._frames[-1].share if self._frames else 0.0

    def __call__(self, mission: Mission) -> None:
        for track, vehicle in zip(self._tracks, mission.vehicles, strict=True):
            here = self._pixel(*mission.fleet.position_m(vehicle.number)[:2].tolist())
            if not track or track[-1] != here:
                track.append(here)
        if mission.now_s + 1e-9 >= self._next_s:
            self._next_s += self._every_s
            self._take(mission.now_s)

    def end(self, mission: Mission) -> None:
        """The last frame, of how it all ended."""
        if not self._frames or self._frames[-1].time_s != mission.now_s:
            self._take(mission.now_s)

    def write(self, path: Path | str) -> None:
        """Write a GIF. Raises OutputError where that can't be, MissingExtra without pillow or matplotlib."""
        write_gif(path, [self._shot(frame) for frame in self._frames], self._layer, self._map.pixel_m, self._station)

    def _take(self, time_s: float) -> None:
        self._map.update()
        seen = self._map.seen
        share = float((seen & self._open).sum() / max(self._open.sum(), 1))
        values = zlib.compress(self._map.values.astype("<f4").tobytes(), 1)
        packed = zlib.compress(np.packbits(seen).tobytes(), 1)
        self._frames.append(Frame(time_s, share, values, packed, tuple(map(len, self._tracks))))
        if len(self._frames) > MOST_FRAMES:
            self._frames = self._frames[::2]
            self._every_s *= 2
            self._next_s = self._frames[-1].time_s + self._every_s

    def _shot(self, frame: Frame) -> Shot:
        def image() -> tuple[Floats, Array]:
            shape = self._map.values.shape
            values = np.frombuffer(zlib.decompress(frame.values), "<f4").reshape(shape).astype(np.float64)
            bits = np.frombuffer(zlib.decompress(frame.seen), np.uint8)
            return values, np.unpackbits(bits, count=values.size).reshape(shape).astype(bool)

        trails = [track[:count] for track, count in zip(self._tracks, frame.behind, strict=True)]
        caption = f"{_clock(frame.time_s)}   {frame.share:.0%} mapped   {_robots(len(trails))}"
        return Shot(image, trails, caption)

    def _pixel(self, east_m: float, north_m: float) -> tuple[int, int]:
        """Of the drawn map, from its upper left."""
        west_m, south_m = self._map.corner_m
        height = self._map.values.shape[0] * self._map.pixel_m
        right, down = east_m - west_m, height - (north_m - south_m)
        return math.floor(right * self._pixels_m), math.floor(down * self._pixels_m)


def _open_ground(mission: Mission, image: GrowingMap) -> Array:
    """The image's pixels that should be mapped in the end: streets, or where there are none, all that is free."""
    lattice, window = image.lattice, image.window
    streets = truth.streets(mission.world, lattice, window)
    if streets.any():
        return streets
    ground = np.isfinite(truth.ground(mission.world, lattice, window))
    return np.asarray(ground & ~truth.occupied(mission.world, lattice, window, BAND_M))


def _clock(time_s: float) -> str:
    minutes, seconds = divmod(round(time_s), 60)
    return f"{minutes}:{seconds:02d} min"


def _robots(count: int) -> str:
    return "1 robot" if count == 1 else f"{count} robots"
