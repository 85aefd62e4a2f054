"""python -m terrafuse, and the entry point: what the program imports takes a second, in which it may be interrupted."""

from __future__ import annotations

import sys


def main() -> None:
    try:
        from terrafuse.cli import main as program
    except KeyboardInterrupt:
        sys.exit(130)
    program()


if __name__ == "__main__":
    main()
