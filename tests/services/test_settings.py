"""Fleet files: wrong ones name the line and the remedy."""

from __future__ import annotations

from pathlib import Path

import pytest

from terrafuse.errors import InputError
from terrafuse.services.carriers import carrier
from terrafuse.services.settings import chosen, load_fleet
from tests.program import terrafuse


def written(folder: Path, text: str) -> Path:
    path = folder / "fleet.yaml"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("- r1", r"fleet\.yaml:1: holds no keys; give map, link, station"),
        ("map:\n  resolution: 0.2\n", r"fleet\.yaml:2: map\.resolution: extra inputs are not permitted"),
        ("link:\n  kind: pigeon\n", r"fleet\.yaml:2: link\.kind: input should be 'memory' or 'zenoh'"),
        (
            "station:\n  name: a/b\n  store: s.db\n",
            r"fleet\.yaml:2: station\.name: 'a/b' can't be a node's name: give 1",
        ),
        ("robots:\n  r1: {source: a.log}\n", r"fleet\.yaml:2: robots\.r1\.store: field required"),
        ("robots:\n  a/b: {source: a.log, store: r1.db}\n", r"the file: 'a/b' can't be a node's name: give 1 to 64"),
        (
            "station: {name: r1, store: s.db}\nrobots:\n  r1: {source: a.log, store: r1.db}\n",
            "the station and a robot are both called 'r1'",
        ),
    ],
)
def test_wrong_files(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        load_fleet(written(tmp_path, text))


def test_which_nodes_run_here(tmp_path: Path) -> None:
    text = "link: {{kind: {}, insecure: true}}\nstation: {{store: s.db}}\nrobots: {{r1: {{source: a, store: r1.db}}}}\n"
    many = load_fleet(written(tmp_path, text.format("zenoh")))
    assert chosen(many, ["r1"]) == ["r1"]
    with pytest.raises(InputError, match="no node 'r2'; there are station, r1"):
        chosen(many, ["r2"])
    one = load_fleet(written(tmp_path, text.format("memory")))
    assert chosen(one, []) == ["station", "r1"]
    with pytest.raises(InputError, match="'memory' is for all nodes in one process"):
        chosen(one, ["r1"])


def test_a_network_without_keys_must_be_meant(tmp_path: Path) -> None:
    pytest.importorskip("zenoh")
    text = "link: {listen: [tcp/127.0.0.1:7447]}\nstation: {store: s.db}\n"
    with pytest.raises(InputError, match="no keys: give --keys FOLDER"):
        carrier(load_fleet(written(tmp_path, text)), print)("station")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (
            ["robot", "a/b", "--source", "a.log", "--connect", "tcp/127.0.0.1:7447"],
            "error: 'a/b' can't be a node's name",
        ),
        (
            ["station", "--store", "s.db", "--listen", "tcp/127.0.0.1:7447", "--area", "0,0,1,1"],
            "error: an area of interest is for the map of a station above",
        ),
        (["station", "--store", "s.db", "--listen", "x", "--name", "a/b"], "error: 'a/b' can't be a node's name"),
    ],
)
def test_wrong_options(tmp_path: Path, words: list[str], says: str) -> None:
    ran = terrafuse(*words, "--insecure", cwd=tmp_path)
    assert ran.code == 2
    assert ran.err.startswith(says)
    assert not list(tmp_path.iterdir())
