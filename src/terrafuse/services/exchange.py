"""The service that brings a node's contributions to others and theirs to it: outbox, replica and network in one thread.

At a robot it is called `exchange`, at a station `map-manager` (*patrol*: Map Manager).
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from terrafuse.errors import InputError, TerrafuseError
from terrafuse.exchange.corrections import CORRECTION, Correction, encode_corrections
from terrafuse.exchange.courier import Channel, Courier, CourierSettings
from terrafuse.exchange.delta import map_id
from terrafuse.exchange.links import Link
from terrafuse.lattice import Lattice
from terrafuse.models.base import Model
from terrafuse.services.answers import Answers
from terrafuse.services.book import Book, encode_order, ordered
from terrafuse.services.mapping import MAPPING
from terrafuse.services.places import PLACE, PLACE_S, STILL_S, TRACK, TRACK_S, Place, Track, encode
from terrafuse.services.places import Told as Way
from terrafuse.services.ports import Handover, Letter, Letterbox, letter_from
from terrafuse.services.service import SECOND_NS, Contract, Message, Service
from terrafuse.store.base import Store
from terrafuse.types import Bounds

TICK_S, LONGEST_TICK_S, LEAST_WAIT_S, FOLD_S = 0.02, 0.06, 0.001, 1.0
BUSY = 3.0
"""Times what a tick took, the next one waits, but only until `LONGEST_TICK_S` after this one began: what comes until
then is made to last all at once. After one that took longer than that, enough waits."""
REFUSED_S = 5.0
"""How long a robot that refused another waits for that to have heard it, before it ends itself."""
EXCHANGE, MAP_MANAGER = "exchange", "map-manager"


@dataclass(frozen=True)
class About:
    """Which map a node works on; stations and robots tell each other when they meet."""

    lattice: Lattice
    model: Model
    global_factor: int = 1
    """Of the coarse map's cells; 1: there is none."""

    def as_json(self) -> dict[str, Any]:
        return {
            "map": asdict(map_id(self.model.name, self.lattice)),
            "settings": self.model.settings(),
            "global_factor": self.global_factor,
        }


def nowhere(place: Place | None) -> Bounds | None:
    return None


def unfolded(areas: Collection[Bounds]) -> object:
    return None


def all_of_them(areas: Sequence[Bounds]) -> Collection[Bounds]:
    return areas


@dataclass(frozen=True)
class Told:
    """What a robot's node tells of its own map."""

    archive: Store
    """Of the fine map; the mapping writes to it."""
    handover: Handover
    coarse: Store | None = None
    """Of this service alone: what came by the handover."""
    track: Track = field(default_factory=Track)
    area: Callable[[Place | None], Bounds | None] = nowhere
    """Of interest to it, where it is there."""
    among_robots: bool = False
    """Whether those it reports to are robots, which report to it."""


def nobody(sender: str, robot: str) -> bool:
    return False


def unheard(sender: str, kind: str, payload: bytes, now_ns: int) -> bool:
    return False


