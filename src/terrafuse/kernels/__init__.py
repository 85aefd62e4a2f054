"""The compiled loops. Each stands beside the short NumPy reference that it must equal.

All kernels release the GIL, so that one robot a thread scales, and none uses fast-math: every machine gets the same
bytes.
"""
