"""Asks a station for the fleet's services: a node without a map, who is heard and answered like any other."""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from terrafuse.errors import TerrafuseError
from terrafuse.exchange.courier import Courier, CourierSettings
from terrafuse.exchange.links import Link
from terrafuse.services.directory import CONTRACT, DIRECTORY, Entry, unpack
from terrafuse.services.ports import Letter, letter_from
from terrafuse.services.service import Message
from terrafuse.services.supervise import Clock

TICK_S = 0.02
ASK_S = 1.0
PATIENCE_S = 15.0
MOST_BYTES = 1 << 20


def operator_name() -> str:
    """Of a node that nobody knows: several may look at once."""
    return f"operator-{secrets.token_hex(3)}"


class Operator:
    """`station` is the node whose directory is asked, by a courier on `link`."""

    def __init__(self, link: Link, station: str, clock: Callable[[], int] | None = None) -> None:
        self._station, self._clock = station, clock or Clock()
        # No other of this name may have asked the same: what it was answered is said to this one, too.
        self._number = secrets.randbits(62)
        self._heard: dict[str, Entry] = {}
        settings = CourierSettings(period_s=0.5, answer_s=0.1)
        self._courier = Courier(link, peers=[station], on_message=self._take, settings=settings)

    def fleet(self, patience_s: float = PATIENCE_S) -> list[Entry]:
        """What the station knows, by node. Raises TerrafuseError where it does not answer in time."""
        self._ask()
        deadline = time.monotonic() + patience_s
        while not self._whole():
            if time.monotonic() > deadline:
                raise TerrafuseError(
                    f"'{self._station}' does not answer; is it the name of a station that runs, and the address its?"
                )
            self._courier.tick(self._clock())
            time.sleep(TICK_S)
        self._courier.tick(self._clock())  # so that it learns that all arrived
        return [self._heard[name] for name in sorted(self._heard)]

    def watch(self) -> Iterator[list[Entry]]:
        """The same again and again, about once a second."""
        while True:
            yield self.fleet()
            until = time.monotonic() + ASK_S
            while time.monotonic() < until:
                self._courier.tick(self._clock())
                time.sleep(TICK_S)

    def _ask(self) -> None:
        self._number += 1
        self._heard = {}
        ask = Message(CONTRACT.id, "ask", self._number.to_bytes(8, "big"))
        letter = Letter(self._station, DIRECTORY, ask)
        self._courier.post(letter.node, letter.kind, ask.payload)

    def _take(self, sender: str, kind: str, payload: bytes) -> None:
        letter = letter_from(sender, kind, payload)
        if letter is None or letter.message.kind != "fleet" or letter.message.contract != CONTRACT.id:
            return
        try:
            entry: Entry = unpack(payload, Entry, MOST_BYTES)
        except ValueError:
            return
        if entry.number == self._number:
            self._heard[entry.node] = entry

    def _whole(self) -> bool:
        return any(len(self._heard) >= entry.of for entry in self._heard.values())


@contextmanager
def operator(link: Link, station: str) -> Iterator[Operator]:
    try:
        yield Operator(link, station)
    finally:
        link.close()
