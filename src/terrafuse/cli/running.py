"""Runs nodes for a command: what it tells on stderr meanwhile, and on stdout of what came of it."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from terrafuse.cli.asking import status_json
from terrafuse.cli.output import LINES_EVERY_S, bytes_text, count_text, note, say, say_json, tell_of_compiling

if TYPE_CHECKING:
    from terrafuse.services.node import Node
    from terrafuse.services.settings import FleetSettings

INTERRUPTED = 130


def run_nodes(settings: FleetSettings, names: Sequence[str], json: bool) -> int:
    """Run these nodes, tell of them on stderr, and of what came of it on stdout; returns the exit code."""
    from terrafuse.services.carriers import carrier, upstream
    from terrafuse.services.node import make_node
    from terrafuse.services.run import Hung, run, stopped_by_signals

    tell_of_compiling()
    carry = carrier(settings, note)
    above = upstream(settings, note)
    nodes = [make_node(settings, name, carry, above) for name in names]
    for name in names:
        note(f"{name}: {_begins(settings, name)}")
    # Only now: before, nothing has to be put down, and what is being imported or read could not be told to stop.
    with stopped_by_signals() as stop:
        try:
            done = run(nodes, stop, _Progress())
        except Hung:
            _tell(nodes, False, json)
            sys.stdout.flush()
            os._exit(_code(nodes, False))  # what is not committed is as good as never done
    _tell(nodes, done, json)
    return _code(nodes, done)


def _code(nodes: Sequence[Node], done: bool) -> int:
    """Stations are stopped to end; robots that are, have not ended."""
    return 0 if done or all(node.ends_with is None for node in nodes) else INTERRUPTED


def _begins(settings: FleetSettings, name: str) -> str:
    about = settings.map
    if settings.station is not None and name == settings.station.name:
        where = f"listens on {', '.join(settings.link.listen)}" if settings.link.listen else "in this process"
        return f"map of {about.model}, {about.resolution_m:g} m cells, in {settings.station.store}; {where}"
    part = settings.robots[name]
    return f"maps {part.source} into {part.store}, reports to {', '.join(part.peers or settings.reported_to)}"


class _Progress:
    """A line for each node every few seconds, and at once for what went wrong."""

    def __init__(self) -> None:
        self._last = time.monotonic()
        self._told: dict[tuple[str, str], int] = {}

    def __call__(self, nodes: Sequence[Node]) -> None:
        for node in nodes:
            self._tell_of_restarts(node)
        if time.monotonic() - self._last >= LINES_EVERY_S:
            self._last = time.monotonic()
            for node in nodes:
                note(f"{node.name}: {progress(node)}")

    def _tell_of_restarts(self, node: Node) -> None:
        for status in node.statuses.values():
            if status.restarts > self._told.get((node.name, status.name), 0):
                self._told[node.name, status.name] = status.restarts
                note(f"{node.name}: the service '{status.name}' was started again ({status.reason})")


def progress(node: Node) -> str:
    states = {name: status.state for name, status in node.statuses.items()}
    if node.ends_with is None:
        fine = states["map-manager"].get("channels", {}).get("fine", {})
        reached = states["map-manager"].get("peers", [])
        maps, nodes = "robot's map" if len(fine) == 1 else "robots' maps", "node" if len(reached) == 1 else "nodes"
        return f"{len(fine)} {maps} held, {len(reached)} {nodes} in reach"
    source, mapping, exchange = states["source"], states["mapping"], states["exchange"]
    of = "" if source.get("records") is None else f" of {source['records']}"
    again = mapping.get("rebuilding")
    anew = "" if again is None else f", {again} of them to be mapped anew by corrected poses"
    stations = [_standing(exchange, station) for station in exchange.get("stations", [])]
    said = [f"{station} says: {words}" for station, words in exchange.get("said", {}).items()]
    what = [f"{mapping.get('scans', 0)}{of} scans mapped{anew}", *stations, mapping.get("trouble"), *said]
    return "; ".join(filter(None, what))


def _standing(exchange: dict[str, Any], station: str) -> str:
    """How level whom a robot reports to is with it."""
    lacks = sum(n for robots in exchange.get("behind", {}).get(station, {}).values() for n in robots.values())
    left = f"lacks {lacks} {'piece' if lacks == 1 else 'pieces'} of it" if lacks else "has what was told"
    return f"{station} {left}, and is {'in reach' if station in exchange.get('peers', []) else 'not in reach'}"


def _tell(nodes: Sequence[Node], done: bool, json: bool) -> None:
    facts = {node.name: _facts(node) for node in nodes}
    if json:
        say_json({"done": done, "nodes": facts})
        return
    for node in nodes:
        say(f"{node.name}: {_words(node, facts[node.name])}")


def _facts(node: Node) -> dict[str, Any]:
    return {"done": node.done, "services": {name: status_json(status) for name, status in node.statuses.items()}}


def _words(node: Node, facts: dict[str, Any]) -> str:
    of = facts["services"]
    if node.ends_with is None:
        held = of["map-manager"]["state"].get("channels", {}).get("fine", {})
        return f"stopped; holds {', '.join(f'{name} up to scan {n}' for name, n in held.items()) or 'nothing yet'}"
    source, counts = of["source"]["state"], of["exchange"]["counts"]
    sent = bytes_text(sum(n for key, n in counts.items() if key.startswith("bytes_sent.")))
    skipped = "".join(f", {n} not placed ({why})" for why, n in source.get("skipped", {}).items())
    what = f"{source.get('scans', 0)} scans{skipped}, {count_text(source.get('points', 0))}points, {sent} sent"
    if node.done:
        partners = [partner.split("/") for partner in of["exchange"]["partners"] if "/" in partner]
        robots = ", ".join(node for node, service in partners if service == "exchange")
        return f"{what}; all is at {robots or 'the station'}"
    return f"{what}; stopped, what is not sent is kept, and the same command goes on"
