"""Scenarios: one commented YAML file each, checked before anything is simulated."""

from terrafuse.simulate.scenario.model import Scenario
from terrafuse.simulate.scenario.read import Loaded, load_scenario, scenario_names, with_robots

__all__ = ["Loaded", "Scenario", "load_scenario", "scenario_names", "with_robots"]
