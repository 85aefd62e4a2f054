"""Measures the map of two robots' logs against a world in formulas: python -m tests.accuracy_analytic

Prints the table of docs/accuracy.md as Markdown; with and without the dynamic rule.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from terrafuse.lattice import Lattice
from tests.analytic.logs import write_logs
from tests.analytic.maps import map_of
from tests.analytic.truth import compare

LATTICE = Lattice(0.1)


def main() -> None:
    with TemporaryDirectory() as folder:
        logs = write_logs(Path(folder))
        both = [compare(map_of(logs, LATTICE, static)) for static in (False, True)]
    print("| | | static |\n|---|---|---|")
    for name in both[0]:
        print(f"| {name.replace('_', ' ')} | {' | '.join(f'{one[name]:.6g}' for one in both)} |")


if __name__ == "__main__":
    main()
