"""What robots do: `BEHAVIOURS` by name, each with the settings that a scenario may give it."""

from terrafuse.simulate.mission.behaviours.base import Behaviour, Kind
from terrafuse.simulate.mission.behaviours.patrol import Patrol, PatrolSettings
from terrafuse.simulate.mission.behaviours.soccer import Soccer, SoccerSettings
from terrafuse.simulate.mission.behaviours.wander import Wander, WanderSettings

BEHAVIOURS: dict[str, Kind] = {
    "patrol": (PatrolSettings, Patrol),
    "soccer": (SoccerSettings, Soccer),
    "wander": (WanderSettings, Wander),
}

__all__ = ["BEHAVIOURS", "Behaviour", "Kind"]
