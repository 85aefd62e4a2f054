"""A node's end of the radio: what it reports, what it hears of the others, and the station's orders."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from time import thread_time
from typing import Any

import numpy as np

from terrafuse.exchange.coarse import CoarseContribution
from terrafuse.exchange.courier import Channel, Courier, CourierSettings
from terrafuse.exchange.delta import Delta
from terrafuse.exchange.links import Faults
from terrafuse.lattice import Lattice
from terrafuse.mapper import Mapper
from terrafuse.models.base import Model
from terrafuse.replica import Replica
from terrafuse.simulate.radio import WIFI, Place, Radio, RadioCut, RadioLink, RadioSettings, Surroundings
from terrafuse.simulate.rays import RayCaster
from terrafuse.simulate.scenario.model import RadioPart
from terrafuse.simulate.world import World

STATION = "station"
GLOBAL = "coarse"
"""The channel: a scenario's robots exchange their maps at the global level only."""
PLACE = "place"
"""A robot's word of where it is: [east, north]."""
ANTENNA_M = 1.0
"""Above a robot's base."""


class Node:
    """A robot's: reports its own map at the coarser level, and keeps a replica of everybody's, where that is shared."""

    def __init__(self, link: RadioLink, mapper: Mapper, factor: int, radio: RadioPart, prior: Delta | None) -> None:
        self.own = CoarseContribution(mapper, factor)
        self.replica = Replica(self.own.map.lattice, mapper.model) if radio.share == "all" else None
        self.orders: dict[str, Any] = {}
        self.seconds = {"coarsen": 0.0}
        self.reports = 0
        if prior is not None and self.replica is not None:
            self.replica.apply(prior)
        channel = Channel(GLOBAL, self.replica.store if self.replica else None, self.own)
        settings = CourierSettings(period_s=radio.report_s)
        self._courier = Courier(link, [channel], peers=[STATION], on_message=self._heard, settings=settings)
        self._report_ns, self._next_ns = round(radio.report_s * 1e9), 0
        self._place_ns = None if radio.place_s is None else round(radio.place_s * 1e9)
        self._next_place_ns = 0

    def say_where(self, now_ns: int, place_m: tuple[float, float]) -> None:
        """Tell the station its place, as often as the scenario has it."""
        if self._place_ns is not None and now_ns >= self._next_place_ns:
            self._courier.post(STATION, PLACE, json.dumps([round(metres, 3) for metres in place_m]).encode())
            self._next_place_ns = now_ns + self._place_ns

    def tick(self, now_ns: int) -> None:
        if now_ns >= self._next_ns:
            started = thread_time()
            self.own.update()
            self.reports += 1
            self.seconds["coarsen"] += thread_time() - started
            self._next_ns = now_ns + self._report_ns
        self._courier.tick(now_ns)

    def facts(self) -> dict[str, Any]:
        return dict(sorted(self._courier.counts.items()))

    def _heard(self, sender: str, kind: str, payload: bytes) -> None:
        if sender == STATION:
            self.orders = self.orders | {kind: json.loads(payload)}


class Station:
    """Gathers what robots report, passes it on, and gives orders."""

    def __init__(self, link: RadioLink, lattice: Lattice, model: Model, radio: RadioPart, prior: Delta | None) -> None:
        self.replica = Replica(lattice, model)
        self.seconds = 0.0
        self.places_m: dict[str, tuple[float, float]] = {}
        """Where robots said that they are, last."""
        if prior is not None:
            self.replica.apply(prior)
        channel = Channel(GLOBAL, self.replica.store, relay=radio.share == "all")
        settings = CourierSettings(period_s=radio.report_s)
        self._courier = Courier(link, [channel], on_message=self._heard, settings=settings)

    def order(self, robot: str, kind: str, value: Any) -> None:
        self._courier.post(robot, kind, json.dumps(value, separators=(",", ":")).encode())

    def tick(self, now_ns: int) -> None:
        started = thread_time()
        self._courier.tick(now_ns)
        self.seconds += thread_time() - started

    def facts(self) -> dict[str, Any]:
        return dict(sorted(self._courier.counts.items()))

    def _heard(self, sender: str, kind: str, payload: bytes) -> None:
        if kind == PLACE:
            east_m, north_m = json.loads(payload)
            self.places_m[sender] = float(east_m), float(north_m)


def radio_of(part: RadioPart, world: World, caster: RayCaster, seed: int) -> Radio:
    """The radio of a mission: walls and ground are in its way, and the communications layer says where it works."""
    faults = Faults(
        loss=part.loss, delay_s=part.latency_s, jitter_s=part.jitter_s, bytes_per_s=part.bytes_per_s,
        overhead_bytes=WIFI.overhead_bytes,
    )  # fmt: skip
    cuts = tuple(RadioCut(cut.from_s, cut.to_s, cut.node, cut.other) for cut in part.cuts)
    settings = RadioSettings(
        range_m=part.range_m, behind_walls=part.behind_walls, frame_bytes=part.frame_bytes, faults=faults, cuts=cuts
    )
    return Radio(settings, Surroundings(_sight(caster), world.communications.at_place), seed)


def _sight(caster: RayCaster) -> Callable[[Place, Place], bool]:
    def sees(one: Place, two: Place) -> bool:
        start, way = np.array(one), np.subtract(two, one)
        length = float(np.linalg.norm(way))
        if length < 1e-6:
            return True
        return bool(caster.cast(start, (way / length)[None, :], length).ranges_m[0] >= length)

    return sees


def counts_of(radio: Radio) -> Mapping[str, Mapping[str, int]]:
    """By node what its radio sent and received, and what became of it."""
    return {node: dict(sorted(counts.items())) for node, counts in sorted(radio.counts.items())}
