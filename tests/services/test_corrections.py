"""Robots make their maps anew by corrected poses: everybody's map is then that of a log with such poses."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import replace
from math import radians
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from terrafuse.cli import correcting
from terrafuse.cli.running import progress
from terrafuse.errors import InputError, StoreError, StoreMismatch
from terrafuse.exchange.corrections import (
    ALWAYS_NS,
    CORRECTION,
    MOST,
    Correction,
    encode_corrections,
    fingerprint,
    flat,
    merged,
)
from terrafuse.exchange.courier import Channel, Courier
from terrafuse.exchange.delta import TileCells
from terrafuse.exchange.erased import erased, erasing, observed
from terrafuse.exchange.links import MemoryHub
from terrafuse.lattice import Lattice
from terrafuse.models import make_model
from terrafuse.replica import Replica
from terrafuse.services.book import Book
from terrafuse.services.directory import Entry
from terrafuse.services.node import make_node
from terrafuse.services.operator import Operator
from terrafuse.services.rebuild import Bases, Basis, changes
from terrafuse.services.run import run
from terrafuse.services.service import Status
from terrafuse.services.settings import FleetSettings
from terrafuse.store.base import newest, sparse
from terrafuse.store.memory import MemoryStore
from terrafuse.store.sqlite import SqliteStore
from terrafuse.types import Bounds, Pose, TileKey
from tests.program import terrafuse
from tests.services.drives import drive
from tests.services.processes import Processes, answers, cells_in, free_port
from tests.services.test_one_process import digest, mapped_at_once, settings_of

SECOND_NS = 1_000_000_000
SHIFT = Correction("shift", 10, 0, ALWAYS_NS, flat(2.5, -1.25, 0.0, 0.5))
TURN = Correction("turn", 20, 5 * SECOND_NS, 9 * SECOND_NS, flat(0.0, 0.0, np.pi / 6, about_m=(4.0, 2.0)))


def by(*corrections: Correction) -> Callable[[float, Pose], Pose]:
    def correct(second: float, pose: Pose) -> Pose:
        for one in corrections:
            if one.from_ns <= second * SECOND_NS < one.until_ns:
                pose = one.T_new_old @ pose
        return pose

    return correct


# --- what corrections are --------------------------------------------------------------------------------------------


def test_a_turn_about_a_place() -> None:
    """A quarter turn about (1, 2), then 10 m east: what was a metre east of it is a metre north of (11, 2)."""
    moved = flat(10.0, 0.0, np.pi / 2, about_m=(1.0, 2.0)) @ Pose.identity().shifted(2.0, 2.0)
    assert np.allclose(moved.position, [11.0, 3.0, 0.0])


@given(st.permutations(range(6)), st.integers(0, 6))
def test_neither_order_nor_repetition_makes_a_difference(order: list[int], cut: int) -> None:
    """Of six, two have one id, and two one time."""
    some = [
        Correction(id_, issued, 0, ALWAYS_NS, flat(float(k), 0.0, 0.0))
        for k, (id_, issued) in enumerate([("a", 1), ("b", 1), ("c", 2), ("a", 3), ("d", 4), ("e", 0)])
    ]
    shuffled = [some[k] for k in order]
    at_once, in_parts = merged(some), merged(merged(shuffled[cut:]), shuffled[:cut], shuffled)
    assert [one.id for one in at_once] == ["e", "b", "c", "a", "d"]
    assert fingerprint(at_once) == fingerprint(in_parts)


def test_there_are_bounds() -> None:
    with pytest.raises(InputError, match="corrections of one robot"):
        merged([Correction(str(k), k, 0, 1, flat(0.0, 0.0, 0.0)) for k in range(MOST + 1)])
    longest = [Correction(f"{k:064d}", 2**62 + k, 2**62, 2**63 - 1, flat(0.1, 0.1, 0.1, 0.1)) for k in range(MOST)]
    assert len(encode_corrections(longest)) < 1 << 16


def test_a_book_keeps_what_holds(tmp_path: Path) -> None:
    book = Book(tmp_path / "r1.corrections")
    assert book.add("r1", [TURN])
    assert not book.add("r1", [TURN])
    assert book.add("r1", [SHIFT])
    again = Book(tmp_path / "r1.corrections")
    assert [one.id for one in again.of("r1")] == ["shift", "turn"]
    assert again.of("r2") == ()
    (tmp_path / "r1.corrections").write_bytes(b"else")
    with pytest.raises(StoreError, match="delete it, and give them again"):
        Book(tmp_path / "r1.corrections")


def test_a_map_is_by_the_newest_basis_that_it_reached(tmp_path: Path) -> None:
    bases = Bases(tmp_path / "r1.bases")
    assert bases.of(7) == Basis(0, "")
    first = bases.plan(7, [SHIFT])
    assert first == Basis(1 << 20, fingerprint([SHIFT]))
    assert bases.of(7) == Basis(0, "")  # it was killed before the map was replaced
    assert bases.plan(7, [TURN]).base == 1 << 20
    assert bases.of((1 << 20) + 7).corrections == fingerprint([TURN])
    assert bases.plan((1 << 20) + 7, [SHIFT, TURN]).base == 2 << 20


# --- cells that are erased -------------------------------------------------------------------------------------------


@given(st.integers(0, 2**32 - 1))
def test_changes_make_the_cells_of_before_those_of_after(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cell = make_model("grey").cell
    key = TileKey(0, 0)

    def some(most: int) -> TileCells | None:
        at = np.flatnonzero(rng.random(12) < rng.random()).astype(np.int32)
        cells = np.zeros(len(at), cell)
        cells["a"], cells["stamp"], cells["revision"] = rng.integers(1, 3, len(at)), 5, rng.integers(1, most, len(at))
        return TileCells(key, at, cells) if len(at) else None

    before, after = some(9), some(9)
    dense = np.zeros(12, cell)
    for tile in (before, changes(key, before, after, 100, 109)):
        if tile is not None:
            newest(dense, tile.at, tile.cells)
    made = observed(TileCells(key, *sparse(dense)))
    expected = after or TileCells(key, np.empty(0, np.int32), np.empty(0, cell))
    assert np.array_equal(made.at, expected.at)
    assert np.array_equal(made.cells[["a", "stamp"]], expected.cells[["a", "stamp"]])


def test_what_is_erased() -> None:
    cell = make_model("elevation").cell
    tile = erasing(TileKey(0, 0), np.array([3, 7]), 9, cell)
    assert erased(tile.cells).all()
    assert len(observed(tile).at) == 0
    tile.cells["n"][0] = 1
    assert erased(tile.cells).tolist() == [False, True]
    assert not erased(np.zeros(2, cell)).any()


# --- what the command takes ------------------------------------------------------------------------------------------


def test_what_can_be_no_correction_is_told_by_option() -> None:
    for words, why in {
        ("a/b", (1.0, 0.0, 0.0), 0.0, None, None): "'a/b' can't be a node's name",
        ("r1", (0.0, 0.0, 0.0), 0.0, None, None): "this corrects nothing",
        ("r1", (0.0, -1e8, 0.0), 0.0, None, None): r"--shift-north -1e\+08: give metres, 1e\+07 at most",
        ("r1", (0.0, 0.0, 0.0), 1e300, None, None): r"--turn-deg 1e\+300: give degrees, 360 at most",
        ("r1", (0.0, 0.0, 0.0), 5.0, "1e9,0", None): "--about 1e9,0: give metres",
        ("r1", (1.0, 0.0, 0.0), 0.0, None, "x" * 65): "--id 'x+': give 1 to 64",
    }.items():
        with pytest.raises(InputError, match=why):
            correcting.checked(*words)
    assert (
        correcting.checked("r1", (0.0, 0.0, 0.0), 0.0, None, "s").motion(known()).matrix.tolist() == np.eye(4).tolist()
    )


def known(crs: str | None = None, robot: str = "r1") -> correcting.Known:
    """By a station that holds r1's map, and has r2 in reach."""
    manager = {"channels": {"fine": {"r1": 7}}, "peers": ["r2"], "map": {"crs": crs}}
    place = {"place_m": [500000.0, 5000000.0, 3.0]}
    entries = [
        Entry("station", 1, 2, 0.0, False, [Status("map-manager", "", "running", 0, state=manager)]),
        Entry("r1", 1, 2, 0.0, False, [Status("mapping", "", "running", 0, state=place)]),
    ]
    return correcting.look_up(entries, "station", robot)


