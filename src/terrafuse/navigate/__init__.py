"""Where a robot can go: paths over the map, by its costs for one robot.

robot = Robot(radius_m=0.3)
path = plan_path(replica, (1.0, 2.0), (20.0, 5.0), robot)        # raises NoPath, which says why
still_good(path, cost_map(replica, robot, bounds_around_it))     # when the map has changed
"""

from __future__ import annotations

from terrafuse.navigate.costs import CostMap, cost_map
from terrafuse.navigate.path import Path, first_blocked, still_good
from terrafuse.navigate.plan import Plan, nearest_free, path_between, plan, plan_path
from terrafuse.navigate.pose_filter import PoseFilter
from terrafuse.navigate.robot import Robot, load_robot

__all__ = [
    "CostMap", "Path", "Plan", "PoseFilter", "Robot", "cost_map", "first_blocked", "load_robot", "nearest_free",
    "path_between", "plan", "plan_path", "still_good",
]  # fmt: skip
