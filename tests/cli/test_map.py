"""`terrafuse map`, `info` and `export`, as users run them."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from terrafuse import mapping
from terrafuse.cli import arguments
from terrafuse.config import map_settings
from terrafuse.models import make_model
from tests.program import terrafuse

rasterio = pytest.importorskip("rasterio")


def test_writes_every_result(mapped: Path) -> None:
    assert sorted(p.name for p in mapped.iterdir()) == ["map.db", "map.png", "map.tif", "report.html", "report.json"]


def test_the_report_says_what_happened(mapped: Path) -> None:
    report = json.loads((mapped / "report.json").read_text())
    assert set(report["robots"]) == {"r1", "r2"}
    for robot in report["robots"].values():
        assert robot["scans"] == 40
        assert robot["points"] == 80_000
        assert robot["distance_m"] == pytest.approx(39 * 0.5, abs=0.01)
        assert {"read", "observe", "merge", "commit"} <= set(robot["seconds"])
    assert report["cells"] > 10_000
    assert report["bounds"][1] == pytest.approx(4_000_000 - 20, abs=1)
    assert report["delta_bytes_per_robot"]["r1"] > 1000
    assert report["resident_bytes"] > 10_000_000
    assert report["allocated_bytes"] > 100_000
    assert report["points_per_second"] > 0
    assert report["layers"]["z_min"]["min"] == pytest.approx(-0.33, abs=0.05)
    assert report["layers"]["height"]["unit"] == "m"


def test_the_raster_opens_in_gis_tools(mapped: Path) -> None:
    with rasterio.open(mapped / "map.tif") as raster:
        assert raster.crs.to_epsg() == 32632
        assert raster.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert raster.transform.a == pytest.approx(0.2)
        assert raster.transform.e == pytest.approx(-0.2)
        assert {"height", "z_min", "n", "traversability"} <= set(raster.descriptions)
        units = dict(zip(raster.descriptions, raster.units, strict=True))
        assert units["height"] == "m"
        assert np.isnan(raster.nodata)
        n = raster.read(raster.descriptions.index("n") + 1)
        assert np.nansum(n) == 160_000


def test_info_shows_the_same_map(mapped: Path) -> None:
    report = json.loads((mapped / "report.json").read_text())
    before = (mapped / "map.db").read_bytes()
    info = terrafuse("info", mapped / "map.db", "--json").json
    assert (mapped / "map.db").read_bytes() == before  # looking changes nothing
    assert info["map"]["digest"] == report["map"]["digest"]
    assert info["cells"] == report["cells"]
    assert info["robots"]["r2"]["poses"] == 40
    text = terrafuse("info", mapped / "map.db")
    assert text.code == 0
    assert report["map"]["digest"] in text.out


@pytest.mark.parametrize("window", ["all", "tiles3x3", "nine_block", "radius?range_m=28", "centred?cells=290"])
def test_the_window_makes_no_difference(logs: dict[str, Path], mapped: Path, tmp_path: Path, window: str) -> None:
    ran = terrafuse(
        "map", *(f"{name}={log}" for name, log in logs.items()), "--resolution", "0.2", "--tile", "4",
        "--window", window, "--out", tmp_path / "out", "--json",
    )  # fmt: skip
    assert ran.code == 0, ran.err
    digests.add(ran.json["map"]["digest"])
    assert len(digests) == 1


digests: set[str] = set()


def test_a_model_with_settings(logs: dict[str, Path], tmp_path: Path) -> None:
    """They are typed, are stored with the map, and are told again."""
    wanted = "terrain?half_life_s=60&subcells=25&max_range_m=none"
    ran = terrafuse("map", f"r1={logs['r1']}", "--model", wanted, "--resolution", "0.5", "--out", tmp_path / "out")
    assert ran.code == 0, ran.err
    about = terrafuse("info", tmp_path / "out/map.db", "--json").json["map"]
    assert about["model"] == "terrain"
    assert about["settings"] == make_model("terrain", {"half_life_s": 60.0, "subcells": 25}).settings()
    assert "terrain?half_life_s=60" in terrafuse("map", "--help").out


def test_a_cut_run_goes_on_only_with_the_same_model_settings(logs: dict[str, Path]) -> None:
    def fingerprint(model: str) -> object:
        name, settings = arguments.model(model)
        return mapping.plan({"r1": str(logs["r1"])}, map_settings(model=name, model_settings=settings)).fingerprint

    assert fingerprint("terrain?half_life_s=60") == fingerprint("terrain?half_life_s=60.0")
    assert fingerprint("terrain?half_life_s=60") != fingerprint("terrain?half_life_s=61")


def test_models_are_listed_with_their_settings() -> None:
    ran = terrafuse("models")
    assert ran.code == 0, ran.err
    headings = [line for line in ran.out.splitlines() if not line.startswith(" ")]
    assert headings == ["elevation", "grey", "occupancy", "terrain"]
    assert ["half_life_s=600", "a", "number", "or", "none"] in [line.split() for line in ran.out.splitlines()]
    half_life = terrafuse("models", "--json").json["terrain"]["half_life_s"]
    assert (half_life["default"], half_life["takes"]) == (600.0, "a number or none")


@pytest.mark.parametrize(
    ("resolution_m", "factor", "tile_m"),
    [
        (0.1, 1, 40.0),
        (0.3, 1, 39.0),  # 133.3 cells: 130 of them
        (0.03, 1, 39.9),  # 1333.3 cells: 1330
        (0.1, 7, 42.0),  # 400 cells: 6 times 70 is 420
        (0.3, 4, 42.0),  # 133.3 cells: 7 times 20 is 140
        (2.0, 8, 160.0),  # 100 cells: 2 times 40 (2.5 rounds to the even number)
        (0.005, 1, 20.45),  # 8000 cells are more than the 4096 that there may be: 4090
        (1e-5, 1, 40.0),  # a tile of 4 cm is none
    ],
)
def test_the_tile_fits_the_cells(resolution_m: float, factor: int, tile_m: float) -> None:
    assert mapping.tile_for(resolution_m, factor) == pytest.approx(tile_m)


def test_another_tile_than_usual_is_told(logs: dict[str, Path], tmp_path: Path) -> None:
    ran = terrafuse("map", f"r1={logs['r1']}", "--resolution", "0.3", "--out", tmp_path / "out")
    assert ran.code == 0, ran.err
    assert "tiles of 39 m, as cells do not fit into the usual 40 m; --tile chooses others" in ran.out
    assert "r1: 40 scans, 80 k points, " in ran.out


def test_export_by_ending_layer_and_bounds(mapped: Path, tmp_path: Path) -> None:
    bounds = "500000,4000000,500004,4000002"
    ran = terrafuse(
        "export", mapped / "map.db", "--out", tmp_path / "part.npz", "--layer", "height", "--bounds", bounds
    )
    assert ran.code == 0, ran.err
    with np.load(tmp_path / "part.npz") as arrays:
        assert arrays["height"].shape == (10, 20)
        assert arrays["x"][0] == pytest.approx(500000.1)
        assert arrays["y"][0] == pytest.approx(4000001.9)
    assert terrafuse("export", mapped / "map.db", "--out", tmp_path / "a.tif").code == 0
    assert terrafuse("export", mapped / "map.db", "--out", tmp_path / "a.png", "--layer", "dynamic").code == 0
    with rasterio.open(tmp_path / "a.tif") as ours, rasterio.open(mapped / "map.tif") as first:
        np.testing.assert_array_equal(ours.read(), first.read())


def test_export_leaves_robots_out(mapped: Path, tmp_path: Path) -> None:
    for option, file in (("--only", "only.npz"), ("--without", "without.npz")):
        out = tmp_path / file
        ran = terrafuse("export", mapped / "map.db", "--out", out, "--layer", "n", option, "r1")
        assert ran.code == 0, ran.err
        with np.load(out) as arrays:
            assert np.nansum(arrays["n"]) == 80_000


def test_a_map_is_not_overwritten_unless_asked(logs: dict[str, Path], tmp_path: Path) -> None:
    arguments = ("map", f"r1={logs['r1']}", "--resolution", "0.5", "--out", tmp_path / "out")
    assert terrafuse(*arguments).code == 0
    before = (tmp_path / "out/map.db").read_bytes()
    again = terrafuse(*arguments)
    assert again.code == 2
    assert "--overwrite" in again.err
    assert (tmp_path / "out/map.db").read_bytes() == before
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(logs["r2"].read_bytes()[:50_000])
    assert terrafuse("map", f"r1={cut}", "--out", tmp_path / "out", "--overwrite").code == 2
    assert (tmp_path / "out/map.db").read_bytes() == before
    assert terrafuse(*arguments, "--overwrite").code == 0


def test_kitti_statistics_reach_the_files(recordings: Path, tmp_path: Path) -> None:
    source = f"{recordings / 'lidar3d/patchworkpp_kitti'}?poses=poses_velo_first6.txt&calib=identity"
    ran = terrafuse("map", f"car={source}", "--static", "--out", tmp_path / "kitti", "--json")
    assert ran.code == 0, ran.err
    assert ran.json["robots"]["car"]["scans"] == 6
    with rasterio.open(tmp_path / "kitti/map.tif") as raster:
        n = raster.read(raster.descriptions.index("n") + 1)
        assert np.nansum(n) == ran.json["robots"]["car"]["points"]


def test_help_is_quick_and_imports_nothing_heavy() -> None:
    code = (
        "import sys, terrafuse.cli; "
        "print([m for m in ('numpy', 'numba', 'rasterio', 'matplotlib', 'xarray', 'rosbags') if m in sys.modules])"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"
