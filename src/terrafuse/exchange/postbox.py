"""A node's posts: what it has for its peers, and what came for it."""

from __future__ import annotations

from collections.abc import Callable

from terrafuse.errors import InputError
from terrafuse.exchange.outbox import POST, Outbox
from terrafuse.exchange.pace import SECOND_NS, CourierSettings
from terrafuse.exchange.peer import Flight, Peer, Posted, parts_of
from terrafuse.exchange.posts import MOST_PAYLOAD, Inbox, Post, decode_post, encode_post

MOST_UNSAID = 256
"""Posts acknowledged in one summary."""

OnMessage = Callable[[str, str, bytes], None]
"""`on_message(sender, kind, payload)`."""


class Postbox:
    def __init__(self, node: str, outbox: Outbox, settings: CourierSettings, on_message: OnMessage | None) -> None:
        self._node, self._outbox, self._settings, self._on_message = node, outbox, settings, on_message
        self._inbox = Inbox()
        self._finished: dict[bytes, None] = {}
        """Posts that arrived since the last summary."""
        self._posted = 0

    def put(self, peer: Peer, kind: str, payload: bytes) -> None:
        """In place of anything older of this kind. Raises InputError for over 64 KiB."""
        if len(payload) > MOST_PAYLOAD:
            raise InputError(f"a post '{kind}' of {len(payload)} bytes to '{peer.name}': the most is {MOST_PAYLOAD}")
        self._posted += 1
        peer.posts[kind] = Posted(self._posted, payload)

    def bring(self, peer: Peer, born_ns: int) -> None:
        """Send what the peer lacks, again what was in vain."""
        for kind, post in peer.posts.items():
            if post.arrived:
                continue
            if post.flight is None:
                content = encode_post(Post(born_ns, post.number, kind, post.payload))
                message = self._outbox.message(f"post/{peer.name}/{self._node}", content)
                post.flight = Flight(message, self._settings.retry_s * SECOND_NS)
                self._outbox.put(message, POST)
            elif post.flight.in_vain(peer):
                self._outbox.put(post.flight.message, POST, parts_of(post.flight.message, peer))
                post.flight.patience_ns = self._settings.longer(post.flight.patience_ns)

    def acknowledge(self, id_: bytes) -> None:
        """Tell the sender, with the next summary, that this post arrived."""
        if len(self._finished) < MOST_UNSAID:
            self._finished[id_] = None

    def forget(self, sender: str) -> None:
        """Whatever this sender posts from now on is new: its clock may be another one."""
        self._inbox.forget(sender)

    def deliver(self, sender: str, message: bytes) -> None:
        """Raises CodecError for bytes that are no post."""
        post = decode_post(message)
        if self._inbox.is_new(sender, post) and self._on_message is not None:
            self._on_message(sender, post.kind, post.payload)

    @property
    def unsaid(self) -> bool:
        """Whether something arrived that its sender was not told of."""
        return bool(self._finished)

    def finished(self) -> list[bytes]:
        """What arrived since this was last asked."""
        ids = list(self._finished)
        self._finished.clear()
        return ids
