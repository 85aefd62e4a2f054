"""Links between nodes of one process: nothing gets lost, and all arrives at once and in order."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

from terrafuse.errors import InputError
from terrafuse.exchange.links.base import Frame, check_frame, check_heard, check_topic, closed, covers

MAX_FRAME = 1 << 20


class MemoryHub:
    """What the links of one process have in common."""

    def __init__(self, max_frame_bytes: int = MAX_FRAME) -> None:
        self.max_frame_bytes = max_frame_bytes
        self._links: dict[str, MemoryLink] = {}

    def link(self, node: str) -> MemoryLink:
        """A new node's link. Raises InputError while another node has this name."""
        check_topic(node)
        if node in self._links:
            raise InputError(f"there is a node '{node}' on this hub; names must differ")
        self._links[node] = MemoryLink(self, node)
        return self._links[node]

    def listeners(self, topic: str, sender: str) -> Iterable[MemoryLink]:
        """The links that a frame of this topic is for, in the order in which they joined."""
        return [link for name, link in list(self._links.items()) if name != sender and link.hears(topic)]

    def leave(self, node: str) -> None:
        self._links.pop(node, None)


class MemoryLink:
    """A link of a MemoryHub; made by its `link`."""

    def __init__(self, hub: MemoryHub, node: str) -> None:
        self.node = node
        self.max_frame_bytes = hub.max_frame_bytes
        self._hub: MemoryHub | None = hub
        self._topics: set[str] = set()
        self._arrived: deque[Frame] = deque()

    @property
    def open(self) -> bool:
        return self._hub is not None

    def listen(self, topic: str) -> None:
        check_heard(topic)
        self._topics.add(topic)

    def hears(self, topic: str) -> bool:
        return any(covers(own, topic) for own in self._topics)

    def send(self, topic: str, payload: bytes, now_ns: int) -> None:
        check_frame(self, topic, payload)
        if self._hub is None:
            raise closed(self, topic)
        for link in self._hub.listeners(topic, self.node):
            link.deliver(Frame(topic, payload))

    def deliver(self, frame: Frame) -> None:
        """What the hub, or a carrier built upon it, brings. A closed link takes nothing."""
        if self.open:
            self._arrived.append(frame)

    def receive(self, now_ns: int) -> list[Frame]:
        # One by one: another thread may deliver meanwhile.
        return [self._arrived.popleft() for _ in range(len(self._arrived))]

    def close(self) -> None:
        if self._hub is not None:
            self._hub.leave(self.node)
        self._hub = None
        self._arrived.clear()
