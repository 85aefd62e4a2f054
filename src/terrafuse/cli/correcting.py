"""What `terrafuse correct` is told, checked before anything is sent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite, radians
from typing import TYPE_CHECKING

from terrafuse.cli import arguments
from terrafuse.errors import InputError

if TYPE_CHECKING:
    from terrafuse.services.directory import Entry
    from terrafuse.types import Pose

FULL_TURN_DEG = 360.0


@dataclass(frozen=True)
class Known:
    """What the station knows of the robot."""

    station: str
    robot: str
    reached: bool
    """It is there now."""
    mapped: bool
    """The station holds something of it, or heard of it."""
    crs: str | None
    """Of the station's map."""
    place_m: tuple[float, float] | None
    """East, north, where the robot last was."""
    below: tuple[str, ...] = ()
    """Other stations that report to this one, where the robot itself does not."""

    @property
    def tells(self) -> str:
        return f"tells '{self.robot}'" if self.reached else f"will tell '{self.robot}', which is not there now"

    @property
    def warning(self) -> str:
        """Empty where there is nothing to warn of."""
        if self.below and not self.reached:
            return (
                f"'{self.robot}' does not report to '{self.station}' itself; if it does to {' or '.join(self.below)}, "
                "say it there: --connect, --station"
            )
        if self.reached or self.mapped:
            return ""
        return f"'{self.station}' has never heard of '{self.robot}'; is the name right?"


@dataclass(frozen=True)
class How:
    """A shift (east, north, up), after a turn about a place, or about none that was said."""

    shift_m: tuple[float, float, float]
    turn_deg: float
    about_m: tuple[float, float] | None

    @property
    def turned(self) -> str:
        """In words, if it is."""
        east_m, north_m = self.about_m or (0.0, 0.0)
        return f" ({self.turn_deg:g}° about {east_m:.10g},{north_m:.10g})" if self.turn_deg else ""

    def motion(self, known: Known) -> Pose:
        """Raises InputError for a turn about no place in a CRS: its origin may be far, and would move the robot by
        kilometres."""
        from terrafuse.exchange.corrections import flat

        if self.turn_deg and self.about_m is None and known.crs is not None:
            last = "" if known.place_m is None else f"; '{known.robot}' was last at {_pair(known.place_m)}"
            raise InputError(f"--turn-deg in a map of {known.crs}: say about which place, --about E,N{last}")
        east_m, north_m, up_m = self.shift_m
        return flat(east_m, north_m, radians(self.turn_deg), up_m, self.about_m or (0.0, 0.0))


def checked(
    robot: str, shift_m: tuple[float, float, float], turn_deg: float, about: str | None, id_: str | None
) -> How:
    """Raises InputError that names the option."""
    from terrafuse.exchange.corrections import MOST_SHIFT_M
    from terrafuse.services.settings import checked_name

    checked_name(robot)
    _check_id(id_)
    if not all(map(isfinite, (*shift_m, turn_deg))):
        raise InputError("--shift-east, --shift-north, --shift-up, --turn-deg: give finite numbers")
    for option, metres in zip(("--shift-east", "--shift-north", "--shift-up"), shift_m, strict=True):
        if abs(metres) > MOST_SHIFT_M:
            raise InputError(f"{option} {metres:g}: give metres, {MOST_SHIFT_M:g} at most")
    if abs(turn_deg) > FULL_TURN_DEG:
        raise InputError(f"--turn-deg {turn_deg:g}: give degrees, {FULL_TURN_DEG:g} at most")
    if not any(shift_m) and not turn_deg and id_ is None:
        raise InputError("this corrects nothing: give a --shift-… or --turn-deg, or the --id of one to take back")
    return How(shift_m, turn_deg, _place(about, MOST_SHIFT_M))


def look_up(fleet: Sequence[Entry], station: str, robot: str) -> Known:
    """Of what the station's directory tells."""
    states = {(entry.node, status.name): status.state for entry in fleet for status in entry.services}
    manager, mapping = states.get((station, "map-manager"), {}), states.get((robot, "mapping"), {})
    held = {name for channel in manager.get("channels", {}).values() for name in channel}
    place = mapping.get("place_m")
    nodes = {entry.node for entry in fleet}
    below = sorted(node for node, service in states if service == "map-manager" and node != station)
    return Known(
        station,
        robot,
        robot in manager.get("peers", []),
        robot in held | nodes,
        manager.get("map", {}).get("crs"),
        (place[0], place[1]) if isinstance(place, list) and len(place) >= 2 else None,
        () if robot in nodes else tuple(f"'{node}'" for node in below),
    )


def _check_id(id_: str | None) -> None:
    from terrafuse.exchange.corrections import MOST_ID

    if id_ is not None and not (0 < len(id_) <= MOST_ID and id_.isprintable()):
        raise InputError(f"--id {id_!r}: give 1 to {MOST_ID} printable characters")


def _place(about: str | None, most_m: float) -> tuple[float, float] | None:
    place = arguments.numbers("--about", about, "EAST,NORTH")
    if place is None:
        return None
    if max(map(abs, place)) > most_m:
        raise InputError(f"--about {about}: give metres, {most_m:g} at most")
    return place[0], place[1]


def _pair(place_m: tuple[float, float]) -> str:
    return f"{place_m[0]:.10g},{place_m[1]:.10g}"
