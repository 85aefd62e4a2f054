"""How nodes reach each other: links, and what goes wrong on them.

hub = MemoryHub()
r1, station = hub.link("r1"), hub.link("station")
station.listen("delta")
r1.send("delta/r1", payload, now_ns)
for frame in station.receive(now_ns): ...
"""

from __future__ import annotations

from terrafuse.exchange.links.base import Frame, Link
from terrafuse.exchange.links.faults import Cut, Faults
from terrafuse.exchange.links.memory import MemoryHub, MemoryLink
from terrafuse.exchange.links.misbehaving import MisbehavingLink

__all__ = ["Cut", "Faults", "Frame", "Link", "MemoryHub", "MemoryLink", "MisbehavingLink"]
