"""Worlds, robots, sensors and radio with a known truth: another source of scans, another link."""
