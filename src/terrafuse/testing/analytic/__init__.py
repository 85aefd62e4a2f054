"""A small world in formulas, for tests and benchmarks: its lidar and its truth owe nothing to triangles."""