def test_a_turn_in_a_crs_is_about_a_place_that_is_said() -> None:
    """A degree about an origin 5,000 km away would move the robot by 87 km."""
    turn = correcting.checked("r1", (0.0, 0.0, 0.0), 1.0, None, None)
    with pytest.raises(InputError, match=r"in a map of EPSG:32632: .* --about E,N; 'r1' was last at 500000,5000000$"):
        turn.motion(known("EPSG:32632"))
    assert turn.turned == " (1° about 0,0)"
    assert np.allclose(turn.motion(known()).position, 0.0)
    here = correcting.checked("r1", (0.0, 0.0, 0.0), 1.0, "500000,5000000", None)
    at = Pose.identity().shifted(500000.0, 5000000.0)
    assert np.allclose((here.motion(known("EPSG:32632")) @ at).position, at.position)


def test_what_the_station_knows_of_a_robot() -> None:
    assert (known().reached, known().warning) == (False, "")
    assert known().tells == "will tell 'r1', which is not there now"
    assert known(robot="r2").tells == "tells 'r2'"
    assert known(robot="r9").warning == "'station' has never heard of 'r9'; is the name right?"


# --- robots ----------------------------------------------------------------------------------------------------------


class Fleet:
    """Some nodes in this process, and how to tell r1 of its poses."""

    def __init__(self, settings: FleetSettings) -> None:
        self.settings, self.hub = settings, MemoryHub()
        self.nodes = {name: self.make(name) for name in settings.nodes}

    def make(self, name: str):  # type: ignore[no-untyped-def]
        node = make_node(self.settings, name, lambda name: lambda: self.hub.link(name))
        node.supervisor.start(f"{name} ")
        return node

    def stop(self, name: str) -> None:
        node = self.nodes.pop(name)
        assert node.supervisor.stop(10)
        node.close()

    def __enter__(self) -> Fleet:
        return self

    def __exit__(self, *_: object) -> None:
        for name in list(self.nodes):
            self.stop(name)

    def state(self, node: str, service: str) -> dict:  # type: ignore[type-arg]
        return self.nodes[node].statuses[service].state

    def until(self, what: Callable[[], bool], seconds: float = 60.0) -> None:
        deadline = time.monotonic() + seconds
        while not what():
            faults = [node.supervisor.fault for node in self.nodes.values()]
            assert time.monotonic() < deadline, [node.statuses for node in self.nodes.values()]
            assert not any(faults), faults
            time.sleep(0.02)

    def level(self, *names: str) -> None:
        self.until(lambda: all(self.nodes[name].done for name in names))


