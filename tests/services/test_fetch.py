"""Parts of a station's map, fetched by a person."""

from __future__ import annotations

import io
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
import numpy as np
import pytest

from terrafuse.errors import InputError
from terrafuse.exchange.asking import BUSY, Question
from terrafuse.exchange.codec import decode
from terrafuse.lattice import Lattice
from terrafuse.models import make_model
from terrafuse.replica import Replica
from terrafuse.services.answers import MOST_PEERS, Answers, Rates
from terrafuse.services.operator import Operator
from terrafuse.testing.deltas import deltas_of, random_scans
from tests.program import terrafuse
from tests.services.processes import Processes, answers, free_port

LATTICE, MODEL = Lattice(0.5, 4.0), make_model("elevation")


class Hands:
    """A clock that is set by hand."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def replica() -> Replica:
    whole = Replica(LATTICE, MODEL)
    for delta in deltas_of("r1", random_scans(1, 3, 7.0, 40), LATTICE, MODEL):
        whole.apply(delta)
    return whole


def test_what_a_node_answers() -> None:
    whole = replica()
    asked = Answers("station", {"fine": whole})
    key = whole.keys[0]
    delta = decode(asked("ops", Question(what="tile", x=key.x, y=key.y)), MODEL.cell)
    told = Replica(LATTICE, MODEL)
    told.apply(delta)
    assert told.cells(key).tobytes() == whole.cells(key).tobytes()
    west, south, east, north = msgspec.msgpack.decode(asked("ops", Question(what="extent")))
    xs, ys = [key.x for key in whole.keys], [key.y for key in whole.keys]
    assert (west, south) == (4.0 * min(xs), 4.0 * min(ys))
    assert (east, north) == (4.0 * max(xs) + 4.0, 4.0 * max(ys) + 4.0)
    assert asked.counts == {"questions.answered": 2}


def test_a_picture_has_a_pixel_a_cell_north_up() -> None:
    image = pytest.importorskip("matplotlib.image")
    whole = replica()
    asked = Answers("station", {"fine": whole})
    rgba = image.imread(io.BytesIO(asked("ops", Question(what="picture", layer="height", area=(-4.0, -8.0, 8.0, 4.0)))))
    assert rgba.shape == (24, 24, 4)
    known = np.zeros((24, 24), bool)
    for key in whole.keys:
        i, j = 8 * (key.x + 1), 8 * (key.y + 2)
        if 0 <= i < 24 and 0 <= j < 24:
            known[j : j + 8, i : i + 8] = MODEL.known(whole.cells(key))
    assert np.array_equal(rgba[..., 3] > 0.5, known[::-1])


@pytest.mark.parametrize(
    ("question", "why"),
    [
        (Question(what="weather"), "nobody answers 'weather' here; ask for tile, picture, extent"),
        (Question(channel="coarse"), "no map 'coarse' here; there are: fine"),
        (Question(what="picture", layer="smell"), "no layer 'smell'"),
        (Question(what="picture", area=(0.0, 0.0, 1e4, 1e4)), "a picture has 2,000,000 at most"),
        (Question(what="picture", area=(900.0, 900.0, 901.0, 901.0)), "nothing of the map lies within"),
        (Question(what="picture", area=(5.0, 5.0, 1.0, 1.0)), "hold no cell"),
        (Question(x=2**60), "beyond the lattice"),
    ],
)
def test_why_a_node_does_not_answer(question: Question, why: str) -> None:
    asked = Answers("station", {"fine": replica()})
    with pytest.raises(InputError, match=why):
        asked("ops", question)
    assert asked.counts == {"questions.refused": 1}


def test_who_asks_too_much_has_to_wait_and_others_have_not() -> None:
    """A tile has 64 cells: two at once, one a second; three of all at once, two a second."""
    clock = Hands()
    asked = Answers("station", {"fine": replica()}, Rates(64, 128, 128, 192), clock)
    tile = Question(what="tile")
    asked("greedy", tile)
    asked("greedy", tile)
    with pytest.raises(InputError, match=f"^{BUSY}: "):
        asked("greedy", tile)
    asked("modest", tile)
    with pytest.raises(InputError, match=f"^{BUSY}: "):
        asked("third", tile)
    clock.now_s += 1.0
    asked("greedy", tile)
    asked("third", tile)
    assert asked.counts == {"questions.answered": 5, "questions.busy": 2}


def test_who_asked_is_not_remembered_for_good() -> None:
    asked = Answers("station", {"fine": replica()})
    for k in range(MOST_PEERS + 5):
        asked(f"ops-{k}", Question(what="extent"))
    assert len(asked._peers) == MOST_PEERS


@contextmanager
def held(log: Path, folder: Path) -> Iterator[list[str]]:
    """A station that holds the map of a log; how to reach it."""
    port = free_port()
    where = ["--connect", f"tcp/127.0.0.1:{port}", "--insecure"]
    with Processes(folder) as fleet:
        options = ["--resolution", "0.2", "--global-factor", "10"]
        fleet.start("station", "station", "--store", "s.db", "--listen", where[1], "--insecure", *options)
        fleet.until(lambda: answers(port), "that the station listens")
        fleet.start("r1", "robot", "r1", *where, "--source", log, *options)
        fleet.until(lambda: fleet.code("r1") is not None, "that r1 ends")
        assert fleet.code("r1") == 0
        yield where


def test_get_brings_what_export_writes(logs: dict[str, Path], tmp_path: Path) -> None:
    pytest.importorskip("zenoh")
    with held(logs["r1"], tmp_path) as where:
        get = ["get", "station/map-manager", *where]
        came = terrafuse(
            *get, "--layer", "traversability", "--area", "0,0,20,20", "--out", tmp_path / "part.npz", "--json"
        )
        assert came.code == 0, came.err
        assert came.json["area"] == [0, 0, 20, 20]
        whole = terrafuse(*get, "--layer", "height", "--map", "coarse", "--out", tmp_path / "coarse.npz")
        assert whole.code == 0, whole.err
        assert terrafuse(*get, "--layer", "height", "--out", tmp_path / "all.png").code == 0
        drawn = terrafuse(*get, "--layer", "height", "--sketch", "--out", tmp_path / "bare.png", "--json")
        assert drawn.code == 0, drawn.err
        assert (tmp_path / "bare.png").stat().st_size == drawn.json["bytes"]
        for words, why in {
            ("--layer", "smell", "--out", "a.png"): "no layer 'smell'",
            ("--layer", "height"): "say where to",
            ("--area", "0,0,1,1"): "give --layer, too",
            ("--layer", "height", "--out", "a.odt"): "no format has the ending",
            ("--layer", "height", "--out", "a.png", "--area", "0,0,1e6,1e6"): "give a smaller --area",
            ("--layer", "height", "--out", "a.png", "--map", "global"): "no map 'global'",
            ("--layer", "height", "--out", "a.tif", "--sketch"): "name it .png",
            ("--layer", "height", "--out", "a.png", "--sketch", "--area", "0,0,1e4,1e4"): "'station' says: an area of",
        }.items():
            ran = terrafuse(*get, *words)
            assert ran.code == 2
            assert why in ran.err
    for name, store, words in (
        ("part", "s.db", ["--bounds", "0,0,20,20", "--layer", "traversability"]),
        ("coarse", "s.coarse.db", ["--layer", "height"]),
    ):
        assert terrafuse("export", tmp_path / store, *words, "--out", tmp_path / f"{name}.same.npz").code == 0
        one, other = (np.load(tmp_path / file)[words[-1]] for file in (f"{name}.npz", f"{name}.same.npz"))
        assert np.array_equal(one, other, equal_nan=True)
        assert np.isfinite(one).sum() > 100


def test_nobody_answers(tmp_path: Path) -> None:
    """A node without a map on the other end of the link."""
    from terrafuse.errors import TerrafuseError
    from terrafuse.exchange.courier import Courier
    from terrafuse.exchange.links import MemoryHub

    hub = MemoryHub()
    other, asking, stop = Courier(hub.link("station")), Operator(hub.link("ops"), "station"), threading.Event()

    def run() -> None:
        import time

        while not stop.wait(0.02):
            other.tick(time.time_ns())

    thread = threading.Thread(target=run)
    thread.start()
    try:
        with pytest.raises(InputError, match="'station' says: this node answers no questions"):
            list(asking.ask([Question()]))
    finally:
        stop.set()
        thread.join()
    with pytest.raises(TerrafuseError, match="'station' does not answer"):
        list(Operator(hub.link("other"), "station").ask([Question()], patience_s=0.3))