class Exchange(Service):
    """Owns the node's link and courier.

    `stations`: whom it asks to take its map, and waits for: it is done when all of it is there, and nothing more comes.
    `deliver(service, message)` hands a message of another node to a service of this one; but first it is for
    `hear(sender, kind, payload, now_ns)`, which says whether it was, and raises ValueError for what is none.
    Of robots' areas of interest it grants those that `grant` does, and folds those `within` what it may at once.
    `answers` what peers ask for. `book`: the file of corrections of poses (`services.book`): of a robot's own, or of
    those that a station passes on, of whoever `may_correct(sender, robot)`. `joins`: its peers are stations to it,
    though it is none's robot: it passes on to them what it holds. `area`: of interest to it.
    """

    def __init__(
        self,
        name: str,
        about: About,
        link: Callable[[], Link],
        channels: Callable[[], Sequence[Channel]],
        settings: CourierSettings,
        letters: Letterbox,
        deliver: Callable[[str, Message], object],
        *,
        peers: Sequence[str] | None = None,
        told: Told | None = None,
        hear: Callable[[str, str, bytes, int], bool] = unheard,
        fold: Callable[[Collection[Bounds]], object] = unfolded,
        answers: Answers | None = None,
        book: Path | None = None,
        may_correct: Callable[[str, str], bool] = nobody,
        grant: Callable[[str, Bounds], bool] | None = None,
        within: Callable[[Sequence[Bounds]], Collection[Bounds]] = all_of_them,
        joins: bool = False,
        area: Bounds | None = None,
    ) -> None:
        super().__init__()
        self.contract = contract_of(name)
        self.stations = tuple(peers or ()) if told or joins else ()
        service = EXCHANGE if told is not None and told.among_robots else MAP_MANAGER
        self.partners = ("mapping", *(f"{station}/{service}" for station in self.stations)) if told else ()
        self._about, self._letters, self._deliver, self._told, self._hear = about, letters, deliver, told, hear
        self._place: Place | None = None
        self._way: Way | None = None
        self._place_ns = self._way_ns = self._fold_ns = 0
        self._fold, self._within = fold, within
        self._book = None if book is None else Book(book)
        self._may_correct, self._may_have = may_correct, grant
        self._channels = channels()
        self._link = link()
        try:
            self._courier = Courier(
                self._link, self._channels, peers=peers, on_message=self._bring, on_correction=self._correct,
                answerer=answers, grant=self._granted, settings=settings,
            )  # fmt: skip
            self.counts = self._courier.counts
            self._courier.area = area
            if answers is not None:
                answers.counts = self.counts
            for robot in () if told is not None or self._book is None else self._book.all:
                self._post_corrections(robot)
            for station in self.stations:
                join = Message(contract_of(service).id, "join", json.dumps(about.as_json()).encode())
                self._write(Letter(station, service, join))
        except BaseException:
            self._link.close()
            raise
        self._said: dict[tuple[str, str], str] = {}
        """By station and kind of message."""
        self._refused: dict[str, tuple[int, str]] = {}
        """Robots among robots that it told why it can't take their maps, and since when."""
        self._now_ns = 0
        self._level_heard: set[str] = set()
        """Robots that have nothing more to come, all of which is here, and hold all of this one's."""
        self._level_told = False
        self._quiet_ns: int | None = None
        """Since when all was on disk and nothing lacked."""

    def tick(self, now_ns: int) -> float:
        self._now_ns, started_s = now_ns, time.perf_counter()
        self._take_coarse()
        for letter in self._letters.take():
            self._write(letter)
        self._tell_place(now_ns)
        if now_ns - self._fold_ns >= FOLD_S * SECOND_NS and (areas := self._courier.areas):
            self._fold_ns = now_ns
            self._fold(self._within(areas))
        self._courier.tick(now_ns)
        for robot, (since_ns, words) in self._refused.items():
            if now_ns - since_ns > REFUSED_S * SECOND_NS or not self._courier.waiting(robot):
                raise InputError(f"this robot does not take the map of '{robot}': {words}")
        if self._told is not None and self.stations:
            self._look_whether_done(self._told, now_ns)
        took_s = time.perf_counter() - started_s
        return max(min(max(TICK_S, BUSY * took_s), LONGEST_TICK_S - took_s), LEAST_WAIT_S)

    def post(self, message: Message) -> None:
        if message.kind == "join":
            self._meet(message)
        elif message.kind == "correct":
            self._take_corrections(message)
        elif message.kind == "level":
            self._level_heard.add(message.sender)
        elif message.sender in self.stations:
            words = self._said[message.sender, message.kind] = message.payload.decode(errors="replace")
            if message.kind == "refuse":
                self.counts["refused_by_station"] += 1
            if message.kind == "refuse" and self._told is not None:
                raise InputError(f"'{message.sender}' does not take this robot's map: {words}")

    def state(self) -> dict[str, Any]:
        out: dict[str, Any] = {
            "node": self._link.node,
            **self._about.as_json(),
            "peers": self._courier.reached(self._now_ns),
            "channels": {channel.name: _held(channel) for channel in self._channels},
            "cells_m": {one.name: one.store.map.resolution_m for one in self._channels if one.store is not None},
        }
        out |= {name: value for name in ("trouble", "counts") if (value := getattr(self._link, name, None))}
        if self.stations:
            out["stations"] = list(self.stations)
            out["level"] = self._quiet_ns is not None
            out["behind"] = {station: self._courier.behind(station) for station in self.stations}
        if self._book is not None and self._book.all:
            out["corrections"] = {robot: len(some) for robot, some in self._book.all.items()}
        if any(self._said.values()):
            said = {station: "; ".join(self._words_of(station)) for station in self.stations}
            out["said"] = {station: words for station, words in said.items() if words}
        return out

    def _words_of(self, station: str) -> list[str]:
        return [words for (who, _), words in self._said.items() if words and who == station]

    def close(self) -> None:
        self._link.close()

    def _tell_place(self, now_ns: int) -> None:
        """Where the robot is, and now and then by what way it came there."""
        place = None if self._told is None else self._told.track.latest
        if self._told is not None:
            self._courier.area = self._told.area(place)
        if self._told is None or place is None:
            return
        patience_s = PLACE_S if place != self._place else STILL_S
        if now_ns - self._place_ns >= patience_s * SECOND_NS:
            self._place_ns, self._place = now_ns, place
            self._tell(PLACE, encode(place))
        if now_ns - self._way_ns >= TRACK_S * SECOND_NS:
            self._way_ns, way = now_ns, self._told.track.told()
            if way != self._way:
                self._way = way
                self._tell(TRACK, encode(way))

    def _correct(self, sender: str, corrections: Sequence[Correction]) -> None:
        """Kept beside the robot's map, by which that is made anew; of stations only."""
        if self._told is None or self._book is None or self._told.among_robots or sender not in self.stations:
            self.counts["refused.correction"] += 1
            return
        robot = self._link.node
        try:
            fresh = self._book.add(robot, corrections)
        except TerrafuseError:
            self.counts["refused.correction"] += 1
            return
        if fresh:
            self.counts["corrections_taken"] += 1
            self._told.handover.corrected += 1
            self._told.handover.committed.clear()
            self._deliver("mapping", Message(MAPPING.id, "correct"))

    def _take_corrections(self, message: Message) -> None:
        """Of a robot's poses, to be passed on to it; whoever gave them is told what came of it."""
        book = self._book if self._told is None else None
        done, fresh = ordered(book, message.sender, message.payload, self._may_correct, self._now_ns)
        if done.reason:
            self.counts["refused.correction"] += 1
        elif fresh:
            self.counts["corrections_taken"] += 1
            self._post_corrections(done.robot)
        reply = Message(contract_of(MAP_MANAGER).id, "corrected", encode_order(done))
        self._write(Letter(message.sender, "operator", reply))

    def _post_corrections(self, robot: str) -> None:
        assert self._book is not None
        self._courier.post(robot, CORRECTION, encode_corrections(self._book.of(robot)))

    def _tell(self, kind: str, payload: bytes) -> None:
        for station in self.stations:
            self._courier.post(station, kind, payload)

    def _granted(self, peer: str, area: Bounds) -> bool:
        """A peer that does not get the map of its area is told why."""
        if self._may_have is None or self._may_have(peer, area):
            return True
        words = (
            f"the area of interest {tuple(area)} has more tiles than a robot may ask for here: ask for a smaller one"
        )
        self._write(Letter(peer, EXCHANGE, Message(contract_of(EXCHANGE).id, "area", words.encode())))
        return False

    def _bring(self, sender: str, kind: str, payload: bytes) -> None:
        try:
            if self._hear(sender, kind, payload, self._now_ns):
                return
        except ValueError:
            self.counts["refused.pose"] += 1
            return
        letter = letter_from(sender, kind, payload)
        if letter is None or not self._deliver(letter.service, letter.message):
            self.counts["refused.letter"] += 1

    def _write(self, letter: Letter) -> None:
        try:
            self._courier.post(letter.node, letter.kind, letter.message.payload)
        except InputError:  # no peer, or too long
            self.counts["refused.outgoing"] += 1

    def _take_coarse(self) -> None:
        """What changed on the coarser lattice, once the scans that it comes of are on disk."""
        if self._told is None or self._told.coarse is None:
            return
        waiting, archive = self._told.handover.coarse, self._told.archive
        while waiting and waiting[0].revision <= archive.revision(waiting[0].robot):
            self._told.coarse.accept(waiting.popleft())

    def _look_whether_done(self, told: Told, now_ns: int) -> None:
        """Two reports without anything lacking: by then whatever the mapping left was told."""
        lacks = any(self._courier.behind(station) for station in self.stations)
        reached = {*self._courier.reached(now_ns), *self._level_heard} >= set(self.stations)
        if lacks or not reached or self._is_expecting() or not told.handover.committed.is_set() or told.handover.coarse:
            self._quiet_ns = None
        elif self._quiet_ns is None:
            self._quiet_ns = now_ns
        else:
            patience_ns = 2 * self._courier.settings.period_s * SECOND_NS
            if now_ns - self._quiet_ns >= patience_ns:
                self.done = self.done or not told.among_robots or self._is_level_with_robots(now_ns)

    def _is_expecting(self) -> bool:
        """Whether a station may have something for this robot yet: corrections come before its welcome."""
        if self._told is None or self._told.among_robots:
            return False
        welcome = {station for station, kind in self._said if kind == "welcome"}
        return welcome < set(self.stations) or any(map(self._courier.receiving, self.stations))

    def _is_level_with_robots(self, now_ns: int) -> bool:
        """Each tells the others that it has nothing more to come, and leaves when all did and its own word arrived, or
        who should hear it has left."""
        if not self._level_told:
            self._level_told = True
            for robot in self.stations:
                self._write(Letter(robot, EXCHANGE, Message(contract_of(EXCHANGE).id, "level")))
        reached = self._courier.reached(now_ns)
        waits = any(self._courier.waiting(robot) for robot in self.stations if robot in reached)
        return self._level_heard >= set(self.stations) and not waits

    def _meet(self, message: Message) -> None:
        """A robot says which map it works on: is it this one?"""
        try:
            theirs = json.loads(message.payload)
            map_, settings = theirs["map"], theirs["settings"]
            factor = theirs.get("global_factor", self._about.global_factor)  # older ones do not say
            if not (isinstance(settings, dict) and isinstance(factor, int)):
                raise TypeError("settings or a factor of another kind")
        except (ValueError, KeyError, TypeError, RecursionError):
            self.counts["refused.join"] += 1
            return
        ours = self._about.as_json()
        kind, words = "welcome", ""
        if map_ != ours["map"]:
            kind, words = (
                "refuse",
                f"it works on {_words(map_)}, and '{self._link.node}' on {_words(ours['map'])}; make them equal",
            )
            self.counts["refused.join"] += 1
        elif factor != ours["global_factor"]:
            kind, words = (
                "refuse",
                f"it has --global-factor {factor}, and '{self._link.node}' {ours['global_factor']}; make them equal",
            )
            self.counts["refused.join"] += 1
        elif settings != ours["settings"]:
            other = sorted(key for key in ours["settings"] if settings.get(key) != ours["settings"][key])
            words = f"the model's settings differ from the station's: {', '.join(other)}"
        # The corrections come first: a robot leaves when it is welcome, and nothing of a message is on its way to it.
        if self._told is None and self._book is not None and message.sender in self._book.all:
            self._post_corrections(message.sender)  # it may have been away for so long that it was forgotten
        reply = Message(contract_of(EXCHANGE).id, kind, words.encode(errors="replace"))
        self._write(Letter(message.sender, EXCHANGE, reply))
        if kind == "refuse" and self._told is not None and message.sender in self.stations:
            self._refused.setdefault(message.sender, (self._now_ns, words))


def contract_of(name: str) -> Contract:
    return Contract(
        f"terrafuse/{name}", 1, remote=frozenset({"join", "welcome", "refuse", "area", "correct", "corrected", "level"})
    )


def _held(channel: Channel) -> dict[str, Any]:
    """By robot, the revision that is held of it."""
    if channel.store is not None:
        return {robot: channel.store.revision(robot) for robot in channel.store.robots()}
    return {} if channel.own is None else {channel.own.robot: channel.own.revision}


def _words(map_: Any) -> str:
    if not isinstance(map_, dict):
        return "no map"
    frame = map_.get("crs") or "a local frame"
    return f"{map_.get('model')}, cells of {map_.get('resolution_m')} m, tiles of {map_.get('tile_m')} m, {frame}"
