"""What a pixel of a ROS map says, and which pixel says it: nav2_map_server's map_io.cpp as formulas.

v is the grey of a pixel, 0 black to 255 white, and occ = (255 − v)/255, or v/255 with `negate`: how occupied it is.

* trinary: occ ≥ occupied_thresh is occupied (100), occ ≤ free_thresh is free (0), all between is unknown (−1).
* scale: the same two, and between them 100·(occ − free_thresh)/(occupied_thresh − free_thresh).
* raw: v itself up to 100, unknown above; whatever thresholds and `negate` say.

In trinary and scale a pixel that is not opaque is unknown.

Thresholds are inclusive, as in today's nav2; ROS 1 and nav2 up to Jazzy exclude them, which matters only where a grey
hits a threshold exactly (no multiple of 1/255 is 0.65, 0.25 or 0.196).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from terrafuse.errors import InputError
from terrafuse.types import Array, Floats

UNKNOWN_GREY = 205
"""What map_saver writes for unknown in trinary mode: occ = 50/255 = 0.19608, above the usual free_thresh 0.196."""
FREE_GREY = 254
TRANSPARENT_GREY = 128
UNKNOWN_PERCENT = -1


@dataclass(frozen=True)
class Meaning:
    """How the greys of a map are to be read. Raises InputError for an unknown mode, or thresholds out of order."""

    mode: str = "trinary"
    occupied_thresh: float = 0.65
    free_thresh: float = 0.196
    negate: bool = False

    def __post_init__(self) -> None:
        if self.mode not in MODES:
            raise InputError(f"mode '{self.mode}': there are {', '.join(MODES)}")
        if not 0 <= self.free_thresh < self.occupied_thresh <= 1:
            raise InputError(
                f"free_thresh {self.free_thresh} and occupied_thresh {self.occupied_thresh}: "
                "give 0 ≤ free_thresh < occupied_thresh ≤ 1"
            )

    @property
    def sure_greys(self) -> tuple[int, int]:
        """(occupied, free) greys of trinary mode: 0 and 254, as map_saver writes them, or 255 where 254 is not free."""
        free = FREE_GREY if self.free_thresh >= 1 / 255 else 255
        return (255, 255 - free) if self.negate else (0, free)

    @property
    def unknown_grey(self) -> int | None:
        """The grey of unknown in trinary mode: 205, as map_saver writes it, or one that lies between the thresholds;
        None where none does: unknown then takes transparency."""
        whole = np.arange(256)
        occ = _occ(whole, self)
        between = whole[(occ > self.free_thresh) & (occ < self.occupied_thresh)]
        if not len(between):
            return None
        return UNKNOWN_GREY if UNKNOWN_GREY in between else int(between[len(between) // 2])


@dataclass(frozen=True)
class Mode:
    """`read` gives the probability of (H, W) greys, NaN unknown, all taken as opaque; `write` the greys of
    probabilities, all known; `unknown` is the grey of unknown, None where that takes transparency."""

    read: Callable[[Array, Meaning], Floats]
    write: Callable[[Floats, Meaning], Floats]
    unknown: Callable[[Meaning], int | None]


def probability(grey: Array, meaning: Meaning, opaque: Array | None = None) -> Floats:
    """How occupied each pixel (H, W) says its place is, 0 to 1, NaN unknown. `opaque` is False where it has alpha."""
    values = MODES[meaning.mode].read(grey, meaning)
    if opaque is not None and meaning.mode != "raw":
        values = np.where(opaque, values, np.nan)
    return values


def percent(values: Floats) -> Array:
    """Probabilities as nav_msgs/OccupancyGrid has them: int8, 0 to 100, −1 unknown; a half is rounded up."""
    known = ~np.isnan(values)
    rounded = np.floor(np.where(known, values, 0.0) * 100 + 0.5)
    return np.where(known, rounded, UNKNOWN_PERCENT).astype(np.int8)


def pixels(values: Floats, meaning: Meaning) -> tuple[Array, Array | None]:
    """(grey uint8, opaque or None) of probabilities (H, W), NaN unknown: what map_server reads as these.

    Trinary and raw go through `percent`, as map_saver does, which never has more than an OccupancyGrid. Scale keeps
    all 256 greys, and writes what the thresholds read as the value; map_saver forgets the thresholds there, and what
    it wrote comes back changed unless they are 0 and 1. `opaque` is None where all pixels are.
    """
    known = ~np.isnan(values)
    grey = MODES[meaning.mode].write(np.where(known, values, 0.0), meaning).astype(np.uint8)
    if known.all():
        return grey, None
    unknown = MODES[meaning.mode].unknown(meaning)
    return np.where(known, grey, TRANSPARENT_GREY if unknown is None else unknown).astype(np.uint8), (
        known if unknown is None else None
    )


def _occ(grey: Array, meaning: Meaning) -> Floats:
    # The quotient of whole numbers is the double nearest to it, so that 51/255 meets a threshold of 0.2 exactly.
    return np.asarray((grey if meaning.negate else 255 - grey.astype(np.float64)) / 255)


def _grey(occ: Floats | float, meaning: Meaning) -> Floats:
    return np.floor(255 * (np.asarray(occ) if meaning.negate else 1 - np.asarray(occ)) + 0.5)


def _read_trinary(grey: Array, meaning: Meaning) -> Floats:
    occ = _occ(grey, meaning)
    return np.where(occ >= meaning.occupied_thresh, 1.0, np.where(occ <= meaning.free_thresh, 0.0, np.nan))


def _write_trinary(values: Floats, meaning: Meaning) -> Floats:
    hundredths = percent(values)
    least, most = _percent_of(meaning.occupied_thresh), _percent_of(meaning.free_thresh)
    # Thresholds of the same whole percent do not tell by it.
    occupied = hundredths >= least if least > most else values >= meaning.occupied_thresh
    free = ~occupied & (hundredths <= most)
    out = np.where(occupied, *map(float, meaning.sure_greys))
    unsure = ~(occupied | free)
    if unsure.any():  # a whole percent lies between the thresholds, and so does one of 255 greys
        out[unsure] = meaning.unknown_grey
    return out


def _percent_of(threshold: float) -> int:
    return math.floor(threshold * 100 + 0.5)


def _read_scale(grey: Array, meaning: Meaning) -> Floats:
    width = meaning.occupied_thresh - meaning.free_thresh
    return np.clip((_occ(grey, meaning) - meaning.free_thresh) / width, 0.0, 1.0)


def _write_scale(values: Floats, meaning: Meaning) -> Floats:
    return _grey(meaning.free_thresh + values * (meaning.occupied_thresh - meaning.free_thresh), meaning)


def _read_raw(grey: Array, _: Meaning) -> Floats:
    whole = np.floor(grey.astype(np.float64) + 0.5)
    return np.where(whole <= 100, whole / 100, np.nan)


def _write_raw(values: Floats, _: Meaning) -> Floats:
    return percent(values).astype(np.float64)


MODES: dict[str, Mode] = {
    "trinary": Mode(_read_trinary, _write_trinary, lambda meaning: meaning.unknown_grey),
    "scale": Mode(_read_scale, _write_scale, lambda _: None),
    "raw": Mode(_read_raw, _write_raw, lambda _: 255),
}
