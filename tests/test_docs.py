"""The documentation's examples run, and its links lead somewhere."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from tests.program import terrafuse

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", page.read_text()):
        assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_the_readmes_python_runs(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("xarray")
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    exec(compile(code, "README.md", "exec"), {})
    assert "'y': 80, 'x': 80" in capsys.readouterr().out


def test_the_readmes_commands_run(mapped: Path, tmp_path: Path) -> None:
    """info and export as written, on a map of the tests (so with bounds of its own)."""
    lines = re.findall(r"^    terrafuse ((?:info|export) .*)$", (ROOT / "README.md").read_text(), re.MULTILINE)
    assert len(lines) == 5
    for line in lines:
        arguments = [a.replace("map/map.db", str(mapped / "map.db")) for a in shlex.split(line)]
        if "--bounds" in arguments:
            arguments[arguments.index("--bounds") + 1] = "500000,3999990,500010,4000010"
        ran = terrafuse(*arguments, cwd=tmp_path)
        assert ran.code == 0, (line, ran.err)
