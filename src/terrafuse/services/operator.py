"""Asks a station for the fleet's services: a node without a map, who is heard and answered like any other."""

from __future__ import annotations

import secrets
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress

from terrafuse.errors import CodecError, InputError, TerrafuseError
from terrafuse.exchange.asking import BUSY, Answer, Question
from terrafuse.exchange.corrections import Corrections, encode_corrections
from terrafuse.exchange.courier import Courier, CourierSettings
from terrafuse.exchange.links import Link
from terrafuse.services.book import Done, Order, decode_done, encode_order
from terrafuse.services.directory import CONTRACT, DIRECTORY, Entry, unpack
from terrafuse.services.ports import Letter, letter_from
from terrafuse.services.service import Message
from terrafuse.services.supervise import Clock

TICK_S = 0.02
ASK_S = 1.0
PATIENCE_S = 15.0
MOST_BYTES = 1 << 20
AT_A_TIME = 8
"""Questions."""


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
        self._answers: dict[int, Answer] = {}
        self._done: Done | None = None
        self._courier = Courier(
            link, peers=[station], on_message=self._take, on_answer=self._hear, settings=settings
        )  # fmt: skip

    def fleet(self, patience_s: float = PATIENCE_S) -> list[Entry]:
        """What the station knows, by node. Raises TerrafuseError where it does not answer in time."""
        self._ask()
        deadline = time.monotonic() + patience_s
        while not self._whole():
            if time.monotonic() > deadline:
                raise self._silent()
            self._courier.tick(self._clock())
            time.sleep(TICK_S)
        self._courier.tick(self._clock())  # so that it learns that all arrived
        return [self._heard[name] for name in sorted(self._heard)]

    def watch(self) -> Iterator[list[Entry]]:
        """The same again and again, about once a second."""
        while True:
            yield self.fleet()
            self._pause(ASK_S)

    def ask(self, questions: Sequence[Question], patience_s: float = PATIENCE_S) -> Iterator[bytes]:
        """What the station answers to each, in their order; some at a time, again what it is too busy for.

        Raises InputError with the station's reason for what it refuses, TerrafuseError where nothing comes for so long.
        """
        waiting, asked, found = deque(enumerate(questions)), dict[int, tuple[int, Question]](), dict[int, bytes]()
        deadline, told, coming = time.monotonic() + patience_s, 0, 0
        while told < len(questions):
            while waiting and len(asked) < AT_A_TIME:
                at, question = waiting.popleft()
                asked[self._courier.ask(self._station, question)] = (at, question)
            self._courier.tick(self._clock())
            for number in [number for number in self._answers if number in asked]:
                at, question = asked.pop(number)
                answer = self._answers.pop(number)
                deadline = time.monotonic() + patience_s
                if answer.reason.startswith(BUSY):
                    waiting.append((at, question))
                    self._pause(ASK_S)
                elif answer.reason:
                    raise InputError(f"'{self._station}' says: {answer.reason}")
                else:
                    found[at] = answer.content
            while told in found:
                yield found.pop(told)
                told += 1
            if (parts := self._courier.receiving(self._station)) != coming:
                coming, deadline = parts, time.monotonic() + patience_s
            if time.monotonic() > deadline:
                raise self._silent()
            self._pause(TICK_S)

    def correct(self, robot: str, corrections: Corrections, patience_s: float = PATIENCE_S) -> int:
        """Have the station pass these on to a robot; returns how many corrections of it the station holds now.

        Once it has answered they are on its disk. Raises InputError with its reason where it refuses.
        """
        self._number += 1
        payload = encode_order(Order(self._number, robot, encode_corrections(corrections)))
        letter = Letter(self._station, "map-manager", Message("terrafuse/map-manager/1", "correct", payload))
        self._courier.post(letter.node, letter.kind, payload)
        deadline = time.monotonic() + patience_s
        while self._done is None or self._done.number != self._number:
            if time.monotonic() > deadline:
                raise self._silent()
            self._pause(TICK_S)
        self._courier.tick(self._clock())
        if self._done.reason:
            raise InputError(f"'{self._station}' says: {self._done.reason}")
        return self._done.holds

    def _pause(self, seconds: float) -> None:
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            self._courier.tick(self._clock())
            time.sleep(TICK_S)

    def _silent(self) -> TerrafuseError:
        return TerrafuseError(
            f"'{self._station}' does not answer; is it the name of a station that runs, and the address its?"
        )

    def _hear(self, sender: str, number: int, answer: Answer) -> None:
        self._answers[number] = answer

    def _ask(self) -> None:
        self._number += 1
        self._heard = {}
        ask = Message(CONTRACT.id, "ask", self._number.to_bytes(8, "big"))
        letter = Letter(self._station, DIRECTORY, ask)
        self._courier.post(letter.node, letter.kind, ask.payload)

    def _take(self, sender: str, kind: str, payload: bytes) -> None:
        letter = letter_from(sender, kind, payload)
        if letter is not None and letter.message.kind == "corrected":
            with suppress(CodecError):
                self._done = decode_done(payload)
            return
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
