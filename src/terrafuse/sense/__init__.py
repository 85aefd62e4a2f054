"""Sensors as described data: where a beam goes, how far it sees, what a reading without echo says."""

from terrafuse.sense.apply import applied, check_aim, scan_of, undescribed
from terrafuse.sense.describe import load_sensor, preset_names
from terrafuse.sense.sensor import Beams, Mounting, Ring, Sensor

__all__ = [
    "Beams",
    "Mounting",
    "Ring",
    "Sensor",
    "applied",
    "check_aim",
    "load_sensor",
    "preset_names",
    "scan_of",
    "undescribed",
]
