"""`terrafuse plan`, as users run it."""

from __future__ import annotations

import json
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from math import sqrt
from pathlib import Path

import numpy as np
import pytest

from terrafuse.cli import main
from terrafuse.cli.plan import main_corners
from terrafuse.models import make_model
from terrafuse.store.sqlite import SqliteStore
from tests.navigate.drawn import letters, occupancy_map, reported
from tests.program import Ran, terrafuse

HOUSE = """
    ..........
    .########.
    .#......#.
    .#......#.
    .####.###.
    ..........
"""
"""In cells of half a metre, with a door of one cell; the closed house has none."""
POINT = "{radius_m: 0, keep_away_m: 0, occupied_price: 0}"
ROOM = "2.25,1.25"


def stored(path: Path, drawing: str, crs: str | None = None) -> Path:
    lattice = occupancy_map(drawing, 0.5, crs).lattice
    with SqliteStore.create(path, lattice, make_model("occupancy")) as store:
        store.accept(reported(letters(drawing), lattice, revision=1))
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of house.db, closed.db, utm.db and point.yaml."""
    folder = tmp_path_factory.mktemp("plan")
    stored(folder / "house.db", HOUSE)
    stored(folder / "closed.db", HOUSE.replace(".####.###.", ".########."))
    stored(folder / "utm.db", HOUSE, "EPSG:32632")
    (folder / "point.yaml").write_text(POINT)
    return folder


def run(*arguments: str | Path) -> Ran:
    """As `tests.program.terrafuse`, in this process."""
    with (
        pytest.MonkeyPatch.context() as patch,
        redirect_stdout(StringIO()) as out,
        redirect_stderr(StringIO()) as err,
    ):
        patch.setattr("sys.argv", ["terrafuse", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
    return Ran(int(ended.value.code or 0), out.getvalue(), err.getvalue())


def planned(folder: Path, *more: str | Path, store: str = "house.db", start: str = "0.25,0.25", to: str = ROOM) -> Ran:
    return run("plan", folder / store, "--from", start, "--to", to, *more)


def test_a_path_as_text(folder: Path) -> None:
    """From (0, 0) 5 along to below the door, 2 up, and 1 back, as a diagonal would cut the door's frame: 8 cells."""
    ran = planned(folder, "--robot", folder / "point.yaml")
    assert ran.code == 0
    assert ran.out.splitlines()[:2] == [
        "length 4.00 m, of which 0.00 m through the unknown",
        "cost 4.00: as much as so many metres of free ground",
    ]
    assert ran.out.splitlines()[2].startswith("4 waypoints (east, north); ")
    assert [line.strip() for line in ran.out.splitlines()[3:]] == ["0.25,0.25", "2.75,0.25", "2.75,1.25", "2.25,1.25"]


def test_of_many_waypoints_the_text_has_the_main_ones(folder: Path) -> None:
    """A way that winds through slots of one cell between 19 walls, each open at the other end: two turns at each."""
    walls = {0: "............", 1: ".###########", 3: "###########."}
    rows = [walls[0 if k % 2 == 0 else k % 4] for k in range(39)]
    stored(folder / "winding.db", "\n".join(rows))
    ran = planned(folder, "--robot", folder / "point.yaml", store="winding.db", to="0.25,19.25")
    full = planned(folder, "--robot", folder / "point.yaml", "--json", store="winding.db", to="0.25,19.25").json
    lines = ran.out.splitlines()
    assert len(full["waypoints_m"]) >= 38
    assert lines[2].startswith(f"{len(full['waypoints_m'])} waypoints (east, north), 12 of them here, all with --json")
    shown = [[float(number) for number in line.split(",")] for line in lines[3:]]
    assert len(shown) == 12
    assert shown == [place for place in full["waypoints_m"] if place in shown]  # in their order
    assert (shown[0], shown[-1]) == (full["waypoints_m"][0], full["waypoints_m"][-1])


def test_the_main_corners_of_a_line() -> None:
    """Of (0,0) (1,0.1) (2,0) (3,5) (4,0): (3,5) lies furthest off the line between the ends. Then, from it to the
    start, (2,0): |3·0 − 5·2|/√34 = 1.71, and (1,0.1): |0.3 − 5|/√34 = 0.81."""
    line = np.array([[0, 0], [1, 0.1], [2, 0], [3, 5], [4, 0]], float)
    assert main_corners(line, 3).tolist() == [[0, 0], [3, 5], [4, 0]]
    assert main_corners(line, 4).tolist() == [[0, 0], [2, 0], [3, 5], [4, 0]]
    assert main_corners(line, 5).tolist() == main_corners(line, 12).tolist() == line.tolist()
    assert main_corners(line[:1], 12).tolist() == [[0, 0]]
    there_and_back = np.array([[0, 0], [2, 0], [0, 0]], float)
    assert main_corners(there_and_back, 12).tolist() == there_and_back.tolist()


def test_a_path_as_json(folder: Path) -> None:
    """From (0, 0) 5 up and 3 along: the wall's corner is not cut."""
    facts = planned(folder, "--robot", folder / "point.yaml", "--json", to="1.75,2.75").json
    assert facts["length_m"] == pytest.approx(0.5 * 8)
    assert facts["cost_m"] == pytest.approx(0.5 * 8)
    assert facts["unknown_m"] == 0
    assert facts["waypoints_m"] == [[0.25, 0.25], [0.25, 2.75], [1.75, 2.75]]
    assert facts["expanded"] > 8