def post(hub: MemoryHub, *some: Sequence[Correction], done: Callable[[], bool]) -> None:
    """As the station, of which there is none yet."""
    with closing(hub.link("station")) as link:
        station = Courier(link, peers=["r1"])
        deadline = time.monotonic() + 60
        for corrections in some:
            station.post("r1", CORRECTION, encode_corrections(corrections))
            for _ in range(30):
                station.tick(time.time_ns())
                time.sleep(0.02)
        while not done():
            assert time.monotonic() < deadline
            station.tick(time.time_ns())
            time.sleep(0.02)


@pytest.mark.parametrize("model", ["elevation", "occupancy"])
def test_a_robot_maps_anew_and_all_hold_that(tmp_path: Path, model: str) -> None:
    """One correction before the robot has begun, one when it has nothing more to do."""
    settings = settings_of({"r1": Path(drive(tmp_path / "log"))}, tmp_path, model=model)
    Book(tmp_path / "r1.corrections").add("r1", [TURN])
    with Fleet(settings) as fleet:
        fleet.level("r1")
        assert digest(tmp_path / "station.db") == digest(tmp_path / "r1.db")
        fleet.stop("r1")
    first = digest(tmp_path / "station.db")
    Book(tmp_path / "r1.corrections").add("r1", [SHIFT])
    with Fleet(settings) as fleet:
        fleet.level("r1")
        assert fleet.state("r1", "mapping")["corrections"] == 2
    reference = settings.model_copy(
        update={"robots": {"r1": settings.robots["r1"].model_copy(
            update={"source": drive(tmp_path / "better", correct=by(SHIFT, TURN))})}}
    )  # fmt: skip
    expected = mapped_at_once(reference, tmp_path)
    assert first != expected
    assert digest(tmp_path / "r1.db") == digest(tmp_path / "station.db") == expected
    with SqliteStore.open(tmp_path / "station.db") as store:
        tiles = [store.load("r1", key) for key in store.revisions("r1")]
        assert sum(int(erased(tile.cells).sum()) for tile in tiles if tile is not None) > 0


