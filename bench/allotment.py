"""python -m bench.allotment [--json FILE] [--picture FILE]

Patrols of the village: when how much of its streets has been seen, by how many robots. Geometry only: robots go along
their routes at 3 m/s and see 55 m along every street that they are on. All start at the middle. The picture has the
routes of three.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
from tests.navigate.patrols import middle, seen_at_s, seen_share_at_s

from bench.report import parser, tell
from terrafuse.navigate.allotment import allot, patrol
from terrafuse.navigate.street_net import street_distances
from terrafuse.simulate.picture import world_colours
from terrafuse.simulate.worlds import village

ROBOTS = (1, 2, 3, 6, 12)
LANE_M = 1.75
SIGHT_M = 55.0
LOOKS = {"#c1272d": 5.0, "#1f5fbf": 8.0, "#1b8a3a": 8.0}
"""How the picture tells ways apart: their colours, and how many metres they lie to the right."""


def patrols(seed: int) -> list[dict[str, Any]]:
    streets, out = village(seed).streets, list[dict[str, Any]]()
    for robots in ROBOTS:
        started = time.process_time()
        ways = patrol(streets.nodes_m, streets.edges, [middle(streets.nodes_m)] * robots, SIGHT_M, LANE_M)
        seconds = time.process_time() - started
        seen_s = seen_at_s(streets.nodes_m, streets.edges, ways, sight_m=SIGHT_M)
        half_s, most_s, nearly_s = (seen_share_at_s(seen_s, share) for share in (0.5, 0.95, 0.98))
        out.append(
            {
                "robots": robots,
                "longest route, m": round(max(np.hypot(*np.diff(way, axis=0).T).sum() for way in ways)),
                "50 % seen after s": round(half_s),
                "95 % seen after s": round(most_s),
                "98 % seen after s": round(nearly_s),
                "times as fast (95 %)": round(out[0]["95 % seen after s"] / most_s, 2) if out else 1.0,
                "seen in the end": round(float(np.isfinite(seen_s).mean()), 4),
                "processor seconds": round(seconds, 2),
            }
        )
    return out


def write_picture(path: Path) -> None:
    """Streets of the village, and the ways of three robots, well to the right, so that both directions are seen."""
    from matplotlib.figure import Figure

    world = village(0)
    start = middle(world.streets.nodes_m)
    figure = Figure(figsize=(6.4, 6.4), dpi=100)
    axes = figure.add_axes((0, 0, 1, 1), frameon=False)
    extent = (world.bounds.west, world.bounds.east, world.bounds.south, world.bounds.north)
    pale = 0.45 * np.clip(world_colours(world, 1.0), 0, 1) + 0.55
    axes.imshow(pale, origin="lower", extent=extent)
    for number, (colour, aside_m) in enumerate(LOOKS.items()):
        way = patrol(world.streets.nodes_m, world.streets.edges, [start] * len(LOOKS), SIGHT_M, aside_m)[number]
        axes.plot(*way.T, color=colour, linewidth=2, solid_joinstyle="round", label=f"robot {number + 1}")
        axes.plot(*way[-1], marker="s", color=colour, markersize=9, markeredgecolor="white")
    axes.plot(*world.streets.nodes_m[start], "o", color="black", markersize=11, markeredgecolor="white", label="start")
    axes.legend(loc="upper center", ncols=4, frameon=False, fontsize=9)
    axes.set(xlim=extent[:2], ylim=extent[2:], xticks=[], yticks=[])
    figure.savefig(path)


def main() -> None:
    arguments = parser(__doc__)
    arguments.add_argument("--picture", type=Path, help="draw the routes of three robots to this PNG")
    options = arguments.parse_args()
    if options.picture:
        write_picture(options.picture)
    net = street_distances(np.array([[0.0, 0.0], [1.0, 0.0]]), np.array([[0, 1]]))
    allot(net[0], [0, 1], [0, 1])  # Compiles.
    tell({f"village of seed {seed}": patrols(seed) for seed in (0, 1, 2)}, options.json)


if __name__ == "__main__":
    main()
