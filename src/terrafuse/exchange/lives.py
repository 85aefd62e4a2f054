"""Which life of a node speaks, and whether two nodes have one name.

A life of a node is told by when it began, by the node's own clock. Who begins later takes the place of who began
before, at once; one who began before, by a clock that was set back, once the other is silent. But if both go on
speaking, two nodes have one name: then neither is heard.
"""

from __future__ import annotations

from dataclasses import dataclass

from terrafuse.exchange.pace import SECOND_NS
from terrafuse.exchange.peer import Peer

SILENT_NS = 5 * SECOND_NS
LEAST_TIMES = 3
LEAST_NS = 5 * SECOND_NS
"""Frames of a former life may come late; that one speaks takes so many new words, over so long a time."""
OVER_NS = 15 * SECOND_NS
"""Two nodes are no longer taken for such when one was silent for so long."""


@dataclass
class Rival:
    """The life of a node that is not the present one."""

    born_ns: int
    said_ns: int
    first_ns: int
    heard_ns: int
    times: int = 0

    def speaks(self, said_ns: int, now_ns: int) -> None:
        if said_ns > self.said_ns:
            self.said_ns, self.heard_ns = said_ns, now_ns
            self.times += 1

    def lives(self, now_ns: int) -> bool:
        spoke = self.times >= LEAST_TIMES and self.heard_ns >= self.first_ns + LEAST_NS
        return spoke and now_ns < self.heard_ns + OVER_NS


class Lives:
    def __init__(self) -> None:
        self._spoke_ns: dict[str, int] = {}
        self._rivals: dict[str, Rival] = {}

    def heard(self, peer: Peer, born_ns: int, said_ns: int, now_ns: int) -> bool:
        """Something came of this life of a peer: is it the present one, or from now on? That is then the peer's."""
        if born_ns > peer.born_ns or (born_ns < peer.born_ns and self._takes_over(peer, born_ns, said_ns, now_ns)):
            if peer.born_ns >= 0:
                self._rivals[peer.name] = Rival(peer.born_ns, peer.said_ns, now_ns, now_ns)
            peer.reborn(born_ns)
        if born_ns == peer.born_ns:
            self._spoke_ns[peer.name] = now_ns
        return born_ns == peer.born_ns

    def forget(self, node: str) -> None:
        self._spoke_ns.pop(node, None)
        self._rivals.pop(node, None)

    def other(self, node: str, born_ns: int, said_ns: int, now_ns: int) -> None:
        """Something came of a node of one's own name."""
        rival = self._rivals.get(node)
        if rival is None or rival.born_ns != born_ns:
            rival = self._rivals[node] = Rival(born_ns, -1, now_ns, now_ns)
        rival.speaks(said_ns, now_ns)
        self._spoke_ns[node] = now_ns

    def namesakes(self, now_ns: int) -> frozenset[str]:
        """Names that two nodes have, both of which speak."""
        return frozenset(
            name
            for name, rival in self._rivals.items()
            if rival.lives(now_ns) and now_ns < self._spoke_ns.get(name, 0) + OVER_NS
        )

    def _takes_over(self, peer: Peer, born_ns: int, said_ns: int, now_ns: int) -> bool:
        rival = self._rivals.get(peer.name)
        if rival is None or rival.born_ns != born_ns:
            rival = self._rivals[peer.name] = Rival(born_ns, -1, now_ns, now_ns)
        rival.speaks(said_ns, now_ns)
        return rival.times > 1 and now_ns >= self._spoke_ns.get(peer.name, 0) + SILENT_NS
