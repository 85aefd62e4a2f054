"""python -m bench.sampled FILE ARGUMENTS...: `terrafuse ARGUMENTS`, and into FILE where its threads spent their time:
how often, looked at 200 times a second, each thread was in each line, and in each function or what it called."""

from __future__ import annotations

import sys
import threading
import time
from collections import Counter
from pathlib import Path
from types import FrameType

PERIOD_S = 0.005


class Sampler(threading.Thread):
    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.lines: Counter[str] = Counter()
        self.functions: Counter[str] = Counter()

    def run(self) -> None:
        while True:
            names = {thread.ident: thread.name for thread in threading.enumerate()}
            for ident, frame in sys._current_frames().items():
                if ident != self.ident:
                    self._count(names.get(ident, "another"), frame)
            time.sleep(PERIOD_S)

    def _count(self, thread: str, frame: FrameType | None) -> None:
        assert frame is not None
        self.lines[f"{thread} {_file(frame)}:{frame.f_lineno} {frame.f_code.co_name}"] += 1
        seen = set()
        while frame is not None:
            seen.add(f"{thread} {_file(frame)} {frame.f_code.co_name}")
            frame = frame.f_back
        self.functions.update(seen)


def _file(frame: FrameType) -> str:
    return "/".join(Path(frame.f_code.co_filename).parts[-2:])


def main() -> None:
    from terrafuse.cli import main as program

    file, sampler = Path(sys.argv[1]), Sampler()
    sys.argv[1:] = sys.argv[2:]
    sampler.start()
    try:
        program()
    finally:
        tables = (sampler.functions.most_common(120), sampler.lines.most_common(60))
        file.write_text("\n\n".join("\n".join(f"{count:7} {name}" for name, count in table) for table in tables))


if __name__ == "__main__":
    main()
