"""What every behaviour is: from what a robot knows to what it does next."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from terrafuse.simulate.mission.fleet import Drive
from terrafuse.simulate.mission.situation import Situation
from terrafuse.simulate.scenario.model import Part


class Behaviour(Protocol):
    """One robot's; it may remember."""

    def drive(self, me: Situation) -> Drive:
        """What to do until the next tick."""

    def facts(self) -> dict[str, Any]:
        """What it did, for the report."""


Makes = Callable[[Any, np.random.Generator], Behaviour]
"""Of its settings, and a stream of random numbers of this robot's own."""
Kind = tuple[type[Part], Makes]
