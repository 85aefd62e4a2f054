"""What sensors would read in a simulated world."""

from terrafuse.simulate.sensors.lidar import Lidar, lidar_ranges, lidar_scan
from terrafuse.simulate.sensors.sonar import Sonar, fired, firings, sonar_ranges, sonar_scan

__all__ = ["Lidar", "Sonar", "fired", "firings", "lidar_ranges", "lidar_scan", "sonar_ranges", "sonar_scan"]
