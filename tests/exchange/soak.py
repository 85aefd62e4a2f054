"""Convergence over many schedules; stops at none that fails, and names those that do.

python -m tests.exchange.soak [COUNT [FIRST]]
"""

from __future__ import annotations

import sys
from concurrent.futures import ProcessPoolExecutor

from tests.exchange.schedules import converges

AT_ONCE = 100


def failing(seeds: range) -> list[int]:
    return [seed for seed in seeds if not converges(seed)]


def main(count: int = 20_000, first: int = 1000) -> int:
    pieces = [range(k, min(k + AT_ONCE, first + count)) for k in range(first, first + count, AT_ONCE)]
    bad: list[int] = []
    with ProcessPoolExecutor() as workers:
        for done, some in enumerate(workers.map(failing, pieces), start=1):
            bad += some
            sys.stdout.write(f"\r{min(done * AT_ONCE, count)} of {count} schedules, failing: {bad or 'none'}")
            sys.stdout.flush()
    sys.stdout.write("\n")
    return int(bool(bad))


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
