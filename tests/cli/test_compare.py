"""`import`, `compare` and ROS maps as users run them, and the commands of their pages."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from terrafuse.rosmap import Meaning, Placement
from tests.maps import write_raster, write_ros
from tests.program import terrafuse

DOCS = Path(__file__).parent.parent.parent / "docs"


@pytest.fixture
def folder(tmp_path: Path, mapped: Path) -> Path:
    """A folder with what the pages' commands name."""
    (tmp_path / "map").symlink_to(mapped)
    grey = np.full((12, 20), 205)
    grey[2:10, 2:18], grey[2, 2:18] = 254, 0
    write_ros(tmp_path / "depot.yaml", grey, Meaning(), Placement(0.05))
    write_ros(tmp_path / "turned.yaml", grey, Meaning(), Placement(0.05, 1.0, 2.0, 0.3))
    heights = np.zeros((200, 300))
    write_raster(tmp_path / "truth.tif", heights, 499_980.0, 4_000_020.0, 0.2, crs="EPSG:32632")
    write_raster(tmp_path / "dem.tif", heights, 499_980.0, 4_000_020.0, 0.2, crs="EPSG:32632")
    assert terrafuse("import", "depot.yaml", "--out", "depot.db", cwd=tmp_path).code == 0
    return tmp_path


def commands(page: str) -> list[str]:
    return re.findall(r"^    terrafuse ([^|\n]*)", (DOCS / page).read_text(), re.MULTILINE)


@pytest.mark.parametrize(("page", "count"), [("ros-maps.md", 9), ("comparing.md", 5)])
def test_the_pages_commands_run(page: str, count: int, folder: Path) -> None:
    (folder / "depot.db").rename(folder / "depot.done.db")
    found = commands(page)
    assert len(found) == count
    for line in found:
        if "depot.db" in line and "import" not in line and not (folder / "depot.db").exists():
            (folder / "depot.done.db").rename(folder / "depot.db")
        ran = terrafuse(*shlex.split(line), cwd=folder)
        assert ran.code == 0, (line, ran.err)
    if page == "ros-maps.md":
        assert (folder / "again.pgm").read_bytes() == (folder / "depot.pgm").read_bytes()


def test_heights_are_told_in_words(folder: Path) -> None:
    ran = terrafuse("compare", "map/map.db", "truth.tif", "--out", "pictures", cwd=folder)
    assert ran.code == 0, ran.err
    assert "A map/map.db: height of elevation, cells of 0.2 m, EPSG:32632, of r1, r2" in ran.out
    assert "B truth.tif: band 1 of a raster, pixels of 0.2 in EPSG:32632" in ran.out
    for words in ("A − B (m)", "RMSE", "bias (mean)", "median of |A − B|", "95 % of |A − B| within", "known in both"):
        assert words in ran.out
    assert "wrote pictures/difference.png" in ran.out
    assert (folder / "pictures/difference.png").stat().st_size > 10_000


def test_agreement_as_a_table_and_as_json(folder: Path) -> None:
    """A row of 16 occupied cells over 7 rows of 16 free ones, in 240."""
    ran = terrafuse("compare", "depot.db", "depot.yaml", cwd=folder)
    rows = [line.split() for line in ran.out.splitlines() if line.startswith(("A free", "A occupied", "A unknown"))]
    assert rows == [
        ["A", "free", "112", "0", "0"],
        ["A", "occupied", "0", "16", "0"],
        ["A", "unknown", "0", "0", "112"],
    ]
    assert "100.00 %" in ran.out
    as_json = terrafuse("compare", "depot.db", "depot.yaml", "--json", cwd=folder).json
    assert as_json["agreement"] == 1.0
    assert as_json["table"]["occupied"] == {"free": 0, "occupied": 16, "unknown": 0}


def test_import_says_what_it_did(folder: Path) -> None:
    ran = terrafuse(
        "import", "dem.tif", "--out", "dem.db", "--name", "survey", "--time", "2026-05-01T12:00Z", cwd=folder
    )
    assert ran.out.splitlines() == [
        "took band 1 as heights in metres",
        "survey: 60,000 elevation cells of 0.2 m",
        "wrote dem.db",
    ]
    facts = terrafuse("info", "dem.db", "--json", cwd=folder).json
    assert list(facts["robots"]) == ["survey"]
    assert facts["layers"]["stamp"]["min"] == 1_777_636_800  # 2026-05-01 12:00:00 UTC
    done = terrafuse("import", "depot.yaml", "--out", "x.db", "--json", cwd=folder).json
    assert (done["model"], done["cells"], done["format"]) == ("occupancy", 128, "ros-map")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ("compare gone.db truth.tif", "gone.db: no such file; give a store, a raster (GeoTIFF) or the .yaml"),
        ("compare map/map.db gone.tif", "gone.tif: no such file"),
        ("compare depot.pgm truth.tif", "depot.pgm: says nothing of where it lies"),
        ("compare depot.db map/map.db", "no place in common"),
        ("compare map/map.db truth.tif --bounds 1,2,3", "give 4 finite numbers"),
        ("compare map/map.db truth.tif --layer x", "no layer 'x'"),
        ("compare depot.db depot.db --band 1", "--band 1: A is a store, B a store"),
        ("import depot.yaml --out x.db --name ''", "--name '': give a robot's name"),
        ("import dem.tif --out x.db --resample --resolution 0", "--resolution 0: give a number of metres over 0"),
        ("import dem.tif --out x.db --tile -1", "--tile -1: give a number of metres over 0"),
        ("import gone.yaml --out x.db", "gone.yaml: no such file"),
        ("import turned.yaml --out x.db", "yaw 0.3 rad"),
        ("import depot.yaml --out depot.db", "exists already"),
        ("import dem.tif --out x.db --time yesterday", "--time yesterday: give a date"),
        ("import dem.tif --out x.db --time 1960-01-01", "stamps start in 1970"),
        ("export depot.db --out x.yaml --mode four", "mode 'four': there are trinary, scale, raw"),
        ("export depot.db --out x.tif --mode raw", "the format 'cog' has no option mode"),
        ("export depot.db --out x.yaml --free-thresh 0.9", "0 ≤ free_thresh < occupied_thresh ≤ 1"),
    ],
)
def test_bad_input(arguments: str, says: str, folder: Path) -> None:
    before = sorted(path.name for path in folder.iterdir())
    ran = terrafuse(*shlex.split(arguments), cwd=folder)
    assert ran.code == 2, (ran.code, ran.out, ran.err)
    assert says in ran.err
    assert "Traceback" not in ran.err
    assert sorted(path.name for path in folder.iterdir()) == before
    as_json = terrafuse(*shlex.split(arguments), "--json", cwd=folder)
    assert json.loads(as_json.out)["exit_code"] == 2
