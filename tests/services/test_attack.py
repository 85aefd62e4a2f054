"""A robot with a valid certificate that attacks a station over TLS: refused, counted by reason, nothing changed."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("zenoh")
pytest.importorskip("cryptography")

from terrafuse.exchange.codec import encode
from terrafuse.exchange.delta import Delta, TileCells
from terrafuse.exchange.framing import frames_of
from terrafuse.exchange.links import Frame
from terrafuse.exchange.links.transport import Transport
from terrafuse.exchange.links.zenoh import ZenohLink
from terrafuse.exchange.piece import Piece, encode_piece
from terrafuse.exchange.posts import Post, encode_post
from terrafuse.keys.fleet import Fleet
from terrafuse.lattice import Lattice
from terrafuse.models import make_model
from terrafuse.services.places import PLACE, Place
from terrafuse.services.places import encode as encode_place
from terrafuse.store.sqlite import SqliteStore
from terrafuse.testing.deltas import deltas_of, random_scans
from terrafuse.types import TileKey
from tests.program import terrafuse
from tests.services.processes import MOST_S, Processes, answers, cells_in, free_port

LATTICE, MODEL = Lattice(0.2, 40.0), make_model("elevation")
NOW_NS = time.time_ns()
MUTANTS = 20_000
BEGUN, MOST_GROWTH_KB = 3000, 150_000
"""Of 180 MB at most 32 may wait for the rest of their messages, and 64 for being looked at."""


def reported(robot: str, seed: int) -> Delta:
    """One scan about the origin, as of just now."""
    (delta,) = deltas_of(robot, random_scans(seed, 1), LATTICE, MODEL)
    return stamped(delta, NOW_NS)


def stamped(delta: Delta, stamp_ns: int) -> Delta:
    tiles = []
    for tile in delta.tiles:
        cells = tile.cells.copy()
        cells["stamp"] = stamp_ns
        tiles.append(TileCells(tile.key, tile.at, cells))
    return replace(delta, stamp_ns=stamp_ns, tiles=tuple(tiles))


def piece(message: bytes, until: int = 1) -> bytes:
    return encode_piece(Piece(until, [0], (0, until, []), False, message))


GOOD = reported("r4", 1)
FAR = replace(
    GOOD, tiles=tuple(TileCells(TileKey(t.key.x + 25, t.key.y), t.at[:20], t.cells[:20]) for t in GOOD.tiles[:1])
)
"""Some of it, a kilometre further east."""


def oversized() -> Delta:
    """Of four tiles all cells, one more than fit a message."""
    side = 400**2
    cells = np.resize(GOOD.tiles[0].cells, side)
    tiles = [TileCells(TileKey(x, 0), np.arange(side, dtype=np.int32), cells) for x in range(4)]
    return replace(GOOD, tiles=tuple(tiles))


class Attacker:
    """r4's certificate, and none of its manners."""

    def __init__(self, link: ZenohLink, counts: Callable[[], dict[str, int]]) -> None:
        self._link, self._counts, self._posted, self._sent = link, counts, 0, 0

    def send(self, topic: str, message: bytes) -> None:
        for frame in frames_of(topic, message, self._link.max_frame_bytes):
            self._put(frame)
        self._wait()

    def begin(self, topic: str, message: bytes) -> None:
        self._put(frames_of(topic, message, self._link.max_frame_bytes)[0])
        self._wait()

    def _put(self, frame: Frame) -> None:
        self._link.send(*frame, time.time_ns())
        self._sent += 1

    def _wait(self) -> None:
        """The queue of its own link is bounded, too."""
        while self._sent - self._link.counts["frames_sent"] > 10:
            time.sleep(0.001)

    def report(self, delta: Delta, topic: str = "delta/fine/r4/r4") -> None:
        self.send(topic, piece(encode(delta)))

    def place(self) -> None:
        self._posted += 1
        place = encode_place(Place(NOW_NS, 0.0, 0.0, 0.0))
        self.send("post/station/r4", encode_post(Post(NOW_NS, self._posted, PLACE, place)))

    @property
    def refused(self) -> int:
        return sum(n for key, n in self._counts().items() if key.startswith("refused."))

    def until_counted(self, reason: str, act: Callable[[], object] = lambda: None, more: int = 1) -> None:
        before = self._counts().get(f"refused.{reason}", 0)
        deadline = time.monotonic() + 80
        while self._counts().get(f"refused.{reason}", 0) < before + more:
            assert time.monotonic() < deadline, f"{reason}: {self._counts()}"
            act()
            time.sleep(0.3)