def test_at_any_angle(folder: Path) -> None:
    open_field = stored(folder / "field.db", "..... ..... .....")
    plain, straight = (
        run("plan", open_field, "--from", "0.25,0.25", "--to", "2.25,1.25", "--json", *more).json
        for more in ((), ("--any-angle",))
    )
    assert plain["length_m"] == pytest.approx(0.5 * (2 + 2 * sqrt(2)))
    assert straight["length_m"] == pytest.approx(0.5 * sqrt(20))
    assert straight["waypoints_m"] == [[0.25, 0.25], [2.25, 1.25]]


def test_why_there_is_none(folder: Path) -> None:
    ran = planned(folder, "--robot", folder / "point.yaml", "--json", store="closed.db")
    assert ran.code == 1
    assert ran.json["kind"] == "NoPath"
    assert (ran.json["reason"], ran.json["exit_code"]) == ("not_connected", 1)
    assert "error: no way leads from 0.25,0.25 to 2.25,1.25; of what can be reached, " in ran.err
    (folder / "wide.yaml").write_text("radius_m: 0.26")
    too_wide = planned(folder, "--robot", folder / "wide.yaml", "--json")
    assert (too_wide.code, too_wide.json["reason"]) == (1, "too_near")
    outside = planned(folder, "--json", to="-7,3.5")
    assert (outside.code, outside.json["reason"], outside.json["end"]) == (1, "outside", "goal")
    wall = planned(folder, "--robot", folder / "point.yaml", "--json", start="0.6,1")
    assert (wall.code, wall.json["reason"], wall.json["end"]) == (1, "obstacle", "start")
    assert wall.json["nearest"] == [0.25, 1.25]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--to", "1"), "--to '1': give 2 finite numbers, EAST,NORTH"),
        (("--to", "nan,0"), "finite"),
        (("--to", "1e300,0"), "places on Earth"),
        (("--bounds", "3,0,1,1"), "bounds are empty"),
        (("--robot", "none.yaml"), "none.yaml: can't be read"),
        (("--out", "way.svg"), "ends in .png, .geojson, .json"),
        (("--out", "house.db"), "the store itself"),
        (("--out", "none/way.geojson"), "there is no folder"),
        (("--out", "none/way.png"), "there is no folder"),
        (("--resolution", "3"), "No such option"),
    ],
)
def test_wrong_input_is_refused(
    folder: Path, arguments: tuple[str, ...], says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    ran = run("plan", "house.db", "--from", "0.25,0.25", "--to", "0.25,0.75", *arguments)
    assert ran.code == 2, ran
    assert says in ran.err
    assert "Traceback" not in ran.err
    assert sorted(file.suffix for file in folder.iterdir() if file.name.startswith((".", "way"))) == []


def test_stores_that_are_none(folder: Path) -> None:
    assert planned(folder, store="none.db").code == 2
    assert planned(folder, store="point.yaml").code == 2
    (folder / "same.json").write_bytes((folder / "house.db").read_bytes())
    ran = planned(folder, "--out", folder / "same.json", store="same.json")
    assert (ran.code, "the store itself" in ran.err) == (2, True)


def test_nothing_changes_in_the_store(folder: Path) -> None:
    """And the program itself runs, not only its main function."""
    before = (folder / "house.db").read_bytes()
    assert terrafuse("plan", folder / "house.db", "--from", "-0.1,3", "--to", ROOM).code == 1
    assert terrafuse("plan", folder / "house.db", "--from", "0.1,0", "--to", ROOM).code == 0
    assert (folder / "house.db").read_bytes() == before


@pytest.mark.parametrize(("store", "crs"), [("house.db", None), ("utm.db", "EPSG:32632")])
def test_geojson(folder: Path, tmp_path: Path, store: str, crs: str | None) -> None:
    out = tmp_path / "way.geojson"
    ran = planned(folder, "--robot", folder / "point.yaml", "--out", out, "--json", store=store)
    assert ran.json["out"] == str(out)
    content = json.loads(out.read_text())
    assert content.get("crs", {}).get("properties", {}).get("name") == crs
    (feature,) = content["features"]
    assert feature["geometry"] == {"type": "LineString", "coordinates": ran.json["waypoints_m"]}
    assert feature["properties"]["length_m"] == ran.json["length_m"]
    assert planned(folder, "--out", out, to="0.25,0.25").code == 0
    assert json.loads(out.read_text())["features"][0]["geometry"]["coordinates"] == [[0.25, 0.25]] * 2


def test_a_picture(folder: Path, tmp_path: Path) -> None:
    """The path is drawn in its colour where it goes, from a disc to a square."""
    image = pytest.importorskip("PIL.Image")
    out = tmp_path / "way.png"
    ran = planned(folder, "--robot", folder / "point.yaml", "--out", out)
    assert (ran.code, ran.out.splitlines()[-1]) == (0, f"wrote {out}")
    pixels = np.asarray(image.open(out).convert("RGB")).astype(int)
    pink = (np.abs(pixels - (0xE6, 0x00, 0x7E)) < 8).all(axis=2)
    # 10 cells of 64 pixels across, the most there are a cell; the map is 96 pixels from the left and from below.
    row = pixels.shape[0] - 96 - int(1.5 * 64)
    assert pink[row, 96 + int(5.5 * 64)]
    assert not pink[row, 96 + int(2.5 * 64)]
