"""What a window claimed, what was really allocated, what was ever seen: the *database* paper's wasted space."""

from __future__ import annotations

from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class Allocation:
    """Cells of one robot's own map. window_cells ≥ allocated_cells ≥ observed_cells."""

    window_cells: int
    """Of every tile that was ever inside the window, or touched outside it: what a robot and its store hold that
    allocate the whole window at once, as the paper's do."""
    allocated_cells: int
    """Of every tile that some scan touched: what terrafuse holds, which allocates a tile with its first point."""
    observed_cells: int
    """Seen at least once."""
    most_window_cells: int
    """Most that the window held at once: memory on the robot if all of it is allocated."""
    most_allocated_cells: int
    """Most that tiles in memory held at once."""

    @property
    def observed_of_window(self) -> float:
        """0 to 1; the rest is the paper's wasted space."""
        return self.observed_cells / self.window_cells if self.window_cells else 0.0

    @property
    def observed_of_allocated(self) -> float:
        return self.observed_cells / self.allocated_cells if self.allocated_cells else 0.0

    def as_json(self) -> dict[str, float]:
        ratios = {"observed_of_window": self.observed_of_window, "observed_of_allocated": self.observed_of_allocated}
        return {**asdict(self), **ratios}
