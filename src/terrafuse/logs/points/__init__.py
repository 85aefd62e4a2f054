"""Files of bare points: `read(path)` → (N, 3) float32 or float64, as the file has it."""
