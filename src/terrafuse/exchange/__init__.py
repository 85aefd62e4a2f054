"""How robots' reports travel: deltas and their bytes."""
