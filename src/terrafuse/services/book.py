"""Corrections of robots' poses, on disk: those that a station passes on, and those that hold for a robot itself."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import msgspec

from terrafuse.errors import CodecError, InputError, OutputError, StoreMismatch, TerrafuseError
from terrafuse.exchange.corrections import (
    Correction,
    Corrections,
    decode_corrections,
    encode_corrections,
    fingerprint,
    merged,
)
from terrafuse.exchange.delta import is_robot_name

MOST_ROBOTS = 4096
AHEAD_S = 60.0
"""By how much the clock of who gives a correction may be ahead."""


class Order(msgspec.Struct, array_like=True, forbid_unknown_fields=True):
    """What an operator tells a station: corrections (`exchange.corrections`) of a robot's poses."""

    number: int
    robot: str
    corrections: bytes


class Done(msgspec.Struct, array_like=True, forbid_unknown_fields=True):
    """What the station answers: why not, if not, and how many of the robot it holds now."""

    number: int
    robot: str
    reason: str
    holds: int


encode_order = msgspec.msgpack.Encoder().encode
_orders, _done = msgspec.msgpack.Decoder(Order), msgspec.msgpack.Decoder(Done)


def decode_order(payload: bytes) -> Order:
    """Raises CodecError for anything else, a name that no node can have among it."""
    try:
        order = _orders.decode(payload)
    except ValueError as error:
        raise CodecError(f"an order that can't be read: {error}") from error
    if not is_robot_name(order.robot) or "/" in order.robot:
        raise CodecError(f"'{order.robot}' is no node's name")
    return order


def decode_done(payload: bytes) -> Done:
    """Raises CodecError for anything else."""
    try:
        return _done.decode(payload)
    except ValueError as error:
        raise CodecError(f"no answer to an order: {error}") from error


_decode = msgspec.msgpack.Decoder(dict[str, bytes]).decode


class Book:
    """By robot. Read when it is made; what is added is on disk before anything else happens.

    Raises StoreMismatch for a file that is damaged.
    """

    def __init__(self, file: Path) -> None:
        self._file = file
        self._held: dict[str, Corrections] = {}
        if file.exists():
            try:
                self._held = {robot: decode_corrections(some) for robot, some in _decode(file.read_bytes()).items()}
            except (OSError, ValueError, CodecError) as error:
                raise StoreMismatch(
                    f"{file}: holds no corrections of poses ({error}); delete it, and give them again"
                ) from error

    @property
    def all(self) -> Mapping[str, Corrections]:
        return self._held

    def of(self, robot: str) -> Corrections:
        return self._held.get(robot, ())

    def add(self, robot: str, corrections: Iterable[Correction]) -> bool:
        """Whether that changed what holds for the robot. Raises InputError for too many."""
        now = merged(self.of(robot), corrections)
        if fingerprint(now) == fingerprint(self.of(robot)):
            return False
        if robot not in self._held and len(self._held) >= MOST_ROBOTS:
            raise InputError(
                f"corrections of {MOST_ROBOTS} robots, and one more: there is no room; delete {self._file}"
            )
        held = {**self._held, robot: now}
        replace_file(
            self._file, msgspec.msgpack.encode({name: encode_corrections(some) for name, some in held.items()})
        )
        self._held = held
        return True


def ordered(
    book: Book | None, sender: str, payload: bytes, may_correct: Callable[[str, str], bool], now_ns: int
) -> tuple[Done, bool]:
    """What a station answers to an order of this sender, and whether it changed what holds. No book: it takes none."""
    order: Order | None = None
    try:
        order = decode_order(payload)
        if book is None or not may_correct(sender, order.robot):
            raise InputError(f"'{sender}' may not correct the poses of '{order.robot}' here")
        corrections = decode_corrections(order.corrections)
        _check_issued(book.of(order.robot), corrections, now_ns)
        fresh = book.add(order.robot, corrections)
        return Done(order.number, order.robot, "", len(book.of(order.robot))), fresh
    except TerrafuseError as error:
        number, robot = (0, "") if order is None else (order.number, order.robot)
        return Done(number, robot, str(error), 0), False


def _check_issued(held: Corrections, corrections: Corrections, now_ns: int) -> None:
    """Of two of one id the one that was issued later counts: by a clock that is ahead, it would do so for long."""
    before = {one.id: one.issued_ns for one in held}
    for one in corrections:
        ahead_s = (one.issued_ns - now_ns) / 1e9
        if ahead_s > AHEAD_S:
            raise InputError(f"correction '{one.id}' is of {ahead_s:.0f} s from now: set the clock of who gave it")
        if one.issued_ns < before.get(one.id, 0):
            raise InputError(
                f"correction '{one.id}' was given before the one of this name that holds: set the clock of who gave "
                "it, or choose another --id"
            )


def replace_file(file: Path, content: bytes) -> None:
    """Either the old content or the new one is there, whenever the power goes. Raises OutputError where there is no
    room for it."""
    partial = file.with_name(f".{file.name}.partial")
    try:
        with partial.open("wb") as opened:
            opened.write(content)
            opened.flush()
            os.fsync(opened.fileno())
        partial.replace(file)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise OutputError(f"{file}: can't be written ({error.strerror}); free some space, and say it again") from error
