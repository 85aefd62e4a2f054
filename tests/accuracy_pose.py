"""The table of docs/navigation.md: how far the pose filter errs, and how far it says it does."""

from __future__ import annotations

import numpy as np

from tests.navigate.test_pose_filter import PATTERNS, RUNS, TRUTH, chi2_bounds, run


def main() -> None:
    low, high = (bound / RUNS for bound in chi2_bounds(4 * RUNS))
    print(f"{RUNS} robots; 99 % of the means of NEES at one time lie between {low:.2f} and {high:.2f}")
    print("| GNSS | NEES | lowest, highest | it says (m) | it errs (m) |\n|---|---|---|---|---|")
    for name, quality in PATTERNS.items():
        runs = [run(seed, quality) for seed in range(RUNS)]
        times = np.mean([errors for _, errors in runs], axis=0)
        estimates = [filter_.estimate for filter_, _ in runs]
        says = np.sqrt(np.mean([np.trace(estimate.covariance[:2, :2]) for estimate in estimates]))
        errs = np.sqrt(np.mean([((estimate.mean[:2] - TRUTH[-1][0][:2]) ** 2).sum() for estimate in estimates]))
        print(f"| {name} | {times.mean():.2f} | {times.min():.2f}, {times.max():.2f} | {says:.2f} | {errs:.2f} |")


if __name__ == "__main__":
    main()