def test_a_robot_does_not_leave_before_what_waits_for_it_has_come(tmp_path: Path) -> None:
    """Its station is at 2 kB/s, and has so many corrections that they take seconds."""
    settings = settings_of({"r1": Path(drive(tmp_path / "log"))}, tmp_path)
    assert settings.station is not None
    station = settings.station.model_copy(update={"bytes_per_s": 2000.0})
    later = [Correction(f"c{k}", k, 5, 5 + k, flat(0.0, 0.0, 0.0)) for k in range(1, 60)]
    Book(tmp_path / "station.corrections").add("r1", [SHIFT, *later])
    with Fleet(settings.model_copy(update={"station": station})) as fleet:
        fleet.level("r1")
        assert fleet.state("r1", "mapping")["corrections"] == 60
    assert digest(tmp_path / "station.db") == digest(tmp_path / "r1.db")


def test_who_gives_corrections_by_a_clock_that_is_wrong_is_told(tmp_path: Path) -> None:
    settings = settings_of({"r1": Path(drive(tmp_path / "log"))}, tmp_path)
    with Fleet(settings) as fleet:
        with closing(fleet.hub.link("ops")) as link:
            asking = Operator(link, "station")
            assert asking.correct("r1", [replace(SHIFT, issued_ns=time.time_ns())]) == 1
            with pytest.raises(InputError, match=r"correction 'shift' is of 3.* s from now: set the clock"):
                asking.correct("r1", [replace(SHIFT, issued_ns=time.time_ns() + 3600 * SECOND_NS)])
            with pytest.raises(InputError, match="correction 'shift' was given before the one of this name"):
                asking.correct("r1", [replace(SHIFT, issued_ns=5)])
        fleet.level("r1")


def test_the_order_in_which_two_come_makes_no_difference(tmp_path: Path) -> None:
    """And that they come twice; while the robot maps, and when it has done so."""
    found = {}
    for name, order in {"one": [[TURN], [SHIFT], [TURN]], "other": [[SHIFT, TURN]]}.items():
        folder = tmp_path / name
        folder.mkdir()
        settings = settings_of({"r1": Path(drive(folder / "log"))}, folder)
        with Fleet(settings.model_copy(update={"station": None})) as fleet:
            post(fleet.hub, *order, done=lambda: fleet.nodes["r1"].statuses["mapping"].health == "done"
                 and fleet.state("r1", "mapping")["corrections"] == 2)  # fmt: skip
        found[name] = digest(folder / "r1.db")
    reference = settings_of({"r1": Path(drive(tmp_path / "better", correct=by(SHIFT, TURN)))}, tmp_path)
    assert found["one"] == found["other"] == mapped_at_once(reference, tmp_path)


def test_coarse_maps_are_corrected_too(tmp_path: Path) -> None:
    """The station was told of the map before; the robot is started afresh between its rebuild and telling of it."""
    settings = settings_of({"r1": Path(drive(tmp_path / "log"))}, tmp_path, global_factor=10)
    with Fleet(settings) as fleet:
        fleet.level("r1")
        fleet.stop("r1")
        Book(tmp_path / "r1.corrections").add("r1", [SHIFT])
        alone = settings.model_copy(update={"station": None, "stations": ("nobody",)})
        with Fleet(alone) as mapping:
            mapping.until(lambda: mapping.nodes["r1"].statuses["mapping"].health == "done")
        fleet.nodes["r1"] = fleet.make("r1")
        fleet.level("r1")
    better = settings_of({"r1": Path(drive(tmp_path / "better", correct=by(SHIFT)))}, tmp_path, global_factor=10)
    coarse = mapped_at_once(better, tmp_path, 10)
    (tmp_path / "map.partial.db").unlink()
    assert digest(tmp_path / "station.db") == mapped_at_once(better, tmp_path)
    assert digest(tmp_path / "station.coarse.db") == coarse


