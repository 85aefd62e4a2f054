"""Questions to a node, and its answers: a tile at full resolution, a layer's picture.

number = courier.ask("station", Question("tile", "fine", x=3, y=-1))
...on_answer("station", number, answer) once it came

Both travel as posts. A question, of the kind `ask/SLOT`, is msgpack, an array of

    number      int, of the asker's
    what        "tile", "picture" or "extent"
    channel     str
    x, y        int, of the tile
    layer       str: of a picture; "" for the model's own
    area        nil or [west, south, east, north], metres: of a picture; nil: the tile's. May be left out

and its answer, of the kind `answer/SLOT` with the same slot, an array of

    number      int
    reason      str: why there is none; "" with one
    content     bin: of a tile, a delta (`exchange.codec`) of the global cells, which says the answering node is its
                robot; of a picture, PNG; of the extent, msgpack, [west, south, east, north] of all tiles in metres, or
                nil where there is none

A reason that begins with "busy" is none for good: who asks again a second later may be answered.

A node has as many questions under way to a peer as there are slots, 0 to 15; a further one takes the place of the
oldest.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import msgspec
import numpy as np

from terrafuse.errors import CodecError, TerrafuseError
from terrafuse.exchange.codec import encode
from terrafuse.exchange.delta import Delta, TileCells, map_id
from terrafuse.replica import Replica
from terrafuse.tile import opaque
from terrafuse.types import TileKey

ASK = "ask/"
SLOTS = 16
MOST_ANSWER = 4 << 20
"""Bytes."""
BUSY = "busy"
"""What the reason of a node begins with that was asked too much for now."""


class Question(msgspec.Struct, array_like=True, forbid_unknown_fields=True, frozen=True):
    """Fields as in the module's text."""

    number: int = 0
    what: str = "tile"
    channel: str = "fine"
    x: int = 0
    y: int = 0
    layer: str = ""
    area: tuple[float, float, float, float] | None = None


class Answer(msgspec.Struct, array_like=True, forbid_unknown_fields=True, frozen=True):
    """Fields as in the module's text."""

    number: int
    reason: str
    content: bytes


Answerer = Callable[[str, Question], bytes]
"""`answer(peer, question)`: the content; raises TerrafuseError where there is none."""

encode_message = msgspec.msgpack.Encoder().encode
_questions = msgspec.msgpack.Decoder(Question)
_answers = msgspec.msgpack.Decoder(Answer)


def decode_question(message: bytes) -> Question:
    """Raises CodecError for anything else."""
    try:
        return _questions.decode(message)
    except ValueError as error:
        raise CodecError(f"a question that can't be read: {error}") from error


def decode_answer(message: bytes) -> Answer:
    """Raises CodecError for anything else."""
    try:
        return _answers.decode(message)
    except ValueError as error:
        raise CodecError(f"an answer that can't be read: {error}") from error


def answered(answerer: Answerer | None, peer: str, question: Question) -> Answer:
    """The answer, or why there is none; never an error of the asker's making."""
    if answerer is None:
        return Answer(question.number, "this node answers no questions", b"")
    try:
        content = answerer(peer, question)
    except TerrafuseError as error:
        return Answer(question.number, str(error), b"")
    if len(content) > MOST_ANSWER:
        return Answer(question.number, f"{len(content)} bytes; an answer has {MOST_ANSWER} at most", b"")
    return Answer(question.number, "", content)


class Tiles:
    """Answers with tiles of these channels' maps."""

    def __init__(self, node: str, replicas: Mapping[str, Replica]) -> None:
        self._node, self._replicas = node, replicas

    def __call__(self, peer: str, question: Question) -> bytes:
        replica = self._replicas.get(question.channel)
        if replica is None or question.what != "tile":
            raise CodecError(f"there is no {question.what} of '{question.channel}' here")
        return encode(_tile(self._node, replica, TileKey(question.x, question.y)))


def _tile(node: str, replica: Replica, key: TileKey) -> Delta:
    cells = replica.cells(key).reshape(-1)
    at = np.flatnonzero(replica.model.known(cells)).astype(np.int32)
    tiles = (TileCells(key, at, opaque(cells)[at].view(cells.dtype)),) if len(at) else ()
    map_ = map_id(replica.model.name, replica.lattice)
    return Delta(map_, node, 0, 1, replica.reading.now_ns, tiles)
