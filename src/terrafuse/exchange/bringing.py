"""Brings a channel's contributions to peers: what they lack, and again what did not arrive."""

from __future__ import annotations

import re
from collections.abc import Mapping

from terrafuse.exchange.codec import encode
from terrafuse.exchange.holding import Holding
from terrafuse.exchange.outbox import Outbox, Outgoing, outgoing
from terrafuse.exchange.pace import SECOND_NS, CourierSettings
from terrafuse.exchange.parts import oldest
from terrafuse.exchange.peer import DeltaFlight, Peer, PeerChannel, parts_of

NOT_IN_TOPICS = re.compile(r"[/*$#?+\x00-\x1f\x7f]")


class Bringer:
    def __init__(self, node: str, holding: Holding, outbox: Outbox, settings: CourierSettings) -> None:
        self._node, self._holding, self._outbox, self._settings = node, holding, outbox, settings
        self._encoded: dict[tuple[str, int], tuple[Outgoing, int, bool] | None] = {}

    def report(self) -> None:
        """A report is due: what was encoded so far may be old."""
        self._encoded.clear()

    def bring(self, peer: Peer, told: Mapping[str, int], reporting: bool) -> None:
        """Send the peer what it lacks: all of it when a report is due, else the rest of what was begun, and retries."""
        known = peer.channels.get(self._holding.channel.name)
        if known is None or not known.served:
            return
        for robot, revision in told.items():
            held = known.held.get(robot, 0)
            flight = known.flights.get(robot)
            if flight is not None and held >= flight.revision:
                del known.flights[robot]
            if held >= revision:
                known.flights.pop(robot, None)
            elif robot in known.flights:
                self._repeat(peer, known, robot, held)
            elif reporting or (flight is not None and not flight.last):
                self._begin(known, robot, held, self._settings.retry_s * SECOND_NS)

    def _begin(self, known: PeerChannel, robot: str, since: int, patience_ns: float) -> Outgoing | None:
        """Peers that lack the same share a message: it reaches all of them."""
        if (robot, since) not in self._encoded:
            self._encoded[robot, since] = self._encode(robot, since)
        if (encoded := self._encoded[robot, since]) is None:
            return None
        message, revision, last = encoded
        known.flights[robot] = DeltaFlight(message, patience_ns, revision, last)
        return message

    def _encode(self, robot: str, since: int) -> tuple[Outgoing, int, bool] | None:
        """(message, the revision it leads to, whether that is the newest); put on its way. None: a gap is before it."""
        whole = self._holding.delta(robot, since)
        if whole.since > since:
            return None
        delta = oldest(whole, self._settings.message_cells)
        topic = f"delta/{self._holding.channel.name}/{NOT_IN_TOPICS.sub('_', robot)}/{self._node}"
        message = outgoing(topic, encode(delta), self._outbox.max_frame_bytes)
        self._outbox.put(message)
        return message, delta.revision, delta.revision == whole.revision

    def _repeat(self, peer: Peer, known: PeerChannel, robot: str, held: int) -> None:
        """Again what did not arrive: the parts that lack, or, if none came, the newest of it."""
        flight = known.flights[robot]
        if not flight.in_vain(peer):
            return
        if (parts := parts_of(flight.message, peer)) is not None:
            self._outbox.put(flight.message, parts)
            return
        message = self._begin(known, robot, held, self._settings.longer(flight.patience_ns))
        if message is flight.message:
            self._outbox.put(message)
