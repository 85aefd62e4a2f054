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

import terrafuse as program
from terrafuse.errors import InputError
from terrafuse.lattice import Lattice
from terrafuse.models import LAYERS, layers_of, make_model
from terrafuse.plugins import fingerprints, load_plugin
from terrafuse.replica import Replica
from terrafuse.store.memory import MemoryStore
from terrafuse.testing.deltas import deltas_of, scan_of
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


OURS = str(Path(program.__file__).parent.parent)
"""Where the terrafuse lies that this test imported: the commands run that one, and of the rest nothing of here."""


def run(line: str, folder: Path) -> str:
    """What a command of the page prints."""
    name, *arguments = shlex.split(line)
    done = subprocess.run(
        [sys.executable, "-m", name, *arguments],
        cwd=folder, capture_output=True, text=True, timeout=300, env=os.environ | {"PYTHONPATH": OURS},
    )  # fmt: skip
    assert done.returncode == 0, (line, done.stdout, done.stderr)
    return done.stdout


def test_the_commands_run_the_terrafuse_under_test(desk: Path) -> None:
    (desk / "where.py").write_text("import terrafuse\nprint(terrafuse.__file__)\n")
    assert run("where", desk).strip() == program.__file__


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


def test_a_plugin_that_ends_the_program_is_named(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("import sys\nsys.exit('bye')\n")
    with pytest.raises(InputError, match=r"mine\.py: line 2 SystemExit: bye"):
        load_plugin(tmp_path / "mine.py")
    with pytest.raises(InputError, match="give an existing Python file"):
        load_plugin("a" * 5000 + ".py")


LAYER = """\
import numpy as np
from terrafuse.models import LAYERS, Layer

def mine(model):
    {make}

LAYERS["{name}"].append(mine)
"""
MISTAKES = {
    "raises when made": ("model.layers['hight']", r"a layer of .*mine\.py for 'elevation': line 5 KeyError: 'hight'"),
    "is none": ("return 7", r"a layer of .*mine\.py for 'elevation': 7 is no Layer"),
    "halo": (
        "return Layer('x', '1', 'x', None.__eq__, halo=-1)",
        r"layer 'x' of .*mine\.py: a halo of -1; give 0 to 64",
    ),
    "raises when computed": (
        "return Layer('x', '1', 'x', lambda cells, reading: cells['hight'])",
        r"layer 'x' of .*mine\.py: line 5 ValueError: no field of name hight",
    ),
    "shape": (
        "return Layer('x', '1', 'x', lambda cells, reading: np.zeros((2, 2)))",
        r"layer 'x' of .*mine\.py: gives float64 of shape \(2, 2\) for cells of shape",
    ),
    "kind": (
        "return Layer('x', '1', 'x', lambda cells, reading: np.full(cells.shape, 'a'))",
        r"layer 'x' of .*mine\.py: gives <U1 of shape",
    ),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_layer_that_fails_is_named(mistake: str, desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make, complaint = MISTAKES[mistake]
    (tmp_path / "mine.py").write_text(LAYER.format(make=make, name="elevation"))
    monkeypatch.setitem(LAYERS, "elevation", [])
    load_plugin(tmp_path / "mine.py")
    store = MemoryStore(Lattice(1.0, 10.0), make_model("elevation"))
    for delta in deltas_of("r1", [scan_of([[1.5, 1.5, 0.0]], 1)], store.map.lattice, store.model):
        store.accept(delta)
    with pytest.raises(InputError, match=complaint):
        Replica(store=store).layer("x")


def test_layers_of_a_model_that_there_is_none_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mine.py").write_text(LAYER.format(make="return 1", name="elevatoin"))
    monkeypatch.setitem(LAYERS, "elevatoin", [])
    load_plugin(tmp_path / "mine.py")
    with pytest.raises(
        InputError, match=r"LAYERS\['elevatoin'\] of .*mine\.py: there is no such cell model; there are:"
    ):
        layers_of(make_model("occupancy"))
    ran = terrafuse("map", "r1=nowhere.mcap", "--plugin", tmp_path / "mine.py", "--out", tmp_path / "out")
    assert ran.code == 2
    assert "LAYERS['elevatoin']" in ran.err


def test_layers_that_are_no_list_of_functions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(LAYERS, "elevation", [3])  # type: ignore[list-item]
    with pytest.raises(InputError, match=r"LAYERS\['elevation'\]: holds \[3\]; append a function"):
        layers_of(make_model("occupancy"))


BROKEN = """\
from terrafuse.models import MODELS

def broken():
    return 1 / 0

MODELS["broken"] = broken
"""


def test_what_else_of_a_plugin_fails_in_a_command_is_named(tmp_path: Path, desk: Path) -> None:
    (tmp_path / "mine.py").write_text(BROKEN)
    log = f"r1={desk / 'monday.mcap'}"
    ran = terrafuse("map", log, "--plugin", tmp_path / "mine.py", "--model", "broken", "--out", tmp_path / "out")
    assert ran.code == 2
    assert re.search(r"^error: plug-in .*mine\.py: line 4 ZeroDivisionError: division by zero$", ran.err, re.MULTILINE)
    assert "Traceback" not in ran.err


def test_a_layer_under_a_name_that_is_taken_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(LAYERS, "elevation", [lambda model: model.layers["height"]])
    with pytest.raises(InputError, match="has a layer 'height' already"):
        layers_of(make_model("elevation"))