@pytest.mark.parametrize("restarted", [False, True])
def test_robots_are_told_of_what_is_not_there_any_more(tmp_path: Path, restarted: bool) -> None:
    """r3 holds the station's map; it hears nothing while r1 erases what nobody else saw, and the station may then be
    started afresh, which remembers nothing of what it told."""
    logs = {name: Path(drive(tmp_path / name, seed)) for seed, name in enumerate(("r1", "r2"))}
    settings = settings_of(logs, tmp_path)
    held = MemoryStore(Lattice(0.2, 40.0), make_model("elevation"))
    with Fleet(settings) as fleet:
        listener = Courier(fleet.hub.link("r3"), [Channel("global", held, near=True)], peers=["station"])
        listener.area = Bounds(-100.0, -100.0, 100.0, 100.0)

        def same() -> bool:
            listener.tick(time.time_ns())
            return digest(tmp_path / "station.db") == Replica(store=held).digest()

        fleet.level("r1", "r2")
        fleet.until(same)
        before = digest(tmp_path / "station.db")
        fleet.stop("r1")
        Book(tmp_path / "r1.corrections").add("r1", [SHIFT])
        fleet.nodes["r1"] = fleet.make("r1")
        fleet.level("r1")
        assert digest(tmp_path / "station.db") != before
        if restarted:
            fleet.stop("station")
            fleet.nodes["station"] = fleet.make("station")
        fleet.until(same)
    tiles = [held.load("station", key) for key in held.revisions("station")]
    assert sum(int(erased(tile.cells).sum()) for tile in tiles if tile is not None) > 0


def test_who_is_no_station_corrects_nothing(tmp_path: Path) -> None:
    settings = settings_of({"r1": Path(drive(tmp_path / "log"))}, tmp_path)
    with Fleet(settings) as fleet:
        other = Courier(
            fleet.hub.link("r9"), [Channel("fine", MemoryStore(Lattice(0.2, 40.0), make_model("elevation")))]
        )
        other.post("r1", CORRECTION, encode_corrections([SHIFT]))
        fleet.until(lambda: other.tick(time.time_ns()) or fleet.nodes["r1"].done)
        assert "corrections" not in fleet.state("r1", "exchange")
        assert not (tmp_path / "r1.corrections").exists()


def far(id_: str, issued_ns: int, east_m: float = 1e8) -> Correction:
    return Correction(id_, issued_ns, 0, ALWAYS_NS, flat(east_m, 0.0, 0.0))


def test_a_correction_has_bounds() -> None:
    encode_corrections([far("farthest", 1)])
    for motion in (flat(1.1e8, 0.0, 0.0), flat(1e300, 0.0, 0.0), flat(0.0, 0.0, 0.0, -2e8)):
        with pytest.raises(InputError, match=r"correction 'c': moves by .* m; 1e\+08 at most"):
            encode_corrections([Correction("c", 1, 0, ALWAYS_NS, motion)])


@pytest.mark.parametrize("mapped", [True, False])
def test_what_no_map_can_be_made_by_is_taken_back(tmp_path: Path, mapped: bool) -> None:
    """150 shifts, each a good one: 1.5e10 m are beyond 2^40 cells of 1 cm. Whether or not it had a map before, it
    keeps what it had, says why, is started again, and hears of what takes one back, all of them here."""
    settings = settings_of({"r1": Path(drive(tmp_path / "log"))}, tmp_path, resolution_m=0.01, tile_m=2.0)
    expected = mapped_at_once(settings, tmp_path)
    if mapped:
        with Fleet(settings) as fleet:
            fleet.level("r1")
    some = [far(f"far {k}", k) for k in range(150)]
    with Fleet(settings.model_copy(update={"station": None, "stations": ("station",)})) as fleet:
        post(fleet.hub, some, done=lambda: bool(fleet.state("r1", "mapping").get("trouble")))
        assert "corrections 'far 0', 'far 1'" in fleet.state("r1", "mapping")["trouble"]
        assert "; no map can be made by the corrections 'far 0'" in progress(fleet.nodes["r1"])
        assert not fleet.nodes["r1"].done
    with Fleet(settings) as fleet:
        fleet.until(lambda: bool(fleet.state("r1", "mapping").get("trouble")))
        if mapped:
            assert digest(tmp_path / "station.db") == digest(tmp_path / "r1.db") == expected
        fleet.stop("station")
        back = [far(one.id, 100 + k, 0.0) for k, one in enumerate(some)]
        post(fleet.hub, back, done=lambda: fleet.state("r1", "mapping").get("trouble") == "")
        fleet.nodes["station"] = fleet.make("station")
        fleet.level("r1")
    assert digest(tmp_path / "station.db") == digest(tmp_path / "r1.db") == expected


