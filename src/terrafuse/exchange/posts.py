"""Small messages to a peer, of which only the newest of its kind counts: orders to robots, robots' states.

A message is msgpack, an array of

    born_ns     int, when the life of the sender began in which it was posted
    number      int, counted up by that sender from post to post
    kind        str
    payload     bin

Of one sender and kind, the largest (born_ns, number) is the newest.
"""

from __future__ import annotations

from collections import OrderedDict

import msgspec

from terrafuse.errors import CodecError

MOST_PAYLOAD = 1 << 16
MOST_KINDS = 1 << 14
"""Of all senders together, of which a node remembers what came last."""


class Post(msgspec.Struct, array_like=True, forbid_unknown_fields=True):
    """Fields as in the module's text."""

    born_ns: int
    number: int
    kind: str
    payload: bytes


encode_post = msgspec.msgpack.Encoder().encode
_decode = msgspec.msgpack.Decoder(Post).decode


def decode_post(message: bytes) -> Post:
    """Bytes → post. Raises CodecError for anything else."""
    try:
        return _decode(message)
    except ValueError as error:
        raise CodecError(f"a post that can't be read: {error}") from error


class Inbox:
    """Tells new posts from repeated and overtaken ones."""

    def __init__(self) -> None:
        self._last: OrderedDict[tuple[str, str], tuple[int, int]] = OrderedDict()

    def lives(self, sender: str, post: Post) -> bool:
        """Whether nothing of this kind came of a later life of the sender."""
        return post.born_ns >= self._last.get((sender, post.kind), (-1, -1))[0]

    def forget(self, sender: str) -> None:
        """It was started afresh, perhaps with another clock: what comes of it is new."""
        for key in [key for key in self._last if key[0] == sender]:
            del self._last[key]

    def is_new(self, sender: str, post: Post) -> bool:
        """Whether it is newer than all that came of this sender and kind."""
        key, order = (sender, post.kind), (post.born_ns, post.number)
        if order <= self._last.get(key, (-1, -1)):
            return False
        self._last[key] = order
        self._last.move_to_end(key)
        if len(self._last) > MOST_KINDS:
            self._last.popitem(last=False)
        return True
