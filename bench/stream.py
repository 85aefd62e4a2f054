"""The stream that all is timed on: 100 scans of 120,000 beams (64 × 1875), hilly ground with boxes, 1 m a scan."""

from __future__ import annotations

import numpy as np

from terrafuse.testing.analytic.boxes import Box
from terrafuse.testing.analytic.ground import Ground
from terrafuse.testing.analytic.scene import Lidar, Scene, box_on, scan
from terrafuse.types import Pose, Scan

SENSOR_HEIGHT_M = 1.8
STEP_M = 1.0
SCAN_NS = 100_000_000


def lidar(order: str = "ring") -> Lidar:
    """64 beams and 1875 columns as an HDL-64 has them; "ring" is the order of KITTI's files, "firing" a driver's."""
    return Lidar(beams=64, columns=1875, lowest_deg=-24.8, highest_deg=2.0, max_range_m=120.0, order=order)  # type: ignore[arg-type]


def scene() -> Scene:
    ground = Ground()
    rng = np.random.default_rng(1)
    boxes: list[Box] = []
    for k in range(40):
        x, side = 6.0 * k - 60.0, rng.choice([-1, 1])
        length, width, height = rng.uniform(3, 12), rng.uniform(3, 8), rng.uniform(2, 8)
        boxes.append(box_on(ground, x, side * rng.uniform(12, 45), length, width, height, rng.uniform(0, 3)))
    return Scene(ground, tuple(boxes))


def stream(scans: int = 100, order: str = "ring") -> list[Scan]:
    """Scans of one robot, points in the sensor's frame as float32."""
    world, sensor, rng = scene(), lidar(order), np.random.default_rng(0)
    out = []
    for k in range(scans):
        x, y = STEP_M * k, 0.0
        up = float(world.ground.height(x, y)) + SENSOR_HEIGHT_M
        pose = Pose.from_quaternion((x, y, up), (0, 0, np.sin(0.1 * np.sin(k / 9)), np.cos(0.1 * np.sin(k / 9))))
        points = scan(world, sensor, pose, 0.0, rng)
        out.append(Scan(k * SCAN_NS, points[np.isfinite(points[:, 0])], pose))
    return out
