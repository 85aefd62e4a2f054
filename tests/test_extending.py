"""The examples of docs/extending.md run as they stand in the page; plug-ins that can't be used say why."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from terrafuse.errors import InputError
from terrafuse.models import LAYERS, layers_of, make_model
from terrafuse.plugins import fingerprints, load_plugin
from tests.program import record, terrafuse

PAGE = (Path(__file__).parent.parent / "docs/extending.md").read_text()
SECTIONS = [title for title in re.findall(r"^## (.*)$", PAGE, re.MULTILINE) if title.startswith("A ")]


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with every file of the page, and the logs that its commands map."""
    folder = tmp_path_factory.mktemp("desk")
    for name, content in re.findall(r'^```\w+ title="([\w.]+)"\n(.*?)^```', PAGE, re.DOTALL | re.MULTILINE):
        (folder / name).write_text(content)
    for seed, name in enumerate(("monday", "tuesday")):
        record(folder / f"{name}.mcap", seed, 6)
    return folder


def run(line: str, folder: Path) -> None:
    program, *arguments = shlex.split(line)
    done = subprocess.run(
        [sys.executable, "-m", program, *arguments],
        cwd=folder, capture_output=True, text=True, timeout=300, env=os.environ | {"PYTHONPATH": ""},
    )  # fmt: skip
    assert done.returncode == 0, (line, done.stdout, done.stderr)


@pytest.mark.parametrize("section", SECTIONS)
def test_the_commands_of_a_section_run(desk: Path, section: str) -> None:
    text = PAGE.split(f"## {section}\n")[1].split("\n## ")[0]
    lines = re.findall(
        r"^    ((?:terrafuse|pytest) .*)$", re.sub(r"```.*?```", "", text, flags=re.DOTALL), re.MULTILINE
    )
    assert lines
    if "--out map\n" in text:
        shutil.rmtree(desk / "map", ignore_errors=True)  # of a section that ran before
    elif "map/map.db" in text and not (desk / "map").exists():
        run("terrafuse map r1=monday.mcap r2=tuesday.mcap --out map", desk)
    for line in lines:
        run(line, desk)


def test_a_store_says_which_model_it_lacks_and_how_to_give_it(
    desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log, model = f"r1={desk / 'monday.mcap'}", desk / "highest.py"
    made = terrafuse(
        "map", log, "--plugin", model, "--model", "highest", "--resolution", "2", "--out", tmp_path / "out"
    )
    assert made.code == 0, made.err
    store = tmp_path / "out/map.db"
    without = terrafuse("info", store)
    assert without.code == 2
    assert "no cell model 'highest'" in without.err
    assert "--plugin FILE.py" in without.err
    monkeypatch.setenv("TERRAFUSE_PLUGINS", os.pathsep.join([str(desk / "xyz.py"), str(model)]))
    said = terrafuse("info", store, "--json")
    assert said.json["map"]["model"] == "highest"
    assert terrafuse("export", store, "--out", tmp_path / "top.xyz").code == 0


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (None, "give an existing Python file"),
        ("x = 1\ny = x / 0\n", "line 2 ZeroDivisionError: division by zero"),
        ("def f(:\n", "SyntaxError: invalid syntax"),
        ("import no_such_module\n", "line 1 ModuleNotFoundError: No module named 'no_such_module'"),
    ],
)
def test_a_plugin_that_fails_is_named(tmp_path: Path, content: str | None, complaint: str) -> None:
    if content is not None:
        (tmp_path / "mine.py").write_text(content)
    with pytest.raises(InputError, match=r"plug-in .*mine\.py") as error:
        load_plugin(tmp_path / "mine.py")
    assert complaint in str(error.value)


def test_a_plugin_runs_once_and_marks_the_run(tmp_path: Path) -> None:
    file, log = tmp_path / "once.py", tmp_path / "log.txt"
    file.write_text(f"open({str(log)!r}, 'a').write('ran ')\n")
    before = fingerprints()
    load_plugin(file)
    load_plugin(tmp_path / "." / "once.py")
    assert log.read_text() == "ran "
    assert len(fingerprints()) == len(before) + 1


def test_a_layer_under_a_name_that_is_taken_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(LAYERS, "elevation", [lambda model: model.layers["height"]])
    with pytest.raises(InputError, match="has a layer 'height' already"):
        layers_of(make_model("elevation"))