def resident_kb(pid: int) -> int:
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("VmRSS")).split()[1])


@contextmanager
def besieged(folder: Path) -> Iterator[tuple[Processes, Attacker, Path]]:
    fleet = Fleet.new(folder / "fleet")
    fleet.add("station", station=True, hosts=["127.0.0.1"])
    for name in ("r4", "ops"):
        fleet.add(name)
    port, store = free_port(), folder / "s.db"
    where = f"tls/127.0.0.1:{port}"
    with Processes(folder) as processes:
        processes.start(
            "station", "station", "--store", store, "--listen", where, "--keys", fleet.node_folder("station"),
            "--resolution", "0.2", "--quota-distance", "100", "--quota-rate", "20000",
        )  # fmt: skip
        processes.until(lambda: answers(port), "that the station listens")
        link = ZenohLink("r4", Transport(connect=where, keys=fleet.node_folder("r4")))

        def counts() -> dict[str, int]:
            got = terrafuse(
                "get", "station/map-manager", "--connect", where, "--keys", fleet.node_folder("ops"), "--json"
            )
            assert got.code == 0, got.err
            found: dict[str, int] = got.json["counts"]
            return found

        try:
            yield processes, Attacker(link, counts), store
        finally:
            link.close()


@pytest.mark.long
def test_what_a_robot_with_a_certificate_can_do(tmp_path: Path) -> None:
    with besieged(tmp_path) as (processes, r4, store):
        r4.until_counted("place", lambda: r4.report(GOOD))
        r4.place()
        r4.until_counted("distance", lambda: r4.report(FAR))
        r4.until_counted("clock", lambda: r4.report(stamped(GOOD, NOW_NS + 3600 * 10**9)))
        r4.until_counted("size", lambda: r4.report(oversized()))
        r4.until_counted("sender", lambda: r4.report(reported("r5", 2)))
        r4.until_counted("damaged", lambda: r4.send("delta/fine/r4/r4", piece(encode(GOOD)[:-20])))
        r4.until_counted("map", lambda: r4.report(replace(GOOD, map=replace(GOOD.map, crs="EPSG:32632"))))
        for topic in ("delta/fine/r5/r5", "delta/fine/r5/r4", "delta/fine/r4/r5"):
            r4.report(reported("r5", 2), topic)  # dropped where it arrives
        before = r4.refused
        mutants(r4)
        processes.deadline = time.monotonic() + MOST_S
        processes.until(lambda: r4.refused > before + 0.99 * MUTANTS, "that all is refused")
        assert cells_in(store) == 0, "nothing of all this is in the map"
        before_kb = resident_kb(processes.pid("station"))
        begun(r4)
        r4.until_counted("rate", lambda: flood(r4))
        grown_kb = resident_kb(processes.pid("station")) - before_kb
        assert grown_kb < MOST_GROWTH_KB, f"{grown_kb} kB more than before"
        assert processes.stop("station")[0] == 0
    with SqliteStore.open(store) as held:
        assert held.robots() == ["r4"]


def mutants(r4: Attacker) -> None:
    """Pieces whose bytes were flipped, cut, doubled; in whole frames, so that they are looked into. What is whole in
    spite of that is too far away."""
    rng, good = np.random.default_rng(1), piece(encode(FAR))
    for kind, at, bit in rng.integers(0, 2**31, (MUTANTS, 3)).tolist():
        where = at % len(good)
        flipped = good[:where] + bytes([good[where] ^ (1 << bit % 8)]) + good[where + 1 :]
        r4.send("delta/fine/r4/r4", (flipped, good[:where], good[:where] + good[where // 2 :])[kind % 3])


def flood(r4: Attacker) -> None:
    """Of good reports, each another one: 600 kB may come at once, and 20 kB a second."""
    for revision in range(1, 300):
        tiles = [replace(tile, cells=tile.cells.copy()) for tile in GOOD.tiles]
        for tile in tiles:
            tile.cells["revision"] = revision
        again = replace(GOOD, since=revision - 1, revision=revision, tiles=tuple(tiles))
        r4.send("delta/fine/r4/r4", piece(encode(again), revision))


def begun(r4: Attacker) -> None:
    """Messages of which only one frame ever comes."""
    for k in range(BEGUN):
        r4.begin("delta/fine/r4/r4", k.to_bytes(4) + bytes(100_000))
