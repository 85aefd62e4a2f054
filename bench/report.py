"""How every benchmark is asked and answers: JSON on stdout and, if wanted, in a file."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def parser(description: str | None) -> argparse.ArgumentParser:
    out = argparse.ArgumentParser(description=description)
    out.add_argument("--json", type=Path, help="also write the figures to this file")
    return out


def tell(figures: Mapping[str, Any], file: Path | None) -> None:
    text = json.dumps(figures, indent=1)
    print(text)
    if file:
        file.write_text(text + "\n")