def test_a_damaged_file_beside_the_store_ends_the_node(tmp_path: Path) -> None:
    """Starting its services again could not help."""
    settings = settings_of({"r1": Path(drive(tmp_path / "log"))}, tmp_path)
    for node, file in {"r1": "r1.corrections", "station": "station.corrections"}.items():
        (tmp_path / file).write_bytes(b"else")
        made = make_node(settings, node, lambda name: lambda: MemoryHub().link(name))
        with pytest.raises(StoreMismatch, match=f"{file}: holds no corrections .* delete it, and give them again"):
            run([made], threading.Event())
        (tmp_path / file).unlink()
    (tmp_path / "r1.bases").write_bytes(b"else")
    with pytest.raises(StoreMismatch, match=r"r1.bases: does not say .* delete both, and the log is mapped anew"):
        Bases(tmp_path / "r1.bases").of(7)


# --- real processes --------------------------------------------------------------------------------------------------


def test_corrected_by_command_and_killed_on_the_way(tmp_path: Path) -> None:
    """Corrections are given before the robot is there and while it maps; it is killed after it took them, and so is
    the station."""
    pytest.importorskip("zenoh")
    port = free_port()
    where = ["--connect", f"tcp/127.0.0.1:{port}", "--insecure"]
    log, options = drive(tmp_path / "log", scans=40), ["--resolution", "0.2"]
    correct = ["correct", "r1", *where, "--json"]
    with Processes(tmp_path) as fleet:
        fleet.start("station", "station", "--store", "s.db", "--listen", where[1], "--insecure", *options)
        fleet.until(lambda: answers(port), "that the station listens")
        turned = terrafuse(*correct, "--turn-deg", "30", "--about", "4,2", "--since", "5", "--until", "9", "--id", "t")
        assert turned.code == 0, turned.err
        assert turned.json == {"robot": "r1", "id": "t", "corrections": 1, "reached": False}
        assert "'station' has never heard of 'r1'; is the name right?" in turned.err
        fleet.kill("station")
        fleet.again("station")
        fleet.start("r1", "robot", "r1", *where, "--source", log, "--realtime", *options)
        fleet.until(lambda: (tmp_path / "r1.corrections").exists(), "that r1 takes the first")
        fleet.until(lambda: cells_in(tmp_path / "s.db") > 0, "that the station holds something")
        shift = ["--shift-east", "2.5", "--shift-north", "-1.25", "--shift-up", "0.5"]
        for _ in range(2):
            shifted = terrafuse(*correct, *shift, "--id", "s")
            assert shifted.code == 0, shifted.err
            assert shifted.json == {"robot": "r1", "id": "s", "corrections": 2, "reached": True}
            assert "warning" not in shifted.err
        fleet.until(lambda: len(Book(tmp_path / "r1.corrections").of("r1")) == 2, "that r1 takes the second")
        fleet.kill("r1")
        fleet.start("r1", "robot", "r1", *where, "--source", log, *options)
        listed = terrafuse("services", *where, "--json")
        assert listed.code == 0, listed.err
        fleet.until(lambda: fleet.code("r1") is not None, "that r1 ends")
        assert fleet.code("r1") == 0
        asked = terrafuse("get", "r1/mapping", *where, "--json")
        assert asked.json["state"]["corrections"] == 2
        for words, why in {
            ("--since", "yesterday"): "--since yesterday: give seconds since 1970",
            ("--since", "5", "--until", "4"): "no time between them",
            ("--turn-deg", "nan"): "give finite numbers",
            ("--shift-east", "1e300"): "--shift-east 1e+300: give metres, 1e+07 at most",
            (): "this corrects nothing",
        }.items():
            ran = terrafuse("correct", "r1", *where, *words)
            assert ran.code == 2
            assert why in ran.err
        fleet.stop("station")
    degrees = Correction("t", 1, 5 * SECOND_NS, 9 * SECOND_NS, flat(0.0, 0.0, radians(30), about_m=(4.0, 2.0)))
    better = drive(tmp_path / "better", scans=40, correct=by(degrees, SHIFT))
    ran = terrafuse("map", f"r1={better}", *options, "--out", tmp_path / "at once", "--json")
    assert ran.code == 0, ran.err
    assert digest(tmp_path / "r1.db") == digest(tmp_path / "s.db") == ran.json["map"]["digest"]
