"""What a courier knows of its own node's channel: up to which revision it holds each robot without a gap."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from terrafuse.errors import DeltaError
from terrafuse.exchange.channel import Channel
from terrafuse.exchange.codec import decode, heading
from terrafuse.exchange.delta import Delta
from terrafuse.exchange.own import Own
from terrafuse.exchange.parts import delta_since


class Holding:
    """A channel, and what of it is held. `counts` gets what became of deltas."""

    def __init__(self, channel: Channel, counts: Counter[str]) -> None:
        self.channel = channel
        self.store = channel.store
        self.own = None if channel.own is None else Own(channel.own)
        self.held = {} if self.store is None else {robot: self.store.revision(robot) for robot in self.store.robots()}
        self.unsaid: dict[str, None] = {}
        """Robots of which more is held since the last summary."""
        self._lately: dict[str, int] = {}
        """What was held at the last report,"""
        self._settled: dict[str, int] = {}
        """and at the one before: by now, peers said whether they have it from elsewhere."""
        self._counts = counts

    def report(self) -> None:
        """A report is due: take what this node itself made since, and let what came meanwhile settle."""
        self._take_own()
        self._settled, self._lately = self._lately, dict(self.held)

    @property
    def settled(self) -> Mapping[str, int]:
        """By robot, up to which revision this node tells of it by now."""
        return self._told(self._settled)

    @property
    def told(self) -> Mapping[str, int]:
        """By robot, up to which revision this node will tell of it."""
        return self._told(self.held)

    def delta(self, robot: str, since: int) -> Delta:
        if self.store is not None:
            return delta_since(self.store, robot, since)
        assert self.own is not None
        return self._projected(since)

    def apply(self, sender: str, message: bytes, now_ns: int) -> bool:
        """Take a delta into the store, unless it is known, refused, or leaves a gap: what is held never has one.

        False for one that may be taken if it comes again. Raises CodecError for bytes that are none.
        """
        if self.store is None:
            return True
        robot, since, revision = heading(message)
        held = self.held.get(robot, 0)
        if revision <= held:
            self._counts["deltas_known"] += 1
        elif since > held:
            self._counts["refused.gap"] += 1
            return False
        else:
            self._accept(sender, decode(message, self.store.model.cell), now_ns)
        return True

    def surpass(self, revision: int) -> bool:
        """A peer holds this revision of the node's own robot. If that is of an earlier life of the node, True: until it
        came back, the store has a gap before what this life adds."""
        if self.own is None or not self.own.surpass(revision):
            return False
        self.held[self.own.robot] = 0
        return True

    def _accept(self, sender: str, delta: Delta, now_ns: int) -> None:
        assert self.store is not None
        guard = self.channel.guard
        if guard is not None and (reason := guard(sender, delta, now_ns)):
            self._counts[f"refused.{reason}"] += 1
            return
        try:
            self.store.accept(delta)
        except DeltaError:
            self._counts["refused.delta"] += 1
        else:
            self._counts["deltas_applied"] += 1
            self.held[delta.robot] = delta.revision
            self.unsaid[delta.robot] = None

    def _take_own(self) -> None:
        if self.own is None or self.store is None:
            return
        robot, held = self.own.robot, self.held.get(self.own.robot, 0)
        if self.own.revision > held:
            delta = self._projected(held)
            if delta.since <= held:
                self.store.accept(delta)
                self.held[robot] = delta.revision

    def _projected(self, since: int) -> Delta:
        assert self.own is not None
        return self.channel.project(self.own.delta(since))

    def _told(self, held: Mapping[str, int]) -> Mapping[str, int]:
        relayed = held if self.channel.relay else {}
        if self.own is None:
            return relayed
        robot = self.own.robot
        return {**relayed, robot: self.own.revision if self.store is None else self.held.get(robot, 0)}
