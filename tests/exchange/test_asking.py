"""Questions, answers and corrections, from node to node."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from terrafuse.errors import CodecError, InputError
from terrafuse.exchange.asking import (
    MOST_ANSWER,
    SLOTS,
    Answer,
    Question,
    Tiles,
    answered,
    decode_answer,
    decode_question,
    encode_message,
)
from terrafuse.exchange.codec import decode
from terrafuse.exchange.corrections import (
    ALWAYS_NS,
    CORRECTION,
    MOST,
    Correction,
    decode_corrections,
    encode_corrections,
    flat,
)
from terrafuse.exchange.courier import Courier, CourierSettings
from terrafuse.exchange.links import Faults, MemoryHub, MisbehavingLink
from terrafuse.lattice import Lattice
from terrafuse.mapper import Mapper
from terrafuse.models import make_model
from terrafuse.replica import Replica
from terrafuse.testing.deltas import random_scans
from terrafuse.types import Pose

LATTICE, MODEL = Lattice(0.5, 4.0), make_model("elevation")
QUICK = CourierSettings(period_s=0.5, answer_s=0.1, retry_s=0.5)


def replica() -> Replica:
    whole = Replica(LATTICE, MODEL)
    for k, robot in enumerate(("r1", "r2")):
        mapper = Mapper(robot, LATTICE, MODEL)
        for scan in random_scans(k, 3, 7.0, 40):
            mapper.integrate(scan)
        whole.apply(mapper.delta())
    return whole


class Pair:
    """A station that answers, and a robot that asks."""

    def __init__(self, faults: Faults | None = None, **station: object) -> None:
        hub = MemoryHub(300)
        self.answers: list[tuple[str, int, Answer]] = []
        self.corrections: list[tuple[str, Sequence[Correction]]] = []
        self.now_ns = 0
        links = [MisbehavingLink(hub.link(name), faults or Faults(), k) for k, name in enumerate(("r1", "station"))]
        self.robot = Courier(
            links[0], settings=QUICK, on_answer=lambda *one: self.answers.append(one),
            on_correction=lambda *one: self.corrections.append(one),
        )  # fmt: skip
        self.station = Courier(links[1], settings=QUICK, **station)  # type: ignore[arg-type]

    def run(self, seconds: float) -> None:
        for _ in range(round(10 * seconds)):
            self.robot.tick(self.now_ns)
            self.station.tick(self.now_ns)
            self.now_ns += 100_000_000


@pytest.mark.parametrize("faults", [Faults(), Faults(loss=0.3, duplication=0.3, jitter_s=0.3)])
def test_a_tile_comes_whole_and_once(faults: Faults) -> None:
    whole = replica()
    pair = Pair(faults, answerer=Tiles("station", {"fine": whole}))
    pair.run(2)
    key = whole.keys[0]
    number = pair.robot.ask("station", Question(what="tile", channel="fine", x=key.x, y=key.y))
    pair.run(60)
    ((sender, answered_to, answer),) = pair.answers
    assert (sender, answered_to, answer.reason) == ("station", number, "")
    delta = decode(answer.content, MODEL.cell)
    assert delta.robot == "station"
    told = Replica(LATTICE, MODEL)
    told.apply(delta)
    assert told.cells(key).tobytes() == whole.cells(key).tobytes()


def test_a_tile_that_nobody_saw_is_empty() -> None:
    delta = decode(Tiles("station", {"fine": replica()})("r1", Question(x=1000)), MODEL.cell)
    assert delta.tiles == ()


def test_why_there_is_no_answer() -> None:
    answer = answered(Tiles("station", {}), "r1", Question(3, "picture", "fine"))
    assert answer == Answer(3, "there is no picture of 'fine' here", b"")
    assert answered(None, "r1", Question(3)).reason == "this node answers no questions"
    long = answered(lambda peer, question: bytes(MOST_ANSWER + 1), "r1", Question(3))
    assert (long.reason, long.content) == (f"{MOST_ANSWER + 1} bytes; an answer has {MOST_ANSWER} at most", b"")


def test_as_many_questions_as_there_are_slots() -> None:
    """The station can't be heard while 20 are asked; the last 16 get there."""
    pair = Pair(answerer=lambda peer, question: bytes([question.x]))
    numbers = [pair.robot.ask("station", Question(x=k)) for k in range(SLOTS + 4)]
    pair.run(10)
    came = sorted((number, answer.content) for _, number, answer in pair.answers)
    assert came == [(numbers[k], bytes([k])) for k in range(4, SLOTS + 4)]


@given(st.binary(max_size=60))
def test_other_bytes_are_refused(message: bytes) -> None:
    for read in (decode_question, decode_answer, decode_corrections):
        with suppress(CodecError):
            read(message)


def test_questions_and_answers_as_bytes() -> None:
    question = Question(3, "picture", "coarse", -1, 2, "height")
    assert decode_question(encode_message(question)) == question
    assert decode_answer(encode_message(Answer(3, "", b"x"))) == Answer(3, "", b"x")


# --- corrections -----------------------------------------------------------------------------------------------------


def test_corrections_come_in_their_order() -> None:
    pair = Pair()
    first = Correction("a", 7, 5, 8, flat(1.0, 2.0, 0.0))
    second = Correction("b", 6, 5, ALWAYS_NS, flat(0.0, 0.0, np.pi / 2))
    pair.station.post("r1", CORRECTION, encode_corrections([first]))
    pair.station.post("r1", CORRECTION, encode_corrections([first, second]))
    pair.run(3)
    ((sender, corrections),) = pair.corrections
    assert sender == "station"
    assert [(one.id, one.from_ns, one.until_ns) for one in corrections] == [("b", 5, ALWAYS_NS), ("a", 5, 8)]
    # A quarter turn takes what was east to the north.
    assert np.allclose((corrections[0].T_new_old @ Pose.identity().shifted(1.0, 0.0)).position, [0.0, 1.0, 0.0])
    assert (corrections[1].T_new_old @ Pose.identity()).position.tolist() == [1.0, 2.0, 0.0]


def test_what_are_no_corrections_is_refused() -> None:
    rows = [1.0, 0, 0, 0, 0, 1.0, 0, 0, 0, 0, 1.0, 0]
    for message, why in [
        ([["a", 1, 0, 5, [2.0, *rows[1:]]]], "not a rigid motion"),
        ([["a", 1, 0, 5, rows[1:]]], "11 numbers"),
        ([["a", 1, 5, 5, rows]], "is no time"),
        ([["a", 1, -1, 5, rows]], "is no time"),
        ([["", 1, 0, 5, rows]], "an id has 1 to 64"),
        ([["a", 2, 0, 5, rows], ["b", 1, 0, 5, rows]], "not in their order"),
        ([["a", 1, 0, 5, rows], ["a", 2, 0, 5, rows]], "not in their order"),
        ([[f"{k:03d}", 1, 0, 5, rows] for k in range(MOST + 1)], f"give {MOST} at most"),
    ]:
        with pytest.raises(CodecError, match=why):
            decode_corrections(encode_message(message))  # type: ignore[arg-type]
    one = Correction("a", 1, 0, 5, flat(0.0, 0.0, 0.0))
    with pytest.raises(InputError, match="each of another id"):
        encode_corrections([one, one])
