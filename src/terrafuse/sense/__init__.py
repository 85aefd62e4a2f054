"""Sensors as described data: where a beam goes, how far it sees, what a reading without echo says."""

from terrafuse.sense.apply import applied, scan_of, undescribed
from terrafuse.sense.describe import load_sensor, preset_names
from terrafuse.sense.sensor import Beams, Mounting, Ring, Sensor

__all__ = [
    "Beams",
    "Mounting",
    "Ring",
    "Sensor",
    "applied",
    "load_sensor",
    "preset_names",
    "scan_of",
    "undescribed",
]
