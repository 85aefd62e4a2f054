"""A mission: a scenario that runs. Robots sense, map, report, plan and drive; a station gathers what they report."""
