"""Corrections of robots' poses, on disk: those that a station passes on, and those that hold for a robot itself."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path

import msgspec

from terrafuse.errors import CodecError, InputError, OutputError, StoreMismatch
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
