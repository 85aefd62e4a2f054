"""A node's posts: what it has for its peers, and what came for it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import msgspec

from terrafuse.errors import InputError
from terrafuse.exchange.asking import (
    ASK,
    SLOTS,
    Answer,
    Answerer,
    Question,
    answered,
    decode_answer,
    decode_question,
    encode_message,
)
from terrafuse.exchange.corrections import CORRECTION, Correction, decode_corrections
from terrafuse.exchange.outbox import POST, REPLY, Outbox
from terrafuse.exchange.pace import SECOND_NS, CourierSettings
from terrafuse.exchange.peer import ANSWER, Flight, Peer, Posted, parts_of
from terrafuse.exchange.posts import MOST_PAYLOAD, Inbox, Post, decode_post, encode_post

MOST_ANSWERS_BYTES = 64 << 20
"""Of answers that have not arrived yet, to all who asked: beyond, the oldest go."""
MOST_UNSAID = 256
"""Posts acknowledged in one summary."""

OnMessage = Callable[[str, str, bytes], None]
"""`on_message(sender, kind, payload)`."""
OnCorrection = Callable[[str, Sequence[Correction]], None]
OnAnswer = Callable[[str, int, Answer], None]


class Postbox:
    def __init__(self, node: str, outbox: Outbox, settings: CourierSettings) -> None:
        self.on_message: OnMessage | None = None
        self.on_correction: OnCorrection | None = None
        self.on_answer: OnAnswer | None = None
        self.answerer: Answerer | None = None
        self._node, self._outbox, self._settings = node, outbox, settings
        self._inbox = Inbox()
        self._finished: dict[bytes, None] = {}
        """Posts that arrived since the last summary."""
        self._answers: dict[tuple[str, str], tuple[Peer, int]] = {}
        """That may not have arrived yet, by peer and kind: how long they are. The oldest first."""
        self._answers_bytes = 0
        self._posted = self._asked = 0

    def put(self, peer: Peer, kind: str, payload: bytes) -> None:
        """In place of anything older of this kind. Raises InputError for over 64 KiB."""
        if len(payload) > MOST_PAYLOAD:
            raise InputError(f"a post '{kind}' of {len(payload)} bytes to '{peer.name}': the most is {MOST_PAYLOAD}")
        self._put(peer, kind, payload)

    def ask(self, peer: Peer, question: Question) -> int:
        """The number of the question."""
        self._asked += 1
        self._put(
            peer, f"{ASK}{self._asked % SLOTS}", encode_message(msgspec.structs.replace(question, number=self._asked))
        )
        return self._asked

    def _put(self, peer: Peer, kind: str, payload: bytes) -> None:
        self._posted += 1
        peer.posts[kind] = Posted(self._posted, payload)

    def bring(self, peer: Peer, born_ns: int) -> None:
        """Send what the peer lacks, again what was in vain."""
        for kind, post in list(peer.posts.items()):
            if post.arrived:
                if kind.startswith(ANSWER):
                    self._drop_answer(peer, kind)
                continue
            if post.flight is None:
                content = encode_post(Post(born_ns, post.number, kind, post.payload))
                message = self._outbox.message(f"post/{peer.name}/{self._node}", content)
                post.flight = Flight(message, self._settings.retry_s * SECOND_NS)
                self._outbox.put(message, lane_of(kind))
            elif post.flight.in_vain(peer):
                self._outbox.put(post.flight.message, lane_of(kind), parts_of(post.flight.message, peer))
                post.flight.patience_ns = self._settings.longer(post.flight.patience_ns)

    def acknowledge(self, id_: bytes) -> None:
        """Tell the sender, with the next summary, that this post arrived."""
        if len(self._finished) < MOST_UNSAID:
            self._finished[id_] = None

    def forget(self, sender: str) -> None:
        """Whatever this sender posts from now on is new: its clock may be another one."""
        self._inbox.forget(sender)

    def deliver(self, peer: Peer | None, sender: str, message: bytes) -> bool:
        """False for one of a life that another one took the place of.

        Raises CodecError for bytes that are no post, or not what its kind says.
        """
        post = decode_post(message)
        if self._inbox.is_new(sender, post):
            self._hand_over(peer, sender, post)
        return self._inbox.lives(sender, post)

    def _hand_over(self, peer: Peer | None, sender: str, post: Post) -> None:
        if post.kind.startswith(ASK):
            self._answer(peer, post)
        elif post.kind.startswith(ANSWER):
            answer = decode_answer(post.payload)
            if self.on_answer is not None:
                self.on_answer(sender, answer.number, answer)
        elif post.kind == CORRECTION and self.on_correction is not None:
            self.on_correction(sender, decode_corrections(post.payload))
        elif self.on_message is not None:
            self.on_message(sender, post.kind, post.payload)

    def _answer(self, peer: Peer | None, post: Post) -> None:
        question, slot = decode_question(post.payload), post.kind.removeprefix(ASK)
        if peer is not None and slot.isdecimal() and int(slot) < SLOTS:
            answer = answered(self.answerer, peer.name, question)
            self._keep_answer(peer, f"{ANSWER}{slot}", encode_message(answer))

    def _keep_answer(self, peer: Peer, kind: str, payload: bytes) -> None:
        """Until it arrived, or too much waits for those who asked."""
        self._drop_answer(peer, kind)
        self._put(peer, kind, payload)
        self._answers[peer.name, kind] = (peer, len(payload))
        self._answers_bytes += len(payload)
        while self._answers_bytes > MOST_ANSWERS_BYTES:
            (_, oldest), (whose, _) = next(iter(self._answers.items()))
            self._drop_answer(whose, oldest)

    def _drop_answer(self, peer: Peer, kind: str) -> None:
        if (held := self._answers.pop((peer.name, kind), None)) is not None:
            self._answers_bytes -= held[1]
            peer.posts.pop(kind, None)

    @property
    def unsaid(self) -> bool:
        """Whether something arrived that its sender was not told of."""
        return bool(self._finished)

    def finished(self) -> list[bytes]:
        """What arrived since this was last asked."""
        ids = list(self._finished)
        self._finished.clear()
        return ids


def lane_of(kind: str) -> str:
    """Answers are long, and wait for the map."""
    return REPLY if kind.startswith(ANSWER) else POST
