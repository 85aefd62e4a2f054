"""python -m bench.physics_picture FILE: one robot with physics and one without on a hill that is in part too steep.

Both get the same commands: those that lead the one with physics along its route. One route goes round the hill, one
over its top, where the slope is beyond what friction holds.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

import numpy as np

from terrafuse.export.shade import hillshade
from terrafuse.simulate.motion import BODIES, Ground, State, placed, step
from terrafuse.simulate.physics import Physics
from terrafuse.simulate.routes import at_start, pursue, routes_of
from terrafuse.simulate.terrain import Terrain
from terrafuse.simulate.world import World
from terrafuse.types import Bounds, Floats

SIDE_M, STEP_M, HILL_M, SPREAD_M = 60.0, 1.0, 16.0, 10.0
"""A Gaussian of this height: its steepest slope is 16/10·e^(-1/2) = 0.97, and friction is 0.8."""
BODY, DT_S, SECONDS, SPEED_MPS = BODIES["summit_xl"], 0.1, 80.0, 1.0
ROUND = [(-25.0, -16.0), (-8.0, -18.0), (9.0, -17.0), (18.5, -6.0), (18.5, 8.0), (9.0, 18.0), (-8.0, 20.0)]
OVER = [(-25.0, 0.5), (25.0, 0.5)]
COLOURS = {"with physics": "#c2185b", "without forces": "#1565c0"}


def hill() -> World:
    axis = np.arange(-SIDE_M / 2, SIDE_M / 2 + STEP_M, STEP_M)
    x, y = np.meshgrid(axis, axis)
    bounds = Bounds(-SIDE_M / 2, -SIDE_M / 2, SIDE_M / 2, SIDE_M / 2)
    heights = HILL_M * np.exp(-(x * x + y * y) / (2 * SPREAD_M**2)) + 0.15 * np.sin(x / 2) * np.cos(y / 3)
    return World("hill", bounds, Terrain(-SIDE_M / 2, -SIDE_M / 2, STEP_M, heights))


@dataclass(frozen=True, eq=False)
class Track:
    """(T, 6): x, y, z, roll, pitch, speed of both."""

    physics: Floats
    kinematic: Floats


def tracked(world: World, way: list[tuple[float, float]]) -> Track:
    ground, routes = Ground(world.terrain.height), routes_of([way], BODY)
    ahead = np.subtract(way[1], way[0])
    state = other = placed(ground, BODY, [way[0]], [np.arctan2(ahead[1], ahead[0])])
    physics, progress, rows = Physics(world, {"r": "summit_xl"}, {"r": state}), at_start(routes), []
    for k in range(round(SECONDS / DT_S)):
        command, progress = pursue(state, routes, progress, BODY, SPEED_MPS)
        state = physics.step({"r": command}, DT_S, k * DT_S)["r"]
        other = step(other, command, DT_S, ground, BODY)
        rows.append([row(state), row(other)])
    both = np.array(rows)
    return Track(both[:, 0], both[:, 1])


def row(state: State) -> list[float]:
    return [*state.position_m[0].tolist(), state.roll_rad[0], state.pitch_rad[0], state.speed_mps[0]]


def draw_map(axes: Any, world: World, tracks: list[Track], ways: list[list[tuple[float, float]]]) -> None:
    z, half = world.terrain.heights_m, SIDE_M / 2
    extent = (-half, half, -half, half)
    axes.imshow(
        hillshade(z, STEP_M), cmap="gray", origin="lower", extent=extent, vmin=-0.3, vmax=1.2, interpolation="bilinear"
    )
    x, y = world.terrain.axes_m
    axes.contour(x, y, z, np.arange(2, HILL_M, 2), colors="0.35", linewidths=0.5)
    slope = np.hypot(*np.gradient(z, STEP_M))
    axes.contourf(x, y, slope, [0.8, 9], colors=["#ff9800"], alpha=0.35)
    for track, way in zip(tracks, ways, strict=True):
        axes.plot(*np.transpose(way), color="black", linewidth=0.8, linestyle=":")
        axes.plot(*track.kinematic[:, :2].T, color=COLOURS["without forces"], linewidth=1.6, linestyle="--")
        axes.plot(*track.physics[:, :2].T, color=COLOURS["with physics"], linewidth=1.6)
        axes.plot(*track.physics[-1, :2], "o", color=COLOURS["with physics"])
        axes.plot(*track.kinematic[-1, :2], "o", color=COLOURS["without forces"])
    axes.set(xlabel="x east (m)", ylabel="y north (m)", title="routes dotted; orange: steeper than friction holds")


def draw_times(axes: Any, track: Track, column: int, factor: float, name: str) -> None:
    times = DT_S * np.arange(1, len(track.physics) + 1)
    for of, label, style in ((track.kinematic, "without forces", "--"), (track.physics, "with physics", "-")):
        axes.plot(times, factor * of[:, column], style, color=COLOURS[label], linewidth=1.2, label=label)
    axes.set_ylabel(name)
    axes.grid(alpha=0.3)


def main(file: str) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    world, ways = hill(), [ROUND, OVER]
    tracks = [tracked(world, way) for way in ways]
    figure = pyplot.figure(figsize=(12, 6.4), layout="constrained")
    grid = figure.add_gridspec(4, 2, width_ratios=[1.05, 1])
    draw_map(figure.add_subplot(grid[:, 0]), world, tracks, ways)
    plots = [
        (0, 2, 1.0, "round: z (m)"),
        (0, 4, np.degrees(1), "round: pitch (°)"),
        (0, 3, np.degrees(1), "round: roll (°)"),
        (1, 5, 1.0, "over: speed (m/s)"),
    ]  # fmt: skip
    for place, (which, column, factor, name) in enumerate(plots):
        draw_times(figure.add_subplot(grid[place, 1]), tracks[which], column, factor, name)
    figure.axes[1].legend(loc="upper right", fontsize=8)
    figure.axes[-1].set_xlabel("s")
    figure.savefig(file, dpi=100)


if __name__ == "__main__":
    main(sys.argv[1])
